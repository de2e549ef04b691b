# SPDX-License-Identifier: Apache-2.0
"""Inner loops of the picture measures: squared errors in integers, the map of structural similarity, masked sums.

Structural similarity is computed from the sum s = a + b and the difference d = a − b of the two pictures instead of
from a and b: 2 μa μb = (μs² − μd²)/2, 2 cov = (Vs − Vd)/2, and the sums of squares with a plus. Four windowed means
instead of five, and with Vs and Vd clamped at 0 the value cannot exceed 1 and is exactly 1 where the pictures are equal
(I01).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numba
import numpy as np

from studiorecon.arrays import require

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num

WINDOW, SIGMA = 11, 1.5
RADIUS = WINDOW // 2
K_1, K_2 = 0.01, 0.03
# (K L)² with the range L of 8-bit levels, which is never guessed from the data (I02).
_C1, _C2 = (K_1 * 255) ** 2, (K_2 * 255) ** 2


def window() -> Float[np.ndarray, " 11"]:
    """Normalised Gaussian, float64, of sigma 1.5: the window of SSIM, as a measure and as a loss."""
    return cv2.getGaussianKernel(WINDOW, SIGMA, cv2.CV_64F)[:, 0]


def similarity_map(first: Num[np.ndarray, "H W C"], second: Num[np.ndarray, "H W C"]) -> Float[np.ndarray, "H W"]:
    """SSIM, mean over channels, of two uint8 pictures with zeros outside: 11×11 Gaussian of sigma 1.5.

    Raises ValueError for pictures of two sizes: the compiled loops would read beyond the smaller one.
    """
    require("second", second, ("H", "W", "C"), require("first", first, ("H", "W", "C")))
    found = np.zeros(first.shape[:2])
    _similarity(np.ascontiguousarray(first), np.ascontiguousarray(second), window(), found)
    return found


@numba.njit(cache=True, nogil=True)
def squared_error(
    first: Integer[np.ndarray, "H W 3"], second: Integer[np.ndarray, "H W 3"]
) -> Integer[np.ndarray, "H W"]:
    """Σ over channels of the squared difference of two uint8 pictures, int32, exact."""
    height, width, channels = first.shape
    found = np.empty((height, width), np.int32)
    for y in range(height):
        for x in range(width):
            total = np.int64(0)
            for c in range(channels):
                gap = np.int32(first[y, x, c]) - np.int32(second[y, x, c])
                total += gap * gap
            found[y, x] = total
    return found


@numba.njit(cache=True, nogil=True)
def masked_sum(values: Num[np.ndarray, "H W"], mask: Bool[np.ndarray, "H W"]) -> tuple[float, int]:
    """Sum and count of ``values`` where ``mask`` is true; values outside may be NaN."""
    total, count = 0.0, 0
    for y in range(values.shape[0]):
        row = 0.0
        for x in range(values.shape[1]):
            if mask[y, x]:
                row += values[y, x]
                count += 1
        total += row
    return total, count


@numba.njit(cache=True, nogil=True)
def _similarity(first, second, kernel, found):
    height, width, channels = first.shape
    taps, radius = len(kernel), len(kernel) // 2
    line_s, line_d = np.zeros(width + 2 * radius), np.zeros(width + 2 * radius)
    line_ss, line_dd = np.zeros(width + 2 * radius), np.zeros(width + 2 * radius)
    # The last rows of horizontal means, one ring per field; a picture row needs the eleven around it.
    ring, mean = np.empty((4, taps, width)), np.empty((4, width))
    for c in range(channels):
        for y in range(-radius, height + radius):
            slot = (y + taps) % taps
            if 0 <= y < height:
                _load(first[y], second[y], c, line_s[radius:], line_d[radius:], line_ss[radius:], line_dd[radius:])
            else:
                line_s[:], line_d[:], line_ss[:], line_dd[:] = 0.0, 0.0, 0.0, 0.0
            _blur_line(line_s, kernel, ring[0, slot])
            _blur_line(line_d, kernel, ring[1, slot])
            _blur_line(line_ss, kernel, ring[2, slot])
            _blur_line(line_dd, kernel, ring[3, slot])
            row = y - radius
            if row >= 0:
                for f in range(4):
                    _blur_rows(ring[f], row + taps, kernel, mean[f])
                _compare(mean[0], mean[1], mean[2], mean[3], 1 / channels, found[row])


# The loops below are functions of whole rows, because only then does the compiler see that they do not overlap, and
# vectorises them; sums of more than six rows would need too many overlap checks.


@numba.njit(cache=True, nogil=True)
def _load(first, second, channel, s_line, d_line, ss_line, dd_line):
    for x in range(len(first)):
        a, b = np.float64(first[x, channel]), np.float64(second[x, channel])
        s, d = a + b, a - b
        s_line[x], d_line[x], ss_line[x], dd_line[x] = s, d, s * s, d * d


@numba.njit(cache=True, nogil=True)
def _blur_line(line, kernel, out):
    k0, k1, k2, k3, k4, k5 = kernel[0], kernel[1], kernel[2], kernel[3], kernel[4], kernel[5]
    for x in range(len(out)):
        near = k5 * line[x + 5] + k4 * (line[x + 4] + line[x + 6]) + k3 * (line[x + 3] + line[x + 7])
        far = k2 * (line[x + 2] + line[x + 8]) + k1 * (line[x + 1] + line[x + 9]) + k0 * (line[x] + line[x + 10])
        out[x] = near + far


@numba.njit(cache=True, nogil=True)
def _blur_rows(ring, middle, kernel, out):
    taps = len(ring)
    near, above, below = ring[middle % taps], ring[(middle - 1) % taps], ring[(middle + 1) % taps]
    above_2, below_2 = ring[(middle - 2) % taps], ring[(middle + 2) % taps]
    _five_rows(near, above, below, above_2, below_2, kernel[5], kernel[4], kernel[3], out)
    above, below = ring[(middle - 3) % taps], ring[(middle + 3) % taps]
    above_2, below_2 = ring[(middle - 4) % taps], ring[(middle + 4) % taps]
    above_3, below_3 = ring[(middle - 5) % taps], ring[(middle + 5) % taps]
    _six_rows(above, below, above_2, below_2, above_3, below_3, kernel[2], kernel[1], kernel[0], out)


@numba.njit(cache=True, nogil=True)
def _five_rows(near, above, below, above_2, below_2, k5, k4, k3, out):
    for x in range(len(out)):
        out[x] = k5 * near[x] + k4 * (above[x] + below[x]) + k3 * (above_2[x] + below_2[x])


@numba.njit(cache=True, nogil=True)
def _six_rows(above, below, above_2, below_2, above_3, below_3, k2, k1, k0, out):
    for x in range(len(out)):
        out[x] += k2 * (above[x] + below[x]) + k1 * (above_2[x] + below_2[x]) + k0 * (above_3[x] + below_3[x])


@numba.njit(cache=True, nogil=True)
def _compare(mean_s, mean_d, mean_ss, mean_dd, share, out):
    for x in range(len(out)):
        s, d = mean_s[x], mean_d[x]
        spread_s, spread_d = max(mean_ss[x] - s * s, 0.0), max(mean_dd[x] - d * d, 0.0)
        s_squared, d_squared = 0.5 * s * s, 0.5 * d * d
        luminance = (s_squared - d_squared + _C1) / (s_squared + d_squared + _C1)
        structure = (0.5 * (spread_s - spread_d) + _C2) / (0.5 * (spread_s + spread_d) + _C2)
        out[x] += share * luminance * structure
