# SPDX-License-Identifier: Apache-2.0
"""Detects one camera that all others contradict, and the probable mix-up.

Robust estimation hides it: triangulation leaves its rays out, all errors stay small, and its pictures are still used in
training. So every camera in turn is tested for people at the positions from the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.keypoints.coordinate_readings import affine, apply_reading, size_readings, turned_readings
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS, stable_detections
from studiorecon.progress import warn
from studiorecon.rig.agreement import contradicted_share
from studiorecon.rig.correspondences import Observations, make_observations
from studiorecon.rig.from_tracks import scale_camera
from studiorecon.rig.human_size import UNITS_PER_METRE
from studiorecon.rig.starts import CONVENTIONS, error_nats, posed
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# A keypoint agrees when it is within this share of the longer image side of the others' prediction: three times the
# largest error of a calibration (``AgreementLimits.max_error_share``), since clocks and detectors add errors.
_REACH_SHARE = 0.03
# … or within so many metres of it: front and side views mark points of a shoulder 0.05 to 0.15 m apart, a tenth of the
# picture at 1 m. Beyond about 3 m the share above is larger.
_REACH_M = 0.1
# Share of keypoints at the others' people, relative to that share among the others (their median): contradicted below
# the first, explained from the second. With one mix-up in one camera of a studio it was 0 to 0.3, and 1.1 after
# correction; without any, or with the focal length 25 % off, 0.8 to 1.
_CONTRADICTED, _EXPLAINED = 0.4, 0.8
# The others outvote a camera only if they agree themselves: at least this share, on so many points in so many frames.
_OTHERS_AGREE, _MIN_POINTS, _MIN_FRAMES = 0.3, 60, 5
_LOOSE = 3.0
_FRAMES = 48
# Share of contradicted points (``agreement.contradicted_share``) above which one camera must be wrong: 0.2 to 0.75
# without a mix-up (people that two cameras confuse are contradicted too), 0.96 and more with one.
_WRONG_SOMEWHERE = 0.9
_MAX_LAG = 90
# A knocked tripod turns by less than this.
_MAX_TURNED_DEG = 45.0
_COUNT = len(STABLE_KEYPOINTS)
_OTHER_SIDE = np.arange(_COUNT).reshape(-1, 2)[:, ::-1].reshape(-1)
_FOCAL = np.geomspace(1 / 40, 40, 75)
_CAUSES = {
    "poses are world-from-camera": "were world-from-camera",
    "axes are OpenGL's": "had OpenGL's axes",
    "world-from-camera with OpenGL axes": "were world-from-camera with OpenGL's axes",
}


@dataclass(frozen=True)
class OutlierCamera:
    """A camera that disagrees with all others.

    Attributes:
        camera: its name.
        share: of its keypoints that are at the others' people.
        share_if_cause: the same if ``cause`` were true.
        cause: the probable mix-up; empty where no tested one explains it.
        remedy: for the user.
        turned: whether a camera that was turned since it was calibrated would disagree in the same way.
    """

    camera: str
    share: float
    share_if_cause: float
    cause: str
    remedy: str
    turned: bool = False

    def sentence(self) -> str:
        """The problem and its remedy."""
        then = f", {self.share_if_cause:.0%} would if {self.cause}" if self.cause else ""
        return (
            f"camera {self.camera} disagrees with all others: {self.share:.0%} of its keypoints agree with "
            f"theirs{then}; {self.remedy}"
        )


@dataclass(frozen=True)
class _Reading:
    cause: str
    remedy: str
    camera: Camera
    seen: Num[np.ndarray, "F M K 2"]
    turned: bool = False


def find_outlier_camera(
    cameras: Sequence[Camera],
    detections: Sequence[Detections],
    frames: Integer[np.ndarray, " F"],
    gate_m: float,
    limits: Limits,
) -> OutlierCamera | None:
    """The camera that the others, who agree with one another, contradict; None without one.

    At most 48 of ``frames`` are used. With three cameras one is named only together with its mix-up, because two rays
    always meet somewhere. With fewer than three none is named.
    """
    if len(cameras) < 3:
        return None
    chosen = frames[spread_indices(len(frames), _FRAMES)]
    own = [_by_frame(d, chosen) for d in stable_detections(detections)]
    found: list[tuple[float, OutlierCamera]] = []
    for v, camera in enumerate(cameras):
        rest = [k for k in range(len(cameras)) if k != v]
        points = _points([cameras[k] for k in rest], [detections[k] for k in rest], chosen, gate_m, limits)
        usual = float(np.median([_agreement(points, own[k], cameras[k])[0] for k in rest]))
        share, _, counted = _agreement(points, own[v], camera)
        if (
            min(np.isfinite(points[..., 0]).sum(), counted) < _MIN_POINTS
            or usual < _OTHERS_AGREE
            or share > _CONTRADICTED * usual
        ):
            continue
        readings = _readings(v, cameras, detections, own, chosen, points)
        tried = [(_agreement(points, r.seen, r.camera), r) for r in readings]
        (then, score, _), best = max(tried, key=lambda row: (row[0][0] >= _EXPLAINED * usual, row[0][1]))
        if then >= _EXPLAINED * usual:
            found.append((score, OutlierCamera(camera.name, share, then, best.cause, best.remedy, best.turned)))
        elif len(cameras) > 3 and _in_picture(points, camera) >= _MIN_POINTS:
            remedy = (
                "check that its video, keypoints and calibration are of one camera and one take, or leave it out "
                f"(train: [{', '.join(cameras[k].name for k in rest)}] in capture.yaml)"
            )
            found.append((0.0, OutlierCamera(camera.name, share, share, "", remedy)))
    return max(found, key=lambda row: row[0], default=(0.0, None))[1]


def _by_frame(seen: Detections, frames: np.ndarray) -> np.ndarray:
    """(F, M, K, 2) pixels of the at most M people in each of the frames, NaN where there is none."""
    of_frame = [np.flatnonzero(seen.frame == f) for f in frames]
    grid = np.full((len(frames), max([len(o) for o in of_frame] + [1]), _COUNT, 2), np.nan)
    for t, which in enumerate(of_frame):
        keypoints = seen.keypoints[which]
        grid[t, : len(which)] = np.where(keypoints[..., 2:] > 0, keypoints[..., :2], np.nan)
    return grid


def _points(
    cameras: Sequence[Camera], detections: Sequence[Detections], frames: np.ndarray, gate_m: float, limits: Limits
) -> np.ndarray:
    """(F, G, K, 3) world points of the people on which these cameras agree, otherwise NaN."""
    seen, _ = make_observations(detections, cameras, frames, gate_m)
    if not len(seen.frame):
        return np.full((len(frames), 1, _COUNT, 3), np.nan)
    wide = replace(limits, outlier_units=limits.outlier_units * _LOOSE)
    found = triangulate(seen.pixels, seen.confidence, cameras, wide)
    counted = found.verified if len(cameras) > 2 else found.valid
    grid = np.full((len(frames), int(seen.group.max()) + 1, _COUNT, 3), np.nan)
    place = np.searchsorted(frames, seen.frame[counted])
    grid[place, seen.group[counted], seen.keypoint[counted]] = found.points_m[counted]
    return grid


def _project(points_m: np.ndarray, camera: Camera) -> np.ndarray:
    """(F, G, K, 2) pixels, NaN behind the camera and where there is no point."""
    with np.errstate(over="ignore", invalid="ignore"):
        pixels, depth = camera.project(points_m)
    return np.where((np.nan_to_num(depth) > 0)[..., None] & np.isfinite(pixels), pixels, np.nan)


def _agreement(points_m: np.ndarray, seen: np.ndarray, camera: Camera) -> tuple[float, float, int]:
    """Share of a camera's keypoints (F, M, K, 2) that are at the points (F, G, K, 3), their mean log-likelihood ratio
    against chance, and their number.

    Only keypoints in frames with a known joint of the same name count; zeros with too few frames.
    """
    known = np.isfinite(points_m[..., 0]).any(axis=1)  # (F, K)
    counted = np.isfinite(seen[..., 0]) & known[:, None]
    if counted.any(axis=(1, 2)).sum() < _MIN_FRAMES:
        return 0.0, 0.0, 0
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        apart = np.linalg.norm(seen[:, :, None] - _project(points_m, camera)[:, None], axis=-1)
        metres_px = _REACH_M * camera.focal_px[0] / camera.project(points_m)[1]
    gate = np.fmax(_REACH_SHARE, metres_px / max(camera.wh))[:, None]
    nats = error_nats(np.nan_to_num(apart, nan=np.inf) / max(camera.wh), gate).max(axis=2)[counted]
    return float((nats > 0).mean()), float(nats.mean()), int(counted.sum())


def _in_picture(points_m: np.ndarray, camera: Camera) -> int:
    """Number of points in the picture as calibrated."""
    pixels = np.nan_to_num(_project(points_m, camera), nan=-1.0)
    return int(((pixels >= 0) & (pixels < camera.wh)).all(axis=-1).sum())


def _readings(
    v: int,
    cameras: Sequence[Camera],
    detections: Sequence[Detections],
    own: Sequence[np.ndarray],
    frames: np.ndarray,
    points_m: np.ndarray,
) -> Iterator[_Reading]:
    """Yields camera ``v`` with one property changed at a time; of two equally good ones the first counts."""
    camera, seen = cameras[v], own[v]
    check_video = "bring its video and keypoints from the calibrated camera"
    for k, other in enumerate(cameras):
        if k != v and _same(seen, own[k]):
            cause = f"they were those of {other.name} (the files are identical)"
            yield _Reading(cause, f"bring the footage or keypoints of {camera.name}", other, seen)
        if k != v:
            remedy = f"exchange its files with those of {other.name}, or bring them again"
            there = replace(camera, camera_from_world=other.camera_from_world)
            yield _Reading(f"its pose were that of {other.name}", remedy, there, seen)
    pixels = affine(1, 1)
    for reading in [*turned_readings(camera.wh, pixels, pixels), *size_readings(camera.wh, 0.0)]:
        shown = apply_reading(reading.film_from_recorded, seen)
        yield _Reading(f"its keypoints were {reading.words}", check_video, camera, shown)
        if reading.words.startswith("mirrored"):
            yield _Reading("its video were mirrored", check_video, camera, shown[:, :, _OTHER_SIDE])
    moved = _offset_px(points_m, seen, camera)
    if moved is not None:
        right, down = (-moved).round().astype(int)
        cause = f"they were {right} px further right and {down} px further down, as in an uncropped picture"
        turned_deg = float(np.degrees(np.arctan(np.linalg.norm(moved / camera.focal_px))))
        turned, remedy = turned_deg < _MAX_TURNED_DEG, check_video
        if turned:
            cause += f", or by a camera that has not been turned by {turned_deg:.0f}° since it was calibrated"
            remedy += ", or calibrate it again"
        yield _Reading(cause, remedy, camera, seen - moved, turned)
    yield from _calibration_readings(camera, seen)
    for lag in range(-_MAX_LAG, _MAX_LAG + 1):
        if lag:
            cause = f"its frames were numbered about {abs(lag)} {'lower' if lag > 0 else 'higher'}"
            remedy = "check the time offsets in the log of clocks.offsets, or write starts into capture.yaml"
            yield _Reading(cause, remedy, camera, _by_frame(stable_detections([detections[v]])[0], frames + lag))


def _offset_px(points_m: np.ndarray, seen: np.ndarray, camera: Camera) -> np.ndarray | None:
    """(2,) offset in pixels of most of a camera's keypoints from the points; None without comparable ones."""
    apart = (seen[:, :, None] - _project(points_m, camera)[:, None]).reshape(-1, 2)
    apart = apart[np.isfinite(apart).all(axis=-1)]
    if not len(apart):
        return None
    reach = _REACH_SHARE * max(camera.wh)
    cells, count = np.unique(np.round(apart / reach), axis=0, return_counts=True)
    middle = cells[np.argmax(count)] * reach
    return np.median(apart[np.linalg.norm(apart - middle, axis=-1) <= reach], axis=0)


