# SPDX-License-Identifier: Apache-2.0
"""One plane per pixel from the cost of every plane: semi-global labelling with a Potts penalty, lower on edges."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
from numba import njit

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

# Colour difference (mean over channels) over which the penalty falls to 1/e, and its lower limit.
_EDGE_CONTRAST = 0.05
_MIN_PENALTY = 0.1


def label_planes(
    cost: Float[np.ndarray, "H W L"], rgb: Num[np.ndarray, "H W 3"], change_penalty: float
) -> Integer[np.ndarray, "H W"]:
    """Index of the best plane, from float32 costs and the photo.

    Four paths (left, right, up, down); every change of plane costs the same ``change_penalty``: slanted surfaces are
    one plane, so small changes need no discount.
    """
    smooth = cv2.GaussianBlur(rgb, (3, 3), 0.7)
    weights = []
    for axis in (1, 0):
        contrast = np.abs(np.diff(smooth, axis=axis)).mean(axis=-1)
        weight = (1 - _MIN_PENALTY) * np.exp(-contrast / _EDGE_CONTRAST) + _MIN_PENALTY
        weights.append((change_penalty * weight).astype(np.float32))
    return _label(np.ascontiguousarray(cost, np.float32), *weights)


@njit(cache=True, fastmath=True)
def _label(cost, across, down):
    height, width, planes = cost.shape
    total = np.zeros_like(cost)
    line = np.zeros(planes, np.float32)
    for direction in range(4):
        vertical = direction >= 2
        backwards = direction % 2 == 1
        lines, steps = (width, height) if vertical else (height, width)
        for i in range(lines):
            for s in range(steps):
                t = steps - 1 - s if backwards else s
                y, x = (t, i) if vertical else (i, t)
                if s == 0:
                    for k in range(planes):
                        line[k] = cost[y, x, k]
                else:
                    gap = t if backwards else t - 1
                    penalty = down[gap, x] if vertical else across[y, gap]
                    least = line[0]
                    for k in range(planes):
                        least = min(least, line[k])
                    for k in range(planes):
                        line[k] = cost[y, x, k] + min(line[k] - least, penalty)
                for k in range(planes):
                    total[y, x, k] += line[k]
    best = np.zeros((height, width), np.int32)
    for y in range(height):
        for x in range(width):
            least = total[y, x, 0]
            for k in range(planes):
                if total[y, x, k] < least:
                    least = total[y, x, k]
                    best[y, x] = k
    return best
