# SPDX-License-Identifier: Apache-2.0
"""The surface of a thing of any shape from looks at it in its own frame: what no look denies, on a grid.

Beside ``rigid.hull``, which knows round things only: a board is not star-shaped enough for directions around its
middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.arrays import evenly_spread
from studiorecon.images.warp import sample
from studiorecon.objects.residual import ROOM
from studiorecon.objects.rigid import ObjectCrop, coloured, reached_m
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.discs import discs

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Cells along each axis of the first grid, the bounds of the second, and looks that carve, spread over all of them.
_CELLS, _CELLS_BETWEEN, _LOOKS = 40, (16, 72), 96
# A cell lies outside when more than this share of the looks shows the room there; when one of few does.
_OUTSIDE, _FEW = 0.06, 8
# Distance of the outermost outlines from the middle, as a quantile; room beyond it.
_FARTHEST, _ROOM = 0.98, 1.15
# Deviation, in cells, of the blur whose slope is the normal.
_SLOPE = 1.0
# A disc's deviation over the cells' width, its thickness over its own width, its opacity.
_WIDTH, _FLATNESS, _OPACITY = 0.6, 0.4, 0.9


def reach_m(looks: Sequence[ObjectCrop]) -> float:
    """How far from the middle a thing reaches: what nearly all outlines stay within, metres; NaN without an outline."""
    found = np.concatenate([np.zeros(0), *(reached_m(look) for look in looks)])
    return float(np.quantile(found, _FARTHEST)) if len(found) else float("nan")


def carved(looks: Sequence[ObjectCrop], count: int) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"], float]:
    """(N, 3) points on the surface in the thing's frame, metres, N about ``count``; their outward normals (N, 3); their
    spacing, metres.

    No points where the looks leave nothing.
    """
    half_m = _ROOM * reach_m(looks)
    nothing = np.zeros((0, 3)), np.zeros((0, 3)), float("nan")
    if not np.isfinite(half_m):
        return nothing
    chosen = _spread(looks)
    points = _surface(chosen, half_m, _CELLS)[0]
    if not len(points):
        return nothing
    # As many cells across as give so many on the surface, which grow with their square.
    return _surface(chosen, half_m, int(np.clip(_CELLS * np.sqrt(count / len(points)), *_CELLS_BETWEEN)))


def volume_m3(looks: Sequence[ObjectCrop]) -> float:
    """What looks leave of a thing, cubic metres; infinite without an outline."""
    half_m = _ROOM * reach_m(looks)
    return (
        float(_solid(_spread(looks), half_m, _CELLS).sum() * (2 * half_m / _CELLS) ** 3)
        if np.isfinite(half_m)
        else np.inf
    )


def _solid(looks: Sequence[ObjectCrop], half_m: float, cells: int) -> np.ndarray:
    """(cells, cells, cells) bool: what looks do not deny of a cube around the middle."""
    axis = (np.arange(cells) + 0.5) * (2 * half_m / cells) - half_m
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    outside = np.zeros(len(points))
    for look in looks:
        pixels, depth_m = look.camera.project(points)
        state, within = sample(look.state, pixels[None], "nearest")
        # Beyond the crop there is room, and a camera says nothing about what lies behind it.
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
    # Cells of the skin lie half a cell inside the surface.
    return (np.argwhere(skin_cells) - 0.5) * cell_m - half_m + 0.5 * cell_m * normals, normals, cell_m


def skin(looks: Sequence[ObjectCrop], count: int) -> tuple[Gaussians, Bool[np.ndarray, " N"]] | None:
    """Discs on what looks leave of a thing, in their colours, and (N,) bool which of them any look shows; None where
    nothing is left.

    Discs that no look shows take the colour of the nearest that one does.
    """
    points, normals, cell_m = carved(looks, count)
    if not len(points):
        return None
    rgb, seen = coloured(points, normals, _spread(looks))
    if seen.any():
        rgb[~seen] = rgb[seen][scipy.spatial.cKDTree(points[seen]).query(points[~seen])[1]]
    return discs(points, normals, rgb, _WIDTH * cell_m, _FLATNESS, _OPACITY, 0), seen


def _spread(looks: Sequence[ObjectCrop]) -> list[ObjectCrop]:
    return [looks[i] for i in evenly_spread(len(looks), _LOOKS, below=True)]
