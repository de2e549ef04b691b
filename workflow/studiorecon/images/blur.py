# SPDX-License-Identifier: Apache-2.0
"""Gaussian blur that keeps constants constant up to the border."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require

if TYPE_CHECKING:
    from jaxtyping import Float, Num


def gaussian_blur(image: Num[np.ndarray, "H W ..."], size_px: int, sigma_px: float) -> Float[np.ndarray, "H W ..."]:
    """``image``, float32, blurred with a ``size_px`` × ``size_px`` Gaussian; borders are replicated.

    With zeros outside a constant 1 would fall to 0.60 at edges and 0.36 in corners (E05). The paper names the kernel,
    11, and no sigma; 2.0 is the reading U05. Raises ValueError for an even or non-positive size, or an array that is no
    image.
    """
    require("image", image, ("H", "W", ...))
    if size_px < 1 or size_px % 2 == 0:
        raise ValueError(f"blur size must be odd and positive, not {size_px}")
    return cv2.GaussianBlur(
        np.asarray(image, np.float32), (size_px, size_px), sigma_px, borderType=cv2.BORDER_REPLICATE
    )
