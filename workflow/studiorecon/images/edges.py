# SPDX-License-Identifier: Apache-2.0
"""Straight edges of a picture, by the line segment detector (Grompone von Gioi et al. 2010)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require

if TYPE_CHECKING:
    from jaxtyping import Num


def straight_edges(grey: Num[np.ndarray, "H W"], least_px: float) -> Num[np.ndarray, "N 4"]:
    """(N, 4) ends x0, y0, x1, y1 of the straight edges of ``grey`` (H, W, uint8) that are at least ``least_px`` long,
    centres of pixels at +0.5. Raises ValueError for another shape."""
    require("grey", grey, ("H", "W"))
    found = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(np.ascontiguousarray(grey))[0]
    if found is None:
        return np.zeros((0, 4))
    ends = found.reshape(-1, 4).astype(np.float64) + 0.5
    return ends[np.hypot(ends[:, 2] - ends[:, 0], ends[:, 3] - ends[:, 1]) >= least_px]
