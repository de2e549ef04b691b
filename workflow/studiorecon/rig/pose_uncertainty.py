# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of cameras estimated from people: from differences between halves of the evidence, not only random noise.

A detector's joints are wrong by centimetres, in the same way for as long as the body looks the same from a camera. No
number of frames averages that out, and the residuals do not show it. But halves of the clip show other poses and halves
of the body other joints: the difference between the cameras estimated from them is an error of that kind.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.bundle import BundleResult, LensPrior, remove_drift
from studiorecon.geometry.rotations import angle
from studiorecon.geometry.triangulation import Limits, TriangulatedPoints, triangulate
from studiorecon.rig.correspondences import Observations
from studiorecon.rig.floor_marks import FloorMarks
from studiorecon.rig.from_tracks import Rig, adjust_rig, places_of_joints
from studiorecon.rig.moved_cameras import HALF_OF_THE_JOINTS, MovedCameras, pose_changes
from studiorecon.rig.room_turns import RoomTurn
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Num

# Least sigma if all halves agree: a detector's joints differ between front and back views.
_FLOOR_DEG = 0.2
# Error of the assumption that the principal point is the middle, as a share of the longer side along each axis, in the
# lenses of a motion-capture system and of a checkerboard calibration. It turns a camera by as much.
_PRINCIPAL_SHARE = 0.006
_MIN_POINTS = 60
_LENSES_KNOWN = LensPrior(0.0, 0.0)
# Factor on the interval of the worst pair in ``rotation_interval_deg`` for errors about all three axes.
ABOUT_ALL_AXES = 3.4 / 3.0
# Size of the floor's fields with correlated errors: a carpet's border, the edge of a platform.
_FIELD_M = 0.5


def pose_sigmas(
    rig: Rig,
    result: BundleResult,
    lens: LensPrior,
    limits: Limits,
    known_px: Mapping[int, float] | None = None,
    turns: Mapping[int, RoomTurn] | None = None,
    marks: FloorMarks | None = None,
    principal_share: float = _PRINCIPAL_SHARE,
) -> tuple[Num[np.ndarray, " V"], Num[np.ndarray, " V"], Num[np.ndarray, " V"]]:
    """Sigmas of rotation (degrees), position (metres) and focal length (share) of cameras relative to one another.

    The largest of the residuals' (``Adjusted.sigma``, with all cells of a joint as one observation), and of the root
    mean square errors of fits to halves of the clip and of the joints. Added are 0.2° that no half shows, with their
    effect on position at the people's distance, and the principal point, which is not estimated (``principal_share`` of
    the longer side; 0 where lenses were calibrated). With independent errors, the difference of a half from the whole
    is as uncertain as the whole. Sigmas of focal lengths are at most those of ``lens``; ``known_px``, ``turns`` and
    ``marks`` as for ``adjust_rig``: fields of the floor are halves too.
    """
    counted = rig.points.verified if len(result.cameras) > 2 else rig.points.valid
    early = rig.seen.frame <= np.median(rig.seen.frame[counted]) if counted.any() else counted
    half, side = HALF_OF_THE_JOINTS[rig.seen.keypoint], rig.seen.keypoint % 2 == 0
    # Differences between moments and between joints are different errors: the larger counts, not their mean.
    about = lens, limits, known_px, turns
    of_kinds = [
        _off_by(result, [(_part(rig, part), marks) for part in _both(patterns) if _enough(part & counted)], *about)
        for patterns in ((early,), (half, side))
    ]
    if marks is not None:
        of_kinds.append(_off_by(result, [(rig, marks.of(part)) for part in _both(_fields(marks))], *about))
    joints = len(np.unique(np.stack([rig.seen.group[counted], rig.seen.keypoint[counted]]), axis=1).T)
    wider = np.sqrt(places_of_joints(rig, counted) / max(joints, 1))
    formal = (
        wider * np.degrees(result.sigma[:, :3].max(1)),
        wider * result.sigma[:, 3:6].max(1),
        wider * result.sigma[:, 6],
    )
    seen = np.max(of_kinds, axis=0)
    middle = np.median(result.points_m, axis=0)
    away = np.array([np.linalg.norm(c.centre_m - middle) for c in result.cameras])
    principal = np.degrees([principal_share * max(c.wh) / c.focal_px[0] for c in result.cameras])
    floor = np.hypot(_FLOOR_DEG, principal), np.radians(_FLOOR_DEG) * away, 0.0
    turn, place, focal = (np.hypot(np.maximum(f, s), least) for f, s, least in zip(formal, seen, floor))
    return turn, place, np.minimum(focal, lens.log_focal)


