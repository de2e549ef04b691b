# SPDX-License-Identifier: Apache-2.0
"""The pose of a held-out camera from people in the other cameras, for judging its pictures.

Its observations move no point and no other camera. As in ``moved_cameras``, the prior at the given pose has several
widths, and the narrower is chosen where it explains the validation halves about as well as the wide one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import least_squares

from studiorecon.geometry.bundle import BundleSettings, move_camera
from studiorecon.geometry.relative_pose import resection
from studiorecon.geometry.rotations import exp, log
from studiorecon.geometry.triangulation import Limits, unit_px
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.rig.moved_cameras import (
    FREE_DEG,
    FREE_M,
    FURTHEST_DEG,
    FURTHEST_M,
    MAX_ERROR_RATIO,
    VALIDATION_JOINTS,
    pose_changes,
)
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer, Num

_MIN_POINTS = 60
_MIN_HALF = 20
_MAX_UNITS = 3.0
# RANSAC's threshold, in error units, wide because the pose is refined afterwards.
_LOOSE = 3.0


@dataclass(frozen=True)
class ObservedJoints:
    """N joints that the other cameras place, as one camera shows them.

    Attributes:
        points_m: in the world.
        pixels: in this camera; ``confidence`` (N,).
        frame, group, keypoint: (N,) frame, person, and index into ``STABLE_KEYPOINTS``.
    """

    points_m: Num[np.ndarray, "N 3"]
    pixels: Num[np.ndarray, "N 2"]
    confidence: Num[np.ndarray, " N"]
    frame: Integer[np.ndarray, " N"]
    group: Integer[np.ndarray, " N"]
    keypoint: Integer[np.ndarray, " N"]

    def of(self, which: Bool[np.ndarray, " N"]) -> ObservedJoints:
        """The joints that ``which`` selects."""
        return ObservedJoints(**{name: getattr(self, name)[which] for name in self.__dataclass_fields__})


@dataclass(frozen=True)
class HeldOutPose:
    """The camera for judging, and its report.

    Attributes:
        camera: the given one, or with the pose from people.
        joints: number of compared joints.
        before_px, after_px: median reprojection error as given and as used; None: too few.
        turned_deg, moved_m: from the given pose to the one used.
        is_verified: whether people suffice to judge the given pose.
    """

    camera: Camera
    joints: int
    before_px: float | None
    after_px: float | None
    turned_deg: float
    moved_m: float
    is_verified: bool


def estimate_held_out_pose(
    given: Camera, seen: ObservedJoints, limits: Limits, bundle: BundleSettings, gain: float
) -> HeldOutPose:
    """The held-out camera at the pose that explains the joints ``seen``.

    It stays at its given pose unless another lowers the validation error by the share ``gain``.
    """
    before_px = _median_px(given, seen)
    if len(seen.frame) < _MIN_POINTS or len(np.unique(seen.frame)) < 2:
        return HeldOutPose(given, len(seen.frame), before_px, before_px, 0.0, 0.0, False)
    unit = float(unit_px([given], limits)[0])
    start = _start_pose(given, seen, unit)
    # Other people's joints, and mixed-up limbs of the network, must not affect any pose.
    seen = seen.of(np.linalg.norm(_units(start, seen, unit), axis=-1) < limits.outlier_units)
    if len(seen.frame) < _MIN_POINTS:
        return HeldOutPose(given, len(seen.frame), before_px, before_px, 0.0, 0.0, False)
    # No width in between: six numbers, and a camera was either moved or not; a compromise would be at neither pose.
    rungs = [bundle, replace(bundle, prior_deg=FREE_DEG, prior_m=FREE_M)]
    as_given = _validation_error(given, given, seen, unit, None)
    errors = [_validation_error(start, given, seen, unit, rung) for rung in rungs]
    if not min(errors) < (1 - gain) * as_given:
        return HeldOutPose(given, len(seen.frame), before_px, before_px, 0.0, 0.0, True)
    chosen = next(k for k, error in enumerate(errors) if error <= MAX_ERROR_RATIO * min(errors))
    found = _fit_pose(start, given, seen, unit, rungs[chosen])
    degrees, metres = pose_changes([found], [given])
    if degrees[0] > FURTHEST_DEG or metres[0] > FURTHEST_M:
        return HeldOutPose(given, len(seen.frame), before_px, before_px, 0.0, 0.0, False)
    return HeldOutPose(
        found, len(seen.frame), before_px, _median_px(found, seen), float(degrees[0]), float(metres[0]), True
    )


def _median_px(camera: Camera, seen: ObservedJoints) -> float | None:
    off = np.linalg.norm(camera.project(seen.points_m)[0] - seen.pixels, axis=-1)
    return float(np.median(np.nan_to_num(off, nan=np.inf))) if len(off) and np.isfinite(off).any() else None


def _start_pose(given: Camera, seen: ObservedJoints, unit: float) -> Camera:
    """The start of the search: a resection, which tolerates many joints of other people; or the given pose."""
    focal, principal = np.array(given.focal_px), np.array(given.principal_px)
    found = resection(seen.points_m, (seen.pixels - principal) / focal, _LOOSE * unit / float(focal.mean()))
    if found is None:
        return given
    camera = replace(given, camera_from_world=found[0])
    degrees, metres = pose_changes([camera], [given])
    near = degrees[0] <= FURTHEST_DEG and metres[0] <= FURTHEST_M
    return min((given, camera), key=lambda c: _error(c, seen, unit)) if near else given


def _units(camera: Camera, seen: ObservedJoints, unit: float) -> np.ndarray:
    """(N, 2) residuals in error units, large behind the camera."""
    off = (camera.project(seen.points_m)[0] - seen.pixels) / unit
    return np.nan_to_num(off, nan=10 * _MAX_UNITS)


def _error(camera: Camera, seen: ObservedJoints, unit: float) -> float:
    return float(np.minimum(np.linalg.norm(_units(camera, seen, unit), axis=-1), _MAX_UNITS).mean())


def _validation_error(
    start: Camera, given: Camera, seen: ObservedJoints, unit: float, rung: BundleSettings | None
) -> float:
    """Mean validation error in error units, at most 3, of halves of the clip and of the joints after fitting the other
    half.

    ``rung`` None: of the given pose, which is not fitted.
    """
    early = seen.frame <= np.median(seen.frame)
    half = VALIDATION_JOINTS[seen.keypoint]
    errors = []
    for fit_on in (early, ~early, half, ~half):
        if min(fit_on.sum(), (~fit_on).sum()) < _MIN_HALF:
            continue
        camera = given if rung is None else _fit_pose(start, given, seen.of(fit_on), unit, rung)
        errors.append(_error(camera, seen.of(~fit_on), unit))
    return float(np.mean(errors)) if errors else float("inf")


def _fit_pose(start: Camera, given: Camera, seen: ObservedJoints, unit: float, rung: BundleSettings) -> Camera:
    """The pose of least Huber cost under the prior of ``rung``.

    All frames of a joint count as one observation, as everywhere in ``rig``.
    """
    joints = len(np.unique(seen.group * len(STABLE_KEYPOINTS) + seen.keypoint))
    weight = seen.confidence * (joints / max(len(seen.frame), 1))
    sigma = np.concatenate([np.full(3, np.radians(rung.prior_deg)), np.full(3, rung.prior_m)])
    rotation, centre = start.camera_from_world[:3, :3], start.centre_m

    def moved(step: np.ndarray) -> Camera:
        return move_camera(given, exp(step[:3]) @ rotation, centre + step[3:])

    def residuals(step: np.ndarray) -> np.ndarray:
        camera = moved(step)
        turned = log(camera.camera_from_world[:3, :3] @ given.camera_from_world[:3, :3].T)
        prior = np.concatenate([turned, camera.centre_m - given.centre_m]) / sigma
        off = _units(camera, seen, unit)
        # Squares of these are Huber costs of the two-dimensional errors.
        error = np.maximum(np.linalg.norm(off, axis=-1), 1.0)
        robust = np.sqrt(weight * (2 * error - 1)) / error
        return np.concatenate([(robust[:, None] * off).ravel(), prior])

    return moved(least_squares(residuals, np.zeros(6), x_scale=sigma).x)
