# SPDX-License-Identifier: Apache-2.0
"""First Gaussians of a room: flat ones on measured depth; without depth, a floor and a random volume."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.depth_surface import points_and_normals
from studiorecon.images.warp import sample
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.discs import make_discs

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer, Num

# Thickness of a flat Gaussian as a share of its width: thin enough for grazing views, thick enough to keep a gradient.
FLATNESS = 0.15
# At a larger jump in depth than this share there is no Gaussian: its normal would tilt between two surfaces.
_EDGE_SHARE = 0.24
# Surfaces of two photos that are nearer to each other than this share of their depth are one.
SAME_SURFACE = 0.03
# Opacity of Gaussians at random positions: low enough for gradients to reach those behind them.
_FAINT = 0.1


def seeds_from_depth(
    camera: Camera,
    rgb: Num[np.ndarray, "H W 3"],
    wanted: Bool[np.ndarray, "H W"],
    depth_m: Num[np.ndarray, "H W"],
    stride: int,
    size: float,
    opacity: float,
    sh_degree: int,
) -> tuple[Gaussians, Integer[np.ndarray, "N 2"]]:
    """One flat Gaussian per ``stride`` × ``stride`` pixels where ``wanted``, and its (row, column).

    ``size`` is its sigma as a share of the distance to its neighbour, stretched on slanted surfaces.
    """
    points, normals, usable = points_and_normals(depth_m, camera, _EDGE_SHARE)
    grid = np.zeros(depth_m.shape, bool)
    grid[stride // 2 :: stride, stride // 2 :: stride] = True
    rows, columns = np.nonzero(grid & usable & wanted)
    at = rows, columns
    rays = points[at] - camera.centre_m
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    facing = np.maximum(np.abs(np.sum(normals[at] * rays, axis=1)), 0.2)
    spacing_m = depth_m[at] / np.mean(camera.focal_px) * stride
    made = make_discs(
        points[at], normals[at], rgb[at], spacing_m * size / np.sqrt(facing), FLATNESS, opacity, sh_degree
    )
    return made, np.stack(at, axis=1)


def finest_pixels(
    cameras: Sequence[Camera], depths_m: Sequence[Num[np.ndarray, "H W"]], known: Sequence[Bool[np.ndarray, "H W"]]
) -> list[Bool[np.ndarray, "H W"]]:
    """``known`` pixels of every camera whose surface no other camera shows at a higher resolution.

    A second set of discs slightly in front or behind costs as much as the first and shows almost nothing more.
    """
    views = [points_and_normals(depth_m, camera, _EDGE_SHARE) for camera, depth_m in zip(cameras, depths_m)]
    fine = [
        np.where(valid & own, _pixels_per_m2(camera, points, normals), 0)
        for camera, own, (points, normals, valid) in zip(cameras, known, views)
    ]
    wanted = []
    for first, (points, normals, _) in enumerate(views):
        best = fine[first] > 0
        for second, camera in enumerate(cameras):
            if second == first:
                continue
            pixels, distance_m = camera.project(points)
            depth_m, inside = sample(depths_m[second], pixels, "nearest")
            started, _ = sample(fine[second] > 0, pixels, "nearest")
            same = inside & (distance_m > 0) & (np.abs(depth_m - distance_m) < SAME_SURFACE * distance_m)
            best &= ~(same & started & (_pixels_per_m2(camera, points, normals) > fine[first]))
        wanted.append(best)
    return wanted


def _pixels_per_m2(
    camera: Camera, points: Num[np.ndarray, "H W 3"], normals: Num[np.ndarray, "H W 3"]
) -> Num[np.ndarray, "H W"]:
    """Number of a camera's pixels per square metre of surface at ``points``."""
    rays = points - camera.centre_m
    distance_m = np.maximum(np.linalg.norm(rays, axis=-1), 1e-9)
    facing = np.abs(np.sum(rays * normals, axis=-1)) / distance_m
    return np.mean(camera.focal_px) ** 2 * facing / distance_m**2


def random_volume(
    cameras: list[Camera], count: int, size_m: float, sh_degree: int, rng: np.random.Generator
) -> Gaussians:
    """Grey Gaussians for photos without depth: a quarter of ``count`` on the floor, the rest at random in a box.

    The box is 1.25 times the ring of cameras wide and as high as 1.5 times their mean height (at least 2.5 m). This is
    the paper's 4-view baseline, which has no points to start from (see config/presets/fourview.yaml).
    """
    centres = np.array([c.centre_m for c in cameras])
    middle = centres[:, :2].mean(axis=0)
    half = 1.25 * np.linalg.norm(centres[:, :2] - middle, axis=1).max()
    height = max(2.5, 1.5 * centres[:, 2].mean())
    points = rng.uniform(
        [middle[0] - half, middle[1] - half, 0.0], [middle[0] + half, middle[1] + half, height], (count, 3)
    )
    points[: count // 4, 2] = 0.0
    grey = np.full((count, 3), 0.5)
    return make_discs(points, np.tile([0.0, 0.0, 1.0], (count, 1)), grey, size_m, 1.0, _FAINT, sh_degree)
