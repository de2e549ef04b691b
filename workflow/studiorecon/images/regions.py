# SPDX-License-Identifier: Apache-2.0
"""Operations on binary pictures: growing, distances, small islands and holes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


def dilate(region: Bool[np.ndarray, "H W"], size_px: int) -> Bool[np.ndarray, "H W"]:
    """``region`` grown by a square of ``size_px`` pixels (21 = radius 10, U24; 0 or 1 = unchanged).

    Raises ValueError for an even size, which would shift the region by half a pixel, or a region that is no picture.
    """
    require("region", region, ("H", "W"))
    if size_px <= 1:
        return region.astype(bool)
    if size_px % 2 == 0:
        raise ValueError(f"the size of a dilation must be odd, not {size_px}")
    return cv2.dilate(region.astype(np.uint8), np.ones((size_px, size_px), np.uint8)) > 0


def signed_distance_px(region: Bool[np.ndarray, "H W"]) -> Float[np.ndarray, "H W"]:
    """Float32 distance to the outline of ``region`` in pixels, positive inside; −inf everywhere when it is empty.

    Raises ValueError for a region that is no picture.
    """
    require("region", region, ("H", "W"))
    inside = region.astype(np.uint8)
    if not inside.any():
        return np.full(region.shape, -np.inf, np.float32)
    if inside.all():
        return np.full(region.shape, np.inf, np.float32)
    # Each transform measures to the nearest pixel centre of the other side; the outline is half a pixel before it.
    within = cv2.distanceTransform(inside, cv2.DIST_L2, 5)
    outside = cv2.distanceTransform(1 - inside, cv2.DIST_L2, 5)
    return np.where(inside > 0, within - 0.5, 0.5 - outside).astype(np.float32)


def without_islands(region: Bool[np.ndarray, "H W"], least_px: float) -> Bool[np.ndarray, "H W"]:
    """``region`` without connected parts of fewer than ``least_px`` pixels. Raises ValueError for no picture."""
    require("region", region, ("H", "W"))
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(region.astype(np.uint8), connectivity=8)
    if count <= 1:
        return region.astype(bool)
    keep = statistics[:, cv2.CC_STAT_AREA] >= least_px
    keep[0] = False
    return keep[labels]


def without_holes(region: Bool[np.ndarray, "H W"], largest_px: float) -> Bool[np.ndarray, "H W"]:
    """``region`` with enclosed gaps of up to ``largest_px`` pixels filled. Raises ValueError for no picture."""
    require("region", region, ("H", "W"))
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(
        (~region.astype(bool)).astype(np.uint8), connectivity=4
    )
    if count <= 1:
        return region.astype(bool)
    touches = np.zeros(count, bool)
    for edge in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        touches[edge] = True
    fill = (statistics[:, cv2.CC_STAT_AREA] <= largest_px) & ~touches
    fill[0] = False
    return region.astype(bool) | fill[labels]