def rotation_observability(cameras: Sequence[Camera], seen: Observations, limits: Limits) -> tuple[float, float] | None:
    """How well people alone determine calibrated cameras' relative rotation: the change that they require, and its
    interval.

    These are the degrees by which they would turn two cameras, and half of the 95 % interval
    (``rotation_interval_deg``). A calibration fits people even if it is off by their sum: one man in one place allows
    degrees. None with too little evidence. People determine nothing about cameras that do not see them.
    """
    sighted = [int(v) for v in np.flatnonzero((seen.confidence > 0).any(1))]
    cameras, seen = [cameras[v] for v in sighted], seen.by(sighted)
    if len(cameras) < 2:
        return None
    rig = Rig(dict(enumerate(cameras)), seen, triangulate(seen.pixels, seen.confidence, cameras, limits), 0)
    counted = rig.points.verified if len(cameras) > 2 else rig.points.valid
    if int(counted.sum()) < _MIN_POINTS:
        return None
    result, _ = adjust_rig(rig, _LENSES_KNOWN, limits)
    turn_deg, _, _ = pose_sigmas(rig, result, _LENSES_KNOWN, limits, principal_share=0.0)
    pairs = [(a, b) for a in range(len(cameras)) for b in range(a)]
    ours, given = ([c.camera_from_world[:3, :3] for c in group] for group in (result.cameras, cameras))
    turned = [angle(ours[a] @ ours[b].T, given[a] @ given[b].T) for a, b in pairs]
    return float(np.degrees(np.max(turned))), rotation_interval_deg(turn_deg)


def moved_rotation_interval_deg(found: MovedCameras, limits: Limits) -> float:
    """``rotation_interval_deg`` of refined moved cameras, for errors about all three axes.

    From their fit's sigmas and, where no room was used, from the difference between halves of the people.
    """
    found_deg = rotation_interval_deg(np.array(list(found.report["sigma_deg"].values())))
    if not found.report.get("room", {}).get("explained"):
        observable = rotation_observability(found.cameras, found.seen, limits)
        found_deg = max(found_deg, 0.0 if observable is None else observable[1])
    return ABOUT_ALL_AXES * found_deg


def _both(patterns: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Every pattern of halves (N,) bool and its other half."""
    return [half for pattern in patterns for half in (pattern, ~pattern)]


def _enough(chosen: np.ndarray) -> bool:
    return int(chosen.sum()) >= _MIN_POINTS


def _fields(marks: FloorMarks) -> tuple[np.ndarray, ...]:
    """Halves of the floor: fields of a chessboard, and stripes."""
    cells = np.floor(marks.points_m[:, :2] / _FIELD_M).astype(int)
    return cells.sum(1) % 2 == 0, cells[:, 0] % 2 == 0


def _off_by(
    result: BundleResult,
    parts: Sequence[tuple[Rig, FloorMarks | None]],
    lens: LensPrior,
    limits: Limits,
    known_px: Mapping[int, float] | None,
    turns: Mapping[int, RoomTurn] | None,
) -> np.ndarray:
    """(3, V) root mean square error of cameras from ``parts`` of the evidence against ``result``; zeros without parts.

    Rotation (degrees) and position (metres) per number, focal length (share).
    """
    off = []
    for rig, marks in parts:
        part, _ = adjust_rig(rig, lens, limits, known_px, turns, marks)
        degrees, metres = pose_changes(remove_drift(part.cameras, result.cameras)[0], result.cameras)
        focal = [np.log(a.focal_px[0] / b.focal_px[0]) for a, b in zip(part.cameras, result.cameras)]
        # A rotation has three numbers and so has a position: per number, like the formal sigmas.
        off.append([degrees / np.sqrt(3), metres / np.sqrt(3), focal])
    return np.sqrt(np.mean(np.square(off), axis=0)) if off else np.zeros((3, len(result.cameras)))


def _part(rig: Rig, chosen: np.ndarray) -> Rig:
    points = rig.points
    some = TriangulatedPoints(
        points.points_m[chosen],
        points.valid[chosen],
        points.verified[chosen],
        points.inliers[:, chosen],
        points.covariance_m2[chosen],
        points.error_px[:, chosen],
    )
    return Rig(rig.cameras, rig.seen.of(chosen), some, rig.support)


def rotation_interval_deg(turn_deg: Num[np.ndarray, " V"]) -> float:
    """Half of the 95 % interval, degrees, of the rotation between the two least certain cameras, valid for the worst
    pair.

    ``turn_deg`` are the rotations' sigmas from ``pose_sigmas``. 3 standard deviations: of six pairs, between 2.6 for
    errors about one axis and 3.4 for errors about all three.
    """
    return float(3.0 * np.sqrt((np.sort(turn_deg)[-2:] ** 2).sum()))
