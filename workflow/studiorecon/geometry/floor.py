# SPDX-License-Identifier: Apache-2.0
"""Pixels that show the floor, and points near people."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

FLOOR_M = 0.06
"""Points within this height of the floor count as floor."""


def floor_points(
    camera: Camera, depth_m: Num[np.ndarray, "H W"], floor_m: float
) -> tuple[Num[np.ndarray, "H W 3"], Bool[np.ndarray, "H W"]]:
    """World points that a depth map shows, and which of them are floor; ``camera`` has the map's size.

    Raises ValueError for another size.
    """
    require("depth_m", depth_m, camera.hw)
    known = np.isfinite(depth_m) & (depth_m > 0)
    points = camera.unproject(camera.pixel_centres().reshape(-1, 2), np.where(known, depth_m, 1.0).reshape(-1)).reshape(
        *camera.hw, 3
    )
    return points, known & (np.abs(points[..., 2] - floor_m) < FLOOR_M)


def is_near(
    points_m: Num[np.ndarray, "... 3"], places_m: Num[np.ndarray, "A 2"], reach_m: float
) -> Bool[np.ndarray, " ..."]:
    """Points within ``reach_m`` of any of the places, by their horizontal distance."""
    found = np.zeros(points_m.shape[:-1], bool)
    for x, y in places_m:
        found |= np.hypot(points_m[..., 0] - x, points_m[..., 1] - y) < reach_m
    return found
