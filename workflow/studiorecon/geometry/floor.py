# SPDX-License-Identifier: Apache-2.0
"""Which pixels show the floor, and which points lie near people."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool

FLOOR_M = 0.06
"""What lies within this height of the floor is the floor."""


def floor_points(camera: Camera, depth_m: np.ndarray, floor_m: float) -> tuple[np.ndarray, np.ndarray]:
    """World points (H, W, 3) that a depth map (H, W) shows, and which of them are floor (H, W): known depth, at the
    floor's height.

    ``camera`` has the size of ``depth_m``. Raises ValueError for another size.
    """
    require("depth_m", depth_m, camera.hw)
    known = np.isfinite(depth_m) & (depth_m > 0)
    points = camera.unproject(camera.pixel_centres().reshape(-1, 2), np.where(known, depth_m, 1.0).reshape(-1)).reshape(
        *camera.hw, 3
    )
    return points, known & (np.abs(points[..., 2] - floor_m) < FLOOR_M)


def beside(points_m: np.ndarray, places_m: np.ndarray, reach_m: float) -> Bool[np.ndarray, " ..."]:
    """(...,) bool: points (..., 3) within ``reach_m`` of any of the places (A, 2), by their horizontal distance."""
    found = np.zeros(points_m.shape[:-1], bool)
    for x, y in places_m:
        found |= np.hypot(points_m[..., 0] - x, points_m[..., 1] - y) < reach_m
    return found