def _calibration_readings(camera: Camera, seen: np.ndarray) -> Iterator[_Reading]:
    """The same, with another lens or pose in the calibration."""
    poses = {_CAUSES[name]: posed(camera, change) for name, (change, _) in CONVENTIONS.items()}
    for unit, per_metre in UNITS_PER_METRE.items():
        poses[f"were in {unit}"] = scale_camera(camera, 1 / per_metre)
        poses[f"were in metres, not {unit}"] = scale_camera(camera, per_metre)
    for cause, there in poses.items():
        yield _Reading(f"its pose in the calibration {cause}", "correct it there", there, seen)
    for factor in _FOCAL:
        intrinsics = np.array(camera.intrinsics, dtype=np.float64)
        with np.errstate(over="ignore"):
            intrinsics[[0, 1], [0, 1]] *= factor
        if np.isfinite(intrinsics).all():
            cause = (
                f"its focal length were about {intrinsics[0, 0]:.0f} px of this picture, not {camera.focal_px[0]:.4g}"
            )
            remedy = "correct it in the calibration (pixels, not millimetres, and of the size of picture that it names)"
            yield _Reading(cause, remedy, replace(camera, intrinsics=intrinsics), seen)


def _same(one: np.ndarray, two: np.ndarray) -> bool:
    """Whether two cameras have the same keypoints, nearly to the pixel."""
    people = min(one.shape[1], two.shape[1])
    apart = np.linalg.norm(one[:, :people] - two[:, :people], axis=-1)
    apart = apart[np.isfinite(apart)]
    return len(apart) >= _MIN_POINTS and bool(np.median(apart) < 0.5)


