# SPDX-License-Identifier: Apache-2.0
"""A network's depth with its blurred edges put back onto the photo's: a blurred edge is a ramp between two surfaces.

A photo that is carried through such a ramp smears: 2 pixels of blur at 320 cost 4 dB at cameras between.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
from numba import njit

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Blur of an edge as a share of the picture's longer side: 4 pixels of the 518 that such networks take.
_BLUR_SHARE = 0.0078
# Bend of inverse depth per pixel squared, as a share of it, above which a pixel is on an edge. Planes do not bend; a
# pillar of 0.2 m at 4 m bends by 0.004 at 320 pixels.
_MIN_BEND = 0.006
# Colour difference (sum over channels) at which a neighbour counts a third as much.
_CONTRAST = 0.1


def depth_edge_pixels(depth_m: Float[np.ndarray, "H W"]) -> Bool[np.ndarray, "H W"]:
    """Pixels within a blur of a depth edge, whose depth is a mixture of two surfaces."""
    inverse = (1 / depth_m).astype(np.float32)
    bend = cv2.Laplacian(inverse, cv2.CV_32F, ksize=1) / inverse
    around = np.ones((2 * _reach(depth_m.shape) + 1,) * 2)
    # A step bends both ways; where a wall meets the floor depth bends one way.
    near, far = (np.asarray(cv2.dilate((sign * bend > _MIN_BEND).astype(np.uint8), around)) > 0 for sign in (1, -1))
    return near & far


def edge_sigma(depth_m: Float[np.ndarray, "H W"]) -> Float[np.ndarray, "H W"]:
    """Float32 standard deviation of log depth (all known) that a blur adds at edges; 0 elsewhere.

    An edge's pixel may show any surface within a blur of it: a uniform distribution over their log depths.
    """
    logs, around = np.log(depth_m).astype(np.float32), np.ones((2 * _reach(depth_m.shape) + 1,) * 2)
    spread = cv2.dilate(logs, around) - cv2.erode(logs, around)
    return np.where(depth_edge_pixels(depth_m), spread / np.float32(np.sqrt(12)), 0)


def sharpen_depth(depth_m: Float[np.ndarray, "H W"], rgb: Float[np.ndarray, "H W 3"]) -> Float[np.ndarray, "H W"]:
    """Float32 depth (all known) whose edges are where the photo changes.

    A pixel on an edge continues the nearer or the further surface beside the edge, the one whose pixels look more like
    it.
    """
    logs = np.log(depth_m).astype(np.float32)
    across, down = (cv2.Sobel(logs, cv2.CV_32F, x, y, ksize=3, scale=1 / 8) for x, y in ((1, 0), (0, 1)))
    reach = _reach(depth_m.shape)
    return np.exp(
        _continue_surface(
            logs, across, down, depth_edge_pixels(depth_m), rgb.astype(np.float32), reach, np.float32(_CONTRAST)
        )
    )


def _reach(shape: tuple[int, ...]) -> int:
    return int(np.ceil(_BLUR_SHARE * max(shape)))


@njit(cache=True)
def _continue_surface(logs, across, down, edge, rgb, reach, contrast):
    height, width = logs.shape
    made = logs.copy()
    for y in range(height):
        for x in range(width):
            if not edge[y, x]:
                continue
            low, high = np.inf, -np.inf
            top, bottom = max(y - 4 * reach, 0), min(y + 4 * reach + 1, height)
            left, right = max(x - 4 * reach, 0), min(x + 4 * reach + 1, width)
            for j in range(top, bottom):
                for i in range(left, right):
                    if not edge[j, i]:
                        low, high = min(low, logs[j, i]), max(high, logs[j, i])
            if high < low:
                continue
            middle, weight, total = (low + high) / 2, np.zeros(2), np.zeros(2)
            for j in range(top, bottom):
                for i in range(left, right):
                    if edge[j, i]:
                        continue
                    unlike = 0.0
                    for c in range(3):
                        unlike += abs(rgb[y, x, c] - rgb[j, i, c])
                    far = ((j - y) ** 2 + (i - x) ** 2) / (8.0 * reach * reach)
                    share = np.exp(-far - unlike / contrast)
                    side = 0 if logs[j, i] < middle else 1
                    weight[side] += share
                    total[side] += share * (logs[j, i] + across[j, i] * (x - i) + down[j, i] * (y - j))
            side = 0 if weight[0] > weight[1] else 1
            if weight[side] > 0:
                made[y, x] = total[side] / weight[side]
    return made
