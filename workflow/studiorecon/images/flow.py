# SPDX-License-Identifier: Apache-2.0
"""Optical flow between two pictures, and where it is reliable.

A flow (H, W, 2) float32 in pixels belongs to the first picture: its pixel p shows the same point as the second picture
at p + flow(p). So the *backward* flow t → t-1 is ``dis_flow(picture_t, picture_t_minus_1)``, and warping picture t-1
with it gives picture t.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require
from studiorecon.errors import UserError
from studiorecon.images.temporal import forward_backward_consistent

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer, Num

PRESETS = {
    "ultrafast": cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST,
    "fast": cv2.DISOPTICAL_FLOW_PRESET_FAST,
    "medium": cv2.DISOPTICAL_FLOW_PRESET_MEDIUM,
}
# Below this DIS has no pyramid level left to search.
_SMALLEST_SIDE_PX = 24


@contextmanager
def one_thread() -> Iterator[None]:
    """Run OpenCV with one thread inside the block: DIS propagates inside stripes, one per thread.

    So results do not depend on the number of cores; for speed run several flows in parallel.
    """
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def grey_levels(rgb: Num[np.ndarray, "H W 3"]) -> Integer[np.ndarray, "H W"]:
    """Luminance of an RGB picture, uint8 or float in [0, 1]. Raises ValueError for another shape."""
    require("rgb", rgb, ("H", "W", 3))
    levels = rgb if rgb.dtype == np.uint8 else np.rint(np.clip(np.nan_to_num(rgb), 0, 1) * 255).astype(np.uint8)
    return cv2.cvtColor(np.ascontiguousarray(levels), cv2.COLOR_RGB2GRAY)


def dis_flow(
    first_grey: Integer[np.ndarray, "H W"], second_grey: Integer[np.ndarray, "H W"], preset: str
) -> Num[np.ndarray, "H W 2"]:
    """Flow in pixels from the first to the second uint8 picture by dense inverse search (Kroeger et al. 2016).

    Deterministic inside ``one_thread``. Raises UserError for pictures that differ in size or are too small to search.
    """
    if first_grey.shape != second_grey.shape:
        raise UserError(
            f"optical flow needs pictures of one size, not {first_grey.shape[::-1]} and {second_grey.shape[::-1]}"
        )
    if min(first_grey.shape) < _SMALLEST_SIDE_PX:
        raise UserError(
            f"optical flow needs pictures of at least {_SMALLEST_SIDE_PX} pixels a side, not {first_grey.shape[::-1]}"
        )
    return cv2.DISOpticalFlow.create(PRESETS[preset]).calc(first_grey, second_grey, None)  # type: ignore[call-overload]


def is_flow_consistent(
    flow: Num[np.ndarray, "H W 2"], reverse_flow: Num[np.ndarray, "H W 2"]
) -> Bool[np.ndarray, "H W"]:
    """Pixels whose flow leads back, inside the picture, within a motion-dependent tolerance.

    |f + r(p + f)|² < 0.01 (|f|² + |r|²) + 0.5 (Sundaram et al. 2010). It detects uncovered background, where colours
    may agree by chance (E10). Non-finite flow is inconsistent (E13). Raises ValueError for flows of two sizes.
    """
    require("reverse_flow", reverse_flow, ("H", "W", 2), require("flow", flow, ("H", "W", 2)))
    return forward_backward_consistent(np.ascontiguousarray(flow), np.ascontiguousarray(reverse_flow))
