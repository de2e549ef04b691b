# SPDX-License-Identifier: Apache-2.0
"""The pose of a held-out camera from people in the other cameras, for judging its pictures.

Its observations move no point and no other camera. It stayed, is off by the calibration's error, or was moved: these
are priors of one estimate, and a wider one is used where it lowers the cost by more than chance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtri

from studiorecon.estimate.factors.keypoints import SHARED_M
from studiorecon.geometry.camera_motion import PoseError, move_camera
from studiorecon.geometry.relative_pose import resection
from studiorecon.geometry.rotations import exp, log
from studiorecon.geometry.triangulation import Limits, unit_px
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.rig.calibrated import FREE_DEG, FREE_M, FURTHEST_DEG, FURTHEST_M, pose_changes
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer, Num

_MIN_POINTS = 60
_MAX_UNITS = 3.0
# RANSAC's threshold, in error units, wide because the pose is refined afterwards.
_LOOSE = 3.0
# Least error of a joint that a detector repeats, metres: a third of what real ones showed (``SHARED_M``).
_MIN_SHARED_M = 0.005
# Chance lowers the cost of six numbers by less than this in 99 % of the cases.
_CHANCE = float(chdtri(6, 1 - 0.99))


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


def estimate_held_out_pose(given: Camera, seen: ObservedJoints, limits: Limits, error: PoseError) -> HeldOutPose:
    """The held-out camera at the pose that explains the joints ``seen``; ``error``: the calibration's."""
    before_px = _median_px(given, seen)
    if len(seen.frame) < _MIN_POINTS or len(np.unique(seen.frame)) < 2:
        return HeldOutPose(given, len(seen.frame), before_px, before_px, 0.0, 0.0, False)
    unit = float(unit_px([given], limits)[0])
    start = _start_pose(given, seen, unit)
    # Other people's joints, and mixed-up limbs of the network, must not affect any pose.
    seen = seen.of(np.linalg.norm(_units(start, seen, unit), axis=-1) < limits.outlier_units)
    if len(seen.frame) < _MIN_POINTS:
        return HeldOutPose(given, len(seen.frame), before_px, before_px, 0.0, 0.0, False)
    wide = PoseError(FREE_DEG, FREE_M)
    typical_px = SHARED_M * given.focal_px[0] / start.project(seen.points_m)[1]
    sigma_px = _measured_sigma_px(_fit_pose(start, given, seen, typical_px, wide)[0], seen)
    found, cost = given, float((_residuals(given, given, seen, sigma_px, error) ** 2).sum())
    for trust in (error, wide):
        fitted, fitted_cost = _fit_pose(start, given, seen, sigma_px, trust)
        if cost - fitted_cost > _CHANCE:
            found, cost = fitted, fitted_cost
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


def _units(camera: Camera, seen: ObservedJoints, unit: float | np.ndarray) -> np.ndarray:
    """(N, 2) residuals in error units, large behind the camera."""
    off = (camera.project(seen.points_m)[0] - seen.pixels) / unit
    return np.nan_to_num(off, nan=10 * _MAX_UNITS)


def _error(camera: Camera, seen: ObservedJoints, unit: float) -> float:
    return float(np.minimum(np.linalg.norm(_units(camera, seen, unit), axis=-1), _MAX_UNITS).mean())


def _measured_sigma_px(camera: Camera, seen: ObservedJoints) -> np.ndarray:
    """(N,) standard deviations by the residuals of ``camera``: of one frame, and of what all frames of a joint share,
    so that their mean has the right one."""
    pixels, depth_m = camera.project(seen.points_m)
    off_m = (pixels - seen.pixels) * (depth_m / camera.focal_px[0])[:, None]
    joint = np.unique(seen.group * len(STABLE_KEYPOINTS) + seen.keypoint, return_inverse=True)[1]
    count = np.bincount(joint)
    means_m = np.stack([np.bincount(joint, o) / count for o in off_m.T], axis=1)
    freedom = max(2 * (len(seen.frame) - len(count)), 1)
    of_frame = ((off_m - means_m[joint]) ** 2).sum() / freedom
    shared = (means_m**2).sum() / max(2 * len(count) - 6, len(count)) - of_frame / count.mean()
    return np.sqrt(of_frame + count[joint] * max(shared, _MIN_SHARED_M**2)) / depth_m * camera.focal_px[0]


def _residuals(
    camera: Camera, given: Camera, seen: ObservedJoints, sigma_px: np.ndarray, trust: PoseError
) -> np.ndarray:
    """(2 N + 6,) residuals: squares of the first ones are Huber costs of the two-dimensional errors, the last ones are
    of the prior ``trust``.
    """
    off = _units(camera, seen, sigma_px[:, None])
    error = np.maximum(np.linalg.norm(off, axis=-1), 1.0)
    robust = np.sqrt(seen.confidence / seen.confidence.mean() * (2 * error - 1)) / error
    turned = log(camera.camera_from_world[:3, :3] @ given.camera_from_world[:3, :3].T) / np.radians(trust.turn_deg)
    prior = [turned, (camera.centre_m - given.centre_m) / trust.move_m]
    return np.concatenate([(robust[:, None] * off).ravel(), *prior])


def _fit_pose(
    start: Camera, given: Camera, seen: ObservedJoints, sigma_px: np.ndarray, trust: PoseError
) -> tuple[Camera, float]:
    """The pose of least cost, and that."""
    rotation, centre_m = start.camera_from_world[:3, :3], start.centre_m

    def moved(step: np.ndarray) -> Camera:
        return move_camera(given, exp(step[:3]) @ rotation, centre_m + step[3:])

    sigma = np.repeat([np.radians(trust.turn_deg), trust.move_m], 3)
    found = least_squares(
        lambda step: _residuals(moved(step), given, seen, sigma_px, trust), np.zeros(6), x_scale=sigma
    )
    return moved(found.x), 2 * float(found.cost)
