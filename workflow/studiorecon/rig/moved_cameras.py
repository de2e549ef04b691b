# SPDX-License-Identifier: Apache-2.0
"""Cameras that were moved since they were calibrated: their poses from people, under a prior of adaptive width.

A fixed prior either holds cameras that were knocked by degrees, or lets unmoved cameras drift in directions that people
hardly determine. So the prior has several widths. The narrowest is chosen that explains the validation split about as
well as the best: the other half of the clip, and the other half of the joints, since a detector's error of a joint is
always the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.geometry.bundle import BundleSettings, remove_drift
from studiorecon.geometry.rotations import log
from studiorecon.geometry.triangulation import Limits, triangulate, unit_px
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.progress import warn
from studiorecon.rig.bundle import agreeing_observations, error_medians
from studiorecon.rig.correspondences import Observations, make_observations
from studiorecon.rig.floor_alignment import align_to_floor, floor_under_feet
from studiorecon.rig.from_tracks import dense_tracks, propose_rigs
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.rig.room_refinement import refine_on_room
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# The widest prior: several times the displacement of a knocked or replaced tripod, so that it only holds undetermined
# directions.
FREE_DEG, FREE_M = 20.0, 2.0
_MIDDLE = 4.0
# Beyond this it is another position, or another camera's pose.
FURTHEST_DEG, FURTHEST_M = 10.0, 1.0
# A pose with a larger sigma from people counts as undetermined.
_MAX_SIGMA_DEG, _MAX_SIGMA_M = 2.5, 0.25
# From coarse to fine: gate of tracks in metres, error units as multiples of the usual one.
_ROUNDS = ((1.0, 8.0), (0.5, 4.0), (0.25, 2.0), (0.25, 1.0), (0.25, 1.0))
_STARTS = (2, 1, 0)
_RIG_FRAMES = 16
_LAID = 20
# How much worse than the best a narrower prior may explain validation halves. Where cameras were not moved, the halves
# of a real man's clip differed by 2 to 3 % between widths; where they had moved by a degree, by 9 % and more.
_MAX_ERROR_RATIO = 1.05
_MAX_UNITS = 3.0
# One joint of every pair: the other half has the other side's, so both halves cover the body.
_VALIDATION_JOINTS = np.array([k % 4 in (0, 3) for k in range(len(STABLE_KEYPOINTS))])
# Keypoints of a mean adult with arms out (metres): a rig from people alone is aligned to the given cameras, so only its
# gates are in metres.
_SIDE_M = np.array([[0.16, 0.49], [0.44, 0.47], [0.70, 0.46], [0.10, -0.03], [0.16, -0.45], [0.15, -0.86]])
ADULT_JOINTS_M = np.stack([np.pad(_SIDE_M * [s, 1.0], ((0, 0), (0, 1))) for s in (1.0, -1.0)], axis=1).reshape(-1, 3)


@dataclass(frozen=True)
class MovedCameras:
    """Cameras that are clearly at other poses than given.

    Attributes:
        cameras: with the poses from people.
        seen: the observations of people.
        report: the prior's widths with their validation errors, in error units, and every camera's sigmas.
    """

    cameras: list[Camera]
    seen: Observations
    report: dict[str, Any]


def relocalise(
    given: Sequence[Camera],
    detections: Sequence[Detections],
    watched: Sequence[int],
    frames: Integer[np.ndarray, " F"],
    gate_m: float,
    gain: float,
    limits: Limits,
    bundle: BundleSettings,
    before_px: float,
    allowed_px: float,
    rooms: Sequence[RoomPicture | None] = (),
) -> MovedCameras | None:
    """Cameras at poses from people; None where they did not move, or where people do not determine them.

    ``before_px``: median error as given, NaN where no three cameras agree. The result must be better by the share
    ``gain``, and within ``allowed_px``. ``rooms``: pictures of the room, where there are any. Cameras that are not
    ``watched`` (indices), because they see no people, stay.
    """
    if len(watched) < 2:
        return None
    found = refine_with_wider_prior(
        [given[v] for v in watched],
        [detections[v] for v in watched],
        frames,
        gate_m,
        limits,
        bundle,
        not before_px < allowed_px,
        [rooms[v] for v in watched] if len(rooms) else (),
    )
    if found is None:
        return None
    after_px = error_medians(found.cameras, found.seen, limits)[0]
    if not after_px < min((1 - gain) * (before_px if np.isfinite(before_px) else np.inf), allowed_px):
        return None
    cameras = list(given)
    for v, camera in zip(watched, found.cameras, strict=True):
        cameras[v] = camera
    seen = found.seen if len(watched) == len(given) else make_observations(detections, cameras, frames, gate_m)[0]
    before = before_px if np.isfinite(before_px) else None
    return MovedCameras(cameras, seen, {**found.report, "before_px": before, "after_px": after_px})


def report_moved_cameras(given: Sequence[Camera], found: MovedCameras, between_deg: float) -> None:
    """Log the cameras' new poses and their uncertainty, half of the 95 % interval ``between_deg`` of rotations between
    two."""
    degrees, metres = pose_changes(found.cameras, given)
    place = np.array(list(found.report["sigma_m"].values()))
    warn(
        "keypoints show that cameras have moved since calibration: "
        + ", ".join(
            f"{c.name} turned by {d:.1f}° and moved by {100 * m:.0f} cm" for c, d, m in zip(given, degrees, metres)
        )
        + f"; they are uncertain by ±{between_deg:.1f}° between cameras (95 %) and ±{100 * place.max():.0f} cm (one "
        "standard deviation): calibrate again if that is not enough"
    )


def refine_with_wider_prior(
    given: Sequence[Camera],
    detections: Sequence[Detections],
    frames: Integer[np.ndarray, " F"],
    gate_m: float,
    limits: Limits,
    bundle: BundleSettings,
    lost: bool,
    rooms: Sequence[RoomPicture | None] = (),
) -> MovedCameras | None:
    """The cameras under the narrowest prior that explains validation halves; None where that is ``bundle``'s own.

    Also None with too little evidence. ``lost``: almost nothing agrees with the given cameras. Then wider gates are
    tried too, since identities and poses depend on each other, and at last a rig from people alone (``from_tracks``),
    aligned to the given cameras. The room in ``rooms`` is used with people where it is consistent. For two cameras the
    only validation is by frames and joints outside of the fit, and the room.
    """
    wide = replace(bundle, prior_deg=FREE_DEG, prior_m=FREE_M)
    best: tuple[int, list[Camera]] = (0, [])
    for first in _STARTS if lost else _STARTS[:1]:
        found = _converge(given, given, detections, frames, _ROUNDS[first:], limits, wide)
        best = max(best, found, key=lambda f: f[0])
    if lost and not _use_all_people(best[1], detections, frames, gate_m, limits):
        few = frames[:: max(1, len(frames) // _RIG_FRAMES)]
        followed = dense_tracks(detections, few, limits.min_confidence)
        rig = next(
            (r for r in propose_rigs(followed, given, ADULT_JOINTS_M, gate_m, limits) if len(r.cameras) == len(given)),
            None,
        )
        if rig is not None:
            start = remove_drift([rig.cameras[v] for v in range(len(given))], given)[0]
            best = max(best, _converge(start, given, detections, frames, _ROUNDS[1:], limits, wide), key=lambda f: f[0])
    if not _use_all_people(best[1], detections, frames, gate_m, limits):
        return None
    seen, _ = make_observations(detections, best[1], frames, gate_m)
    rungs = [bundle, replace(bundle, prior_deg=_MIDDLE * bundle.prior_deg, prior_m=_MIDDLE * bundle.prior_m), wide]
    errors = [_unseen_error(seen, best[1], given, limits, rung) for rung in rungs]
    chosen = next((k for k, error in enumerate(errors) if error <= _MAX_ERROR_RATIO * min(errors)), 0)
    used = agreeing_observations(seen, best[1], limits)
    if chosen == 0 or used is None:
        return None
    result = used.adjust(best[1], given, limits, rungs[chosen])
    room = refine_on_room(result.cameras, given, seen, rooms, limits, rungs[chosen]) if len(rooms) else None
    if room is not None and room.fits_people:
        result = room.adjusted
    result = replace(result, cameras=_align_to_unmoved(result.cameras, given, bundle))
    turn_deg, place_m = np.degrees(result.sigma[:, :3]).max(1), result.sigma[:, 3:6].max(1)
    if turn_deg.max() > _MAX_SIGMA_DEG or place_m.max() > _MAX_SIGMA_M:
        return None
    names = [c.name for c in given]
    report = {
        "rungs": [{"prior_deg": r.prior_deg, "prior_m": r.prior_m, "unseen_units": e} for r, e in zip(rungs, errors)],
        "chosen": chosen,
        "sigma_deg": dict(zip(names, turn_deg.tolist())),
        "sigma_m": dict(zip(names, place_m.tolist())),
    }
    if room is not None:
        report["room"] = room.report
    seen = make_observations(detections, result.cameras, frames, gate_m)[0]
    marks_m = room.marks_m(limits) if room is not None and room.fits_people else np.zeros((0, 3))
    floor = floor_under_feet(result.cameras, seen, marks_m, limits)
    cameras = result.cameras
    if floor is not None:
        cameras, tilt_deg, lift_m = align_to_floor(result.cameras, *floor)
        report["levelled"] = {"tilt_deg": tilt_deg, "lift_m": lift_m}
    return MovedCameras(cameras, make_observations(detections, cameras, frames, gate_m)[0], report)


def pose_changes(
    found: Sequence[Camera], given: Sequence[Camera]
) -> tuple[Num[np.ndarray, " V"], Num[np.ndarray, " V"]]:
    """Degrees and metres by which the cameras were turned and moved."""
    turned = np.stack([f.camera_from_world[:3, :3] @ g.camera_from_world[:3, :3].T for f, g in zip(found, given)])
    apart = np.array([f.centre_m - g.centre_m for f, g in zip(found, given)])
    return np.degrees(np.linalg.norm(log(turned), axis=-1)), np.linalg.norm(apart, axis=-1)


def _align_to_unmoved(found: Sequence[Camera], given: Sequence[Camera], bundle: BundleSettings) -> list[Camera]:
    """The cameras aligned to the given ones that moved least, so that a knocked one does not displace the others.

    Cameras that were not estimated are not displaced either.
    """
    weights = np.ones(len(given))
    for _ in range(_LAID):
        laid = remove_drift(found, given, weights.tolist())[0]
        degrees, metres = pose_changes(laid, given)
        weights = 1 / np.maximum(np.hypot(degrees / bundle.prior_deg, metres / bundle.prior_m), 1.0)
    return laid


def _converge(
    start: Sequence[Camera],
    given: Sequence[Camera],
    detections: Sequence[Detections],
    frames: np.ndarray,
    rounds: Sequence[tuple[float, float]],
    limits: Limits,
    bundle: BundleSettings,
) -> tuple[int, list[Camera]]:
    """(observations that agree, cameras) after the rounds; (0, []) with too little agreement or a camera far from its
    given pose."""
    current, used = list(start), None
    for gate_m, units in rounds:
        seen, _ = make_observations(detections, current, frames, gate_m)
        used = agreeing_observations(seen, current, replace(limits, huber_share=limits.huber_share * units))
        if used is None:
            return 0, []
        current = used.adjust(current, given, limits, bundle, units=units).cameras
    degrees, metres = pose_changes(current, given)
    if used is None or degrees.max() > FURTHEST_DEG or metres.max() > FURTHEST_M:
        return 0, []
    return int((used.weights > 0).sum()), current


def _use_all_people(
    cameras: Sequence[Camera], detections: Sequence[Detections], frames: np.ndarray, gate_m: float, limits: Limits
) -> bool:
    """Whether every camera agrees with at least half as many observations as the best one."""
    used = (
        agreeing_observations(make_observations(detections, cameras, frames, gate_m)[0], cameras, limits)
        if cameras
        else None
    )
    counts = (used.weights > 0).sum(1) if used is not None else np.zeros(1)
    return bool(counts.min() > 0.5 * counts.max())


def _unseen_error(
    seen: Observations, found: Sequence[Camera], given: Sequence[Camera], limits: Limits, bundle: BundleSettings
) -> float:
    """Mean validation error in error units, at most 3, of halves of the clip and of the joints after fitting the other
    half.

    Points without agreement of three views (of two, if there are two) count as 3. ``found``: the cameras under the wide
    prior, from which every search starts.
    """
    met = triangulate(seen.pixels, seen.confidence, found, limits)
    counted = met.verified if len(found) > 2 else met.valid
    kept, inliers = seen.of(counted), met.inliers[:, counted]
    early = kept.frame <= np.median(kept.frame)
    half = _VALIDATION_JOINTS[kept.keypoint]
    units, errors = unit_px(found, limits)[:, None], []
    for fit_on in (early, ~early, half, ~half):
        used = agreeing_observations(kept.of(fit_on), found, limits)
        if used is None:
            return float("inf")
        cameras = used.adjust(found, given, limits, bundle).cameras
        validation, agreed_in = kept.of(~fit_on), inliers[:, ~fit_on]
        wide = replace(limits, outlier_units=limits.outlier_units * _MAX_UNITS)
        error = triangulate(validation.pixels, validation.confidence, cameras, wide).error_px / units
        errors.append(np.minimum(np.nan_to_num(error, nan=_MAX_UNITS), _MAX_UNITS)[agreed_in].mean())
    return float(np.mean(errors))
