# SPDX-License-Identifier: Apache-2.0
"""Distance of a picture from the true one: PSNR, SSIM and change over time, each in the variant that its name states.

Pictures are (H, W, 3), uint8 or float in [0, 1]; floats are clamped and rounded to 8 bit first, and NaN becomes black
as in a stored video, so that stored videos reproduce every number. The range is 1 (255 levels) and never inferred
(I02); sums are integers or float64 (I05). A measure that is impossible (mask too small, picture too small) is None,
never a number.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require
from studiorecon.footage.video import to_bytes
from studiorecon.images.similarity import RADIUS, WINDOW, masked_sum, similarity_map, squared_error
from studiorecon.images.temporal import change

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num

# Value for identical pictures, so that one of them does not make a mean infinite (I03).
PSNR_CAP_DB = 100.0
# A mean over fewer pixels than this is mostly noise.
SMALLEST_MASK_PX = 256
# Σ over channels of a squared difference of 8-bit levels, per unit of mean squared error with range 1.
_SQUARES = 3 * 255**2


def to_levels(picture: Num[np.ndarray, "H W 3"]) -> Integer[np.ndarray, "H W 3"]:
    """Levels, uint8, of an 8-bit picture, or of a float one after clamping and rounding (I04)."""
    return picture if picture.dtype == np.uint8 else to_bytes(picture)


def error_map(prediction: Num[np.ndarray, "H W 3"], truth: Num[np.ndarray, "H W 3"]) -> Integer[np.ndarray, "H W"]:
    """Int32: Σ over channels of squared differences of 8-bit levels. 4 ms at 1280×704.

    Raises ValueError for pictures that are not of one size.
    """
    require("truth", truth, ("H", "W", 3), require("prediction", prediction, ("H", "W", 3)))
    return squared_error(to_levels(prediction), to_levels(truth))


def psnr_from_error_map(errors: Num[np.ndarray, "H W"], mask: Bool[np.ndarray, "H W"] | None = None) -> float | None:
    """Peak signal-to-noise ratio in dB with range 1 of an ``error_map``, over the pixels of ``mask`` when given.

    10 log10(1/MSE), capped at 100 dB. The mean divides by the masked pixels: at 5 % coverage that is the difference
    between 18 and 31 dB. None below 256 masked pixels. Raises ValueError for a mask of another size.
    """
    sizes = require("errors", errors, ("H", "W"))
    if mask is not None:
        require("mask", mask, ("H", "W"), sizes)
    total, count = (errors.sum(dtype=np.int64), errors.size) if mask is None else masked_sum(errors, mask)
    if count == 0 or (mask is not None and count < SMALLEST_MASK_PX):
        return None
    return decibels(float(total) / (_SQUARES * count))


def decibels(mean_square: float) -> float:
    """PSNR of a mean squared error with range 1, capped."""
    return PSNR_CAP_DB if mean_square <= 10 ** (-PSNR_CAP_DB / 10) else -10 * float(np.log10(mean_square))


def psnr(
    prediction: Num[np.ndarray, "H W 3"], truth: Num[np.ndarray, "H W 3"], mask: Bool[np.ndarray, "H W"] | None = None
) -> float | None:
    """``psnr_from_error_map`` of the ``error_map`` of two pictures.

    Raises ValueError for pictures or masks of two sizes.
    """
    return psnr_from_error_map(error_map(prediction, truth), mask)


def ssim_map(prediction: Num[np.ndarray, "H W C"], truth: Num[np.ndarray, "H W C"]) -> Float[np.ndarray, "H W"]:
    """Structural similarity, mean over channels, with zeros outside the picture: 11×11 Gaussian, sigma 1.5, range 1.

    Population covariance; variances are clamped at 0 and the map at 1, which rounding breaks on flat pictures (I01).
    Raises ValueError for pictures of two sizes.
    """
    require("truth", truth, ("H", "W", "C"), require("prediction", prediction, ("H", "W", "C")))
    return similarity_map(to_levels(prediction), to_levels(truth))


def whole_windows(mask: Bool[np.ndarray, "H W"]) -> Bool[np.ndarray, "H W"]:
    """Pixels whose 11×11 window is inside the picture and inside ``mask``, eroded by 5 pixels.

    Errors outside the mask cannot reach such windows (I08, I10). Raises ValueError for a mask that is no picture.
    """
    require("mask", mask, ("H", "W"))
    inside = np.zeros(mask.shape, bool)
    inside[RADIUS : mask.shape[0] - RADIUS, RADIUS : mask.shape[1] - RADIUS] = True
    return inside & cv2.erode(mask.astype(np.uint8), np.ones((WINDOW, WINDOW), np.uint8)).astype(bool)


def ssim(similarity: Num[np.ndarray, "H W"], mask: Bool[np.ndarray, "H W"] | None = None) -> float | None:
    """Mean of an ``ssim_map`` over windows inside the picture, and inside ``mask`` if given.

    The mean divides by the windows used, not by the picture (I09). None when a side is under 11 pixels or fewer than
    256 masked windows remain. Raises ValueError for a mask of another size.
    """
    sizes = require("similarity", similarity, ("H", "W"))
    if mask is not None:
        require("mask", mask, ("H", "W"), sizes)
    if min(similarity.shape) < WINDOW:
        return None
    if mask is None:
        return float(similarity[RADIUS:-RADIUS, RADIUS:-RADIUS].mean(dtype=np.float64))
    total, count = masked_sum(similarity, whole_windows(mask))
    return total / count if count >= SMALLEST_MASK_PX else None


def ssim_3dgs(similarity: Num[np.ndarray, "H W"]) -> float | None:
    """Mean of an ``ssim_map`` over the whole picture, zero padding included, as papers after 3DGS print it.

    Raises ValueError for an array that is no map.
    """
    require("similarity", similarity, ("H", "W"))
    return None if min(similarity.shape) < WINDOW else float(similarity.mean(dtype=np.float64))


def change_maps(
    current: Num[np.ndarray, "H W 3"],
    previous: Num[np.ndarray, "H W 3"],
    backward: Num[np.ndarray, "H W 2"],
    valid: Bool[np.ndarray, "H W"],
) -> tuple[Num[np.ndarray, "H W"], Num[np.ndarray, "H W"]]:
    """Absolute and squared change of ``current`` against ``previous`` moved by the backward flow; NaN if invalid.

    O_t − warp(O_{t−1}, F_{t→t−1}), mean over channels, range 1. The flow, pixels, is that of the *true* video. Raises
    ValueError for pictures, a flow or a mask of another size.
    """
    sizes = require("current", current, ("H", "W", 3))
    require("previous", previous, ("H", "W", 3), sizes)
    require("backward", backward, ("H", "W", 2), sizes)
    require("valid", valid, ("H", "W"), sizes)
    return change(to_levels(current), to_levels(previous), backward, valid)


def mean_inside(values: Num[np.ndarray, "H W"], mask: Bool[np.ndarray, "H W"]) -> float | None:
    """Mean of a map over a mask; None below 256 pixels. Raises ValueError for a mask of another size."""
    require("mask", mask, ("H", "W"), require("values", values, ("H", "W")))
    total, count = masked_sum(values, mask)
    return total / count if count >= SMALLEST_MASK_PX else None
