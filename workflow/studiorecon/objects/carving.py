# SPDX-License-Identifier: Apache-2.0
"""The surface of an object of any shape, carved on a grid from crops in its own frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.arrays import spread_indices
from studiorecon.images.warp import sample
from studiorecon.objects.residual import ROOM
from studiorecon.objects.rigid import ObjectCrop, mean_colours, outline_reach_m
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.discs import DISC_WIDTH, make_discs

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Cells along each axis of the first grid, the bounds of the second, and number of crops that carve, spread over all.
_CELLS, _CELLS_BETWEEN, _LOOKS = 40, (16, 72), 96
# A cell is outside when more than this share of the crops shows the room there, or when one of at most so many does.
_OUTSIDE, _FEW = 0.06, 8
# Distance of the outermost outlines from the middle, as a quantile; margin beyond it.
_FARTHEST, _ROOM = 0.98, 1.15
# Sigma, in cells, of the blur whose gradient is the normal.
_SLOPE = 1.0


def reach_m(looks: Sequence[ObjectCrop]) -> float:
    """Radius in metres around the middle that contains nearly all outlines; NaN without an outline."""
    found = np.concatenate([np.zeros(0), *(outline_reach_m(look) for look in looks)])
    return float(np.quantile(found, _FARTHEST)) if len(found) else float("nan")


def carve_surface(
    looks: Sequence[ObjectCrop], count: int
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"], float]:
    """Points on the surface in the object's frame, metres, about ``count``; outward normals; spacing, metres.

    There are no points where the crops leave nothing.
    """
    half_m = _ROOM * reach_m(looks)
    nothing = np.zeros((0, 3)), np.zeros((0, 3)), float("nan")
    if not np.isfinite(half_m):
        return nothing
    chosen = _spread(looks)
    points = _surface(chosen, half_m, _CELLS)[0]
    if not len(points):
        return nothing
    # The number of cells on the surface grows with the square of the cells across.
    return _surface(chosen, half_m, int(np.clip(_CELLS * np.sqrt(count / len(points)), *_CELLS_BETWEEN)))


def volume_m3(looks: Sequence[ObjectCrop]) -> float:
    """Volume of the carved object, cubic metres; infinite without an outline."""
    half_m = _ROOM * reach_m(looks)
    return (
        float(_solid(_spread(looks), half_m, _CELLS).sum() * (2 * half_m / _CELLS) ** 3)
        if np.isfinite(half_m)
        else np.inf
    )


def _solid(looks: Sequence[ObjectCrop], half_m: float, cells: int) -> np.ndarray:
    """(cells, cells, cells) bool: cells of a cube around the middle that the crops do not carve away."""
    axis = (np.arange(cells) + 0.5) * (2 * half_m / cells) - half_m
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    outside = np.zeros(len(points))
    for look in looks:
        pixels, depth_m = look.camera.project(points)
        state, within = sample(look.state, pixels[None], "nearest")
        # Beyond the crop is room, and a camera measures nothing behind it.
        outside += np.where(within[0], state[0] == ROOM, True) & (depth_m > 0)
    allowed = _OUTSIDE * len(looks) if len(looks) > _FEW else 0.0
    return (outside <= allowed).reshape(cells, cells, cells)


def _surface(looks: Sequence[ObjectCrop], half_m: float, cells: int) -> tuple[np.ndarray, np.ndarray, float]:
    cell_m = 2 * half_m / cells
    solid = np.pad(_solid(looks, half_m, cells), 1)
    skin_cells = solid & ~scipy.ndimage.binary_erosion(solid)
    blurred = scipy.ndimage.gaussian_filter(solid.astype(np.float32), _SLOPE)
    slope = -np.stack([g[skin_cells] for g in np.gradient(blurred)], axis=1)
    length = np.linalg.norm(slope, axis=1, keepdims=True)
    normals = np.where(length > 1e-6, slope / np.maximum(length, 1e-6), 0.0)
    # Cells of the skin are half a cell inside the surface.
    return (np.argwhere(skin_cells) - 0.5) * cell_m - half_m + 0.5 * cell_m * normals, normals, cell_m


def init_carved_surface(looks: Sequence[ObjectCrop], count: int) -> tuple[Gaussians, Bool[np.ndarray, " N"]] | None:
    """Discs on the carved surface, and whether a crop shows each; None where nothing is left.

    A disc that no crop shows takes the colour of the nearest one shown.
    """
    points, normals, cell_m = carve_surface(looks, count)
    if not len(points):
        return None
    rgb, seen = mean_colours(points, normals, _spread(looks))
    if seen.any():
        rgb[~seen] = rgb[seen][scipy.spatial.cKDTree(points[seen]).query(points[~seen])[1]]
    return make_discs(points, normals, rgb, DISC_WIDTH * cell_m), seen


def _spread(looks: Sequence[ObjectCrop]) -> list[ObjectCrop]:
    return [looks[i] for i in spread_indices(len(looks), _LOOKS, below=True)]
