# SPDX-License-Identifier: Apache-2.0
"""Skinning weights in the space around the body: a voxel grid sampled at canonical points (paper: 64³, appendix D).

The grid covers a cube around the canonical body with a margin (U45). It is sampled with border padding and the weights
are renormalised, so a Gaussian that leaves the cube keeps its neighbour's motion (L01).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np
import scipy

from studiorecon.arrays import require

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num


@dataclass(frozen=True)
class WeightGrid:
    """Float32 weights at the nodes of a cube, axes x, y, z, rows summing to 1; ``origin_m``: position of node (0, 0,
    0).
    """

    origin_m: Num[np.ndarray, " 3"]
    spacing_m: float
    weights: Float[np.ndarray, "R R R B"]

    def query(self, points_m: Num[np.ndarray, "N 3"]) -> Num[np.ndarray, "N B"]:
        """Trilinear weights at canonical points, float32, rows summing to 1; ValueError for points that are not
        finite."""
        require("points_m", points_m, ("N", 3), finite=True)
        at = (np.asarray(points_m, np.float64) - self.origin_m) / self.spacing_m
        found = np.empty((len(at), self.weights.shape[3]), np.float32)
        _trilinear(at, self.weights, found)
        return found


@numba.njit(cache=True)
def _trilinear(at, weights, found):
    """Interpolate at positions in nodes, clamped to the border; compiled, because training calls it at every step."""
    last, bones = weights.shape[0] - 1, weights.shape[3]
    mixed = np.empty(bones)
    for i in range(len(at)):
        mixed[:] = 0
        x = min(max(at[i, 0], 0.0), float(last))
        y = min(max(at[i, 1], 0.0), float(last))
        z = min(max(at[i, 2], 0.0), float(last))
        ix, iy, iz = min(int(x), last - 1), min(int(y), last - 1), min(int(z), last - 1)
        sx, sy, sz = x - ix, y - iy, z - iz
        for a in range(2):
            for b in range(2):
                for c in range(2):
                    part = (sx if a else 1 - sx) * (sy if b else 1 - sy) * (sz if c else 1 - sz)
                    for bone in range(bones):
                        mixed[bone] += part * weights[ix + a, iy + b, iz + c, bone]
        total = mixed.sum()
        for bone in range(bones):
            found[i, bone] = mixed[bone] / total


def all_bone_weights(
    grid: WeightGrid, points_m: Num[np.ndarray, "N 3"]
) -> tuple[Integer[np.ndarray, "N B"], Num[np.ndarray, "N B"]]:
    """All bones, uint8, and the grid's weights at points. Raises as ``query`` does."""
    weights = grid.query(points_m)
    return np.tile(np.arange(weights.shape[1], dtype=np.uint8), (len(weights), 1)), weights


def build_weight_grid(
    vertices_m: Num[np.ndarray, "V 3"], weights: Num[np.ndarray, "V B"], resolution: int, margin: float
) -> WeightGrid:
    """The grid of a canonical body: every node takes the inverse-distance mean of its four nearest vertices' weights.

    The cube is the body's longest side enlarged by ``margin`` (0.15 = 15 %) on each side. 64³ nodes take about a
    second. Raises ValueError for other shapes or numbers that are not finite.
    """
    require("weights", weights, ("V", "B"), require("vertices_m", vertices_m, ("V", 3), finite=True), finite=True)
    low, high = vertices_m.min(axis=0), vertices_m.max(axis=0)
    side = float((high - low).max()) * (1 + 2 * margin)
    origin = (low + high) / 2 - side / 2
    spacing = side / (resolution - 1)
    axes = [origin[k] + spacing * np.arange(resolution) for k in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    distance, nearest = scipy.spatial.cKDTree(vertices_m).query(nodes, k=min(4, len(vertices_m)))
    distance, nearest = distance.reshape(len(nodes), -1), nearest.reshape(len(nodes), -1)
    closeness = 1 / np.maximum(distance, 1e-6)
    mixed = np.einsum("nk,nkb->nb", closeness, np.asarray(weights, np.float64)[nearest])
    mixed /= mixed.sum(axis=1, keepdims=True)
    return WeightGrid(origin, spacing, mixed.reshape(resolution, resolution, resolution, -1).astype(np.float32))


def strongest_weights(
    weights: Num[np.ndarray, "N B"], keep: int = 4
) -> tuple[Integer[np.ndarray, "N keep"], Float[np.ndarray, "N keep"]]:
    """The ``keep`` largest weights of every row: joints, uint8, and weights, float32 summing to 1.

    Raises ValueError for another shape or numbers that are not finite.
    """
    require("weights", weights, ("N", "B"), finite=True)
    bones = np.argsort(-weights, axis=1, kind="stable")[:, :keep]
    kept = np.take_along_axis(np.asarray(weights, np.float64), bones, axis=1)
    return bones.astype(np.uint8), (kept / kept.sum(axis=1, keepdims=True)).astype(np.float32)