def warn_of_outlier_cameras(
    cameras: Sequence[Camera],
    seen: Observations,
    detections: Sequence[Detections],
    each_px: Sequence[float | None],
    limit_px: float,
    limits: Limits,
    warned: Sequence[bool],
) -> None:
    """Warn of cameras whose people no two others confirm, or with large errors, and of an error without a known camera.

    ``each_px`` are the median errors of the cameras, ``limit_px`` their limit; ``warned``: cameras with a warning
    before.
    """
    if len(cameras) < 3:
        return
    help_ = "check that its video, keypoints and calibration belong together, or leave it out (train in capture.yaml)"
    for camera, own, px, already in zip(cameras, detections, each_px, warned):
        if not already and len(own.frame) and (px is None or px > limit_px):
            how = (
                "has no keypoints that fit two other cameras"
                if px is None
                else f"shows people {px:.0f} px off the other cameras' people"
            )
            warn(f"camera {camera.name} {how}; {help_}")
    share = contradicted_share(cameras, seen, detections, limits) if len(seen.frame) else 0.0
    if share > _WRONG_SOMEWHERE:
        warn(
            f"in {share:.0%} of the cases another camera contradicts two that agree on a person; one of "
            f"{', '.join(c.name for c in cameras)} is probably of another take, mirrored, late or calibrated in "
            "another unit"
        )
