# SPDX-License-Identifier: Apache-2.0
"""The share of the room that the cameras see, and the angles between their views."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.images.warp import sample
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Angle between two views from which a surface can be triangulated (T01).
PARALLAX_DEG = 2.0


def stage_points(cameras: Sequence[Camera], step_m: float, height_m: float) -> Float[np.ndarray, "N 3"]:
    """Grid points of the stage between the cameras, from the floor to ``height_m``.

    It is a disc about the point nearest to all optical axes, as wide as the nearest camera's distance.
    """
    centre, radius_m = stage_disc(cameras)
    along = np.arange(-radius_m, radius_m + 1e-9, step_m)
    x, y, z = np.meshgrid(along, along, np.arange(step_m / 2, height_m, step_m), indexing="ij")
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    return points[np.hypot(points[:, 0], points[:, 1]) <= radius_m] + np.array([centre[0], centre[1], 0.0])


def stage_disc(cameras: Sequence[Camera]) -> tuple[Float[np.ndarray, " 2"], float]:
    """Horizontal centre that the cameras look at, and the distance of the nearest of them."""
    positions = np.array([c.centre_m[:2] for c in cameras])
    directions = np.array([c.forward[:2] for c in cameras])
    lengths = np.linalg.norm(directions, axis=1)
    # A camera that looks straight down has no horizontal direction; its own position then is the point that it looks
    # at.
    normals = (
        np.eye(2) - np.einsum("ci,cj->cij", directions, directions) / np.maximum(lengths, 1e-9)[:, None, None] ** 2
    )
    # Parallel axes do not intersect: a small weight on the mean position keeps the solution finite.
    system = normals.sum(axis=0) + 1e-3 * np.eye(2)
    centre = np.linalg.solve(system, np.einsum("cij,cj->i", normals, positions) + 1e-3 * positions.mean(axis=0))
    return centre, float(np.linalg.norm(positions - centre, axis=1).min())


def visible_points(
    points_m: Float[np.ndarray, "N 3"],
    cameras: Sequence[Camera],
    depths_m: Sequence[Float[np.ndarray, "H W"]],
    tolerance: float,
) -> Bool[np.ndarray, "C N"]:
    """Which camera sees which point: inside the picture and not behind the surface of its depth map.

    Unknown depth (0 or non-finite) hides nothing. ``tolerance`` is the share of depth by which a point may be behind
    the surface.
    """
    seen = np.zeros((len(cameras), len(points_m)), bool)
    for index, (camera, depth_m) in enumerate(zip(cameras, depths_m)):
        pixels, z = camera.project(points_m)
        surface, inside = sample(depth_m, pixels[None], "nearest")
        known = np.isfinite(surface[0]) & (surface[0] > 0)
        seen[index] = inside[0] & (z > 0) & (~known | (z <= surface[0] * (1 + tolerance)))
    return seen


def has_parallax(
    points_m: Float[np.ndarray, "N 3"], cameras: Sequence[Camera], seen: Bool[np.ndarray, "C N"], least_deg: float
) -> Bool[np.ndarray, " N"]:
    """Whether at least two cameras see the point from directions at least ``least_deg`` apart (T01)."""
    rays = np.stack([points_m - c.centre_m for c in cameras])
    rays /= np.maximum(np.linalg.norm(rays, axis=-1, keepdims=True), 1e-12)
    apart = np.zeros(len(points_m), bool)
    for i in range(len(cameras)):
        for j in range(i + 1, len(cameras)):
            apart |= seen[i] & seen[j] & ((rays[i] * rays[j]).sum(axis=-1) < np.cos(np.radians(least_deg)))
    return apart


def mean_pair_deg(cameras: Sequence[Camera]) -> float:
    """Mean azimuth between every two cameras about their common centre, degrees; 0 for a single one.

    This is the reading U56 of cameras said to be so many degrees apart: four on an even ring have 120.
    """
    centre, _ = stage_disc(cameras)
    offsets = np.array([c.centre_m[:2] - centre for c in cameras])
    azimuths = np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0]))
    first, second = np.triu_indices(len(cameras), 1)
    apart = np.abs(azimuths[first] - azimuths[second])
    return float(np.minimum(apart, 360 - apart).mean()) if len(first) else 0.0
