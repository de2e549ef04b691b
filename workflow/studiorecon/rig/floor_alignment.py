# SPDX-License-Identifier: Apache-2.0
"""Keeps the floor level: a refinement may move cameras, but not tilt or lift the floor.

People hardly show it if all cameras pitch together, but a film does: feet sink into the floor. So the floor under the
refined cameras is compared with the floor before. Where it has moved by more than its uncertainty, the whole rig is
moved back, which changes no pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.bundle import move_camera
from studiorecon.geometry.rotations import turn_to_z
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.rig.correspondences import Observations
from studiorecon.rig.gravity import ANKLE_HEIGHT_M, lower_feet
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Num

# Number of parts that are left out in turn to estimate the floor's uncertainty.
_PARTS = 10
_MIN = 30
# A smaller change is invisible.
_MIN_DEG, _MIN_M = 0.05, 0.003
# No refinement tilts or lifts a floor by more: then feet rise, or are on an object (a real man who balances in one
# place: 42 degrees, 0.44 m).
_MAX_DEG, _MAX_M = 10.0, 0.15
_SIGMAS = 2.0
# Sigma of a detector's ankles.
_FEET_M = 0.015


@dataclass(frozen=True)
class Floor:
    """The floor relative to z = 0: its slope along x and y and its height at (0, 0), metres, with their covariance."""

    slope_height: Num[np.ndarray, " 3"]
    covariance: Num[np.ndarray, "3 3"]

    @property
    def tilt_deg(self) -> float:
        return float(np.degrees(np.arctan(np.hypot(*self.slope_height[:2]))))

    @property
    def tilt_sigma_deg(self) -> float:
        return float(np.degrees(np.sqrt(np.trace(self.covariance[:2, :2]))))


def fit_floor(points_m: Num[np.ndarray, "N 3"], height_m: Num[np.ndarray, " N"]) -> Floor | None:
    """The plane of the changes ``height_m`` (N,) over positions ``points_m`` (N, 3), robustly; None with too few.

    Its covariance is the scatter between parts of the points in their order, because they are not independent.
    """
    known = np.isfinite(points_m).all(-1) & np.isfinite(height_m)
    points_m, height_m = points_m[known], height_m[known]
    if len(points_m) < _MIN:
        return None
    part = np.arange(len(points_m)) * _PARTS // len(points_m)
    whole = _plane(points_m, height_m)
    without = np.stack([_plane(points_m[part != k], height_m[part != k]) for k in range(_PARTS)])
    off = without - without.mean(0)
    return Floor(whole, (_PARTS - 1) / _PARTS * off.T @ off)


def _plane(points_m: np.ndarray, height_m: np.ndarray) -> np.ndarray:
    middle = points_m[:, :2].mean(0)
    design = np.column_stack([points_m[:, :2] - middle, np.ones(len(points_m))])
    weight = np.ones(len(points_m))
    found: np.ndarray = np.zeros(3)
    for _ in range(10):
        # An undetermined slope (one spot, a line) stays 0.
        found = np.linalg.lstsq(design * weight[:, None], height_m * weight, rcond=1e-2)[0]
        rest = np.abs(height_m - design @ found)
        weight = np.sqrt(1 / np.maximum(rest / max(2 * float(np.median(rest)), 1e-6), 1.0))
    return np.append(found[:2], found[2] - found[:2] @ middle)


def floor_under_feet(
    cameras: Sequence[Camera], seen: Observations, marks_m: Num[np.ndarray, "M 3"], limits: Limits
) -> tuple[Floor, Num[np.ndarray, " 2"]] | None:
    """The floor under people by ``cameras``, and the middle of their positions; None with too few feet.

    Its slope is that of the plane through ``marks_m``, points on it, where there are enough, because a detector's
    ankles are all too high, or too low, by some centimetres.
    """
    if not len(seen.frame):
        return None
    found = triangulate(seen.pixels, seen.confidence, cameras, limits)
    feet_m = lower_feet(found.points_m, seen, found.verified if len(cameras) > 2 else found.valid)
    by_feet, by_marks = fit_floor(feet_m, feet_m[:, 2] - ANKLE_HEIGHT_M), fit_floor(marks_m, marks_m[:, 2])
    if by_feet is None:
        return None
    middle_m: np.ndarray = np.median(feet_m[:, :2], axis=0)
    spread_m = max(float(np.sqrt(np.linalg.eigvalsh(np.cov(feet_m[:, :2].T))[0])), 0.05)
    slope, covariance = by_feet.slope_height[:2], by_feet.covariance.copy()
    covariance[:2, :2] += np.eye(2) * (_FEET_M / spread_m) ** 2
    if by_marks is not None and np.trace(by_marks.covariance[:2, :2]) < np.trace(covariance[:2, :2]):
        slope, covariance = by_marks.slope_height[:2], by_marks.covariance.copy()
    height_m = float(by_feet.slope_height @ [*middle_m, 1.0])
    covariance[2] = covariance[:, 2] = 0.0
    # The height is that of the feet about their middle, whatever the floor's slope.
    covariance[:2, 2] = covariance[2, :2] = -covariance[:2, :2] @ middle_m
    feet_sigma = float(np.array([*middle_m, 1.0]) @ by_feet.covariance @ [*middle_m, 1.0]) + _FEET_M**2
    covariance[2, 2] = feet_sigma + middle_m @ covariance[:2, :2] @ middle_m
    return Floor(np.array([*slope, height_m - slope @ middle_m]), covariance), middle_m


def align_to_floor(
    cameras: Sequence[Camera], floor: Floor, at_m: Num[np.ndarray, " 2"]
) -> tuple[list[Camera], float, float]:
    """The cameras in a world whose floor is at z = 0 about ``at_m``, and its tilt and lift (degrees, metres) there.

    (cameras, 0, 0) where that is within its uncertainty, or invisible. A slope or a height too large for a refinement
    moves nothing.
    """
    lift_m = float(floor.slope_height @ [*at_m, 1.0])
    lift_sigma = float(np.sqrt([*at_m, 1.0] @ floor.covariance @ [*at_m, 1.0]))
    tilted = max(_MIN_DEG, _SIGMAS * floor.tilt_sigma_deg) < floor.tilt_deg <= _MAX_DEG
    lifted = max(_MIN_M, _SIGMAS * lift_sigma) < abs(lift_m) <= _MAX_M
    if not (tilted or lifted):
        return list(cameras), 0.0, 0.0
    normal = np.array([*(-floor.slope_height[:2] if tilted else (0.0, 0.0)), 1.0])
    normal /= np.linalg.norm(normal)
    rotation = turn_to_z(normal)
    about = np.array([*at_m, lift_m if lifted else 0.0])
    to = np.array([*at_m, 0.0])
    back = [
        move_camera(c, c.camera_from_world[:3, :3] @ rotation.T, rotation @ (c.centre_m - about) + to) for c in cameras
    ]
    return back, floor.tilt_deg if tilted else 0.0, lift_m if lifted else 0.0
