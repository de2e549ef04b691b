# SPDX-License-Identifier: Apache-2.0
"""How close a picture is to the true one: PSNR, SSIM and warp error, each in the variant its name says.

Pictures are (H, W, 3), uint8 or float in [0, 1]; floats are clamped and rounded to 8 bit first, so that stored videos reproduce
every number. All sums are float64. A measure that cannot be taken (mask too small, picture too small) is None, never a number.
"""

from __future__ import annotations

import cv2
import numpy as np

# Identical pictures: counted with this, so that one of them does not make a mean infinite (numerics I03).
PSNR_CAP_DB = 100.0
# A mean over fewer pixels than this says more about noise than about the picture.
SMALLEST_MASK_PX = 256
_WINDOW, _SIGMA = 11, 1.5
_C1, _C2 = 0.01**2, 0.03**2


def levels(picture: np.ndarray) -> np.ndarray:
    """float64 in [0, 1] of an 8-bit picture, or of a float one after clamping and rounding to 8 bit (numerics I04)."""
    if picture.dtype == np.uint8:
        return picture.astype(np.float64) / 255
    return np.rint(np.clip(np.nan_to_num(picture, nan=0.0, posinf=1.0, neginf=0.0), 0, 1).astype(np.float64) * 255) / 255


def psnr(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float | None:
    """Peak signal-to-noise ratio in dB with range 1, over the pixels of ``mask`` (H, W) bool when given.

    The mean divides by the masked pixels, not by the picture: at 5 % coverage that is the difference between 18 and 31 dB. None below
    256 masked pixels.
    """
    squares = (levels(prediction) - levels(truth)) ** 2
    if mask is not None:
        if mask.sum() < SMALLEST_MASK_PX:
            return None
        squares = squares[mask]
    error = float(squares.mean())
    return PSNR_CAP_DB if error <= 10 ** (-PSNR_CAP_DB / 10) else -10 * float(np.log10(error))


def ssim_map(prediction: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(H, W, 3) structural similarity per channel with zeros outside the picture: 11×11 Gaussian, sigma 1.5, range 1.

    Population covariance; variances are clamped at 0 and the map at 1, which rounding breaks on flat pictures (numerics I01).
    """
    a, b = levels(prediction), levels(truth)
    mean_a, mean_b = _window_mean(a), _window_mean(b)
    variance_a = np.maximum(_window_mean(a * a) - mean_a**2, 0)
    variance_b = np.maximum(_window_mean(b * b) - mean_b**2, 0)
    bound = np.sqrt(variance_a * variance_b)
    covariance = np.clip(_window_mean(a * b) - mean_a * mean_b, -bound, bound)
    numerator = (2 * mean_a * mean_b + _C1) * (2 * covariance + _C2)
    return np.minimum(numerator / ((mean_a**2 + mean_b**2 + _C1) * (variance_a + variance_b + _C2)), 1.0)


def ssim(similarity: np.ndarray, mask: np.ndarray | None = None) -> float | None:
    """Mean of an ``ssim_map`` over windows that lie inside the picture; with ``mask``, over windows wholly inside the mask.

    Eroding the mask by the window's radius keeps errors outside it out of the mean (numerics I08). None when a side is under 11
    pixels or fewer than 256 masked pixels remain.
    """
    if min(similarity.shape[:2]) < _WINDOW:
        return None
    radius = _WINDOW // 2
    inside = np.zeros(similarity.shape[:2], bool)
    inside[radius:-radius, radius:-radius] = True
    if mask is not None:
        inside &= cv2.erode(mask.astype(np.uint8), np.ones((_WINDOW, _WINDOW), np.uint8)).astype(bool)
        if inside.sum() < SMALLEST_MASK_PX:
            return None
    return float(similarity[inside].mean())


def ssim_3dgs(similarity: np.ndarray) -> float | None:
    """Mean of an ``ssim_map`` over the whole picture, zero padding included, as papers of the 3DGS lineage print it."""
    return None if min(similarity.shape[:2]) < _WINDOW else float(similarity.mean())


def warp_error(current: np.ndarray, warped_previous: np.ndarray, valid: np.ndarray) -> tuple[float, float] | None:
    """Temporal L1 (mean absolute difference) and mean square of ``current`` against the previous picture warped onto it.

    The root of the mean square is what papers call Warp-L2 (evaluation 1.2); both are over ``valid`` (H, W). None below 256 pixels.
    """
    if valid.sum() < SMALLEST_MASK_PX:
        return None
    difference = (levels(current) - np.asarray(warped_previous, np.float64))[valid]
    return float(np.abs(difference).mean()), float((difference**2).mean())


def _window_mean(image: np.ndarray) -> np.ndarray:
    kernel = cv2.getGaussianKernel(_WINDOW, _SIGMA, cv2.CV_64F)
    return cv2.sepFilter2D(image, cv2.CV_64F, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
