# SPDX-License-Identifier: Apache-2.0
"""The affine map of colours between two pictures, from integer sums, and the error that remains after it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Integer, Num


@numba.njit(cache=True, nogil=True)
def colour_sums(
    first: Integer[np.ndarray, "H W 3"], second: Integer[np.ndarray, "H W 3"]
) -> tuple[Integer[np.ndarray, "4 4"], Integer[np.ndarray, "4 3"]]:
    """Σ d dᵀ and Σ d sᵀ, int64, over the pixels of two uint8 pictures, d = (first's colour, 1). Exact."""
    height, width, _ = first.shape
    own, both = np.zeros((4, 4), np.int64), np.zeros((4, 3), np.int64)
    # Rows per channel and of ones: the compiler vectorises only such sums.
    rows = np.ones((7, width), np.int32)
    for y in range(height):
        _split(first[y], rows[:3])
        _split(second[y], rows[4:])
        for d in range(4):
            _add_products(rows[d], rows[0], rows[1], rows[2], own[d])
            _add_products(rows[d], rows[4], rows[5], rows[6], both[d])
    own[:3, 3] = own[3, :3]
    own[3, 3] = height * width
    return own, both


@numba.njit(cache=True, nogil=True)
def _split(colours, channels):
    for x in range(len(colours)):
        channels[0, x], channels[1, x], channels[2, x] = colours[x, 0], colours[x, 1], colours[x, 2]


@numba.njit(cache=True, nogil=True)
def _add_products(factor, red, green, blue, total):
    r, g, b = 0, 0, 0
    for x in range(len(factor)):
        r += factor[x] * red[x]
        g += factor[x] * green[x]
        b += factor[x] * blue[x]
    total[0] += r
    total[1] += g
    total[2] += b


@numba.njit(cache=True, nogil=True)
def squared_error_after_map(
    first: Integer[np.ndarray, "H W 3"], second: Integer[np.ndarray, "H W 3"], by: Num[np.ndarray, "4 3"]
) -> np.int64:
    """Σ over pixels and channels of the squared difference of levels after ``by``, clamped and rounded."""
    total = np.int64(0)
    for y in range(first.shape[0]):
        for x in range(first.shape[1]):
            r, g, b = np.float64(first[y, x, 0]), np.float64(first[y, x, 1]), np.float64(first[y, x, 2])
            for c in range(3):
                level = np.rint(min(max(by[0, c] * r + by[1, c] * g + by[2, c] * b + by[3, c], 0.0), 255.0))
                gap = np.int64(level) - np.int64(second[y, x, c])
                total += gap * gap
    return total


def colour_map(first: Integer[np.ndarray, "H W 3"], second: Integer[np.ndarray, "H W 3"]) -> Num[np.ndarray, "4 3"]:
    """Least-squares affine map from ``first``'s levels to ``second``'s; minimum norm for too few colours."""
    own, both = colour_sums(first, second)
    # In units of the range: sums of at most 1 over a million pixels are well enough conditioned in float64.
    unit = np.array([255.0, 255.0, 255.0, 1.0])
    solution = np.linalg.pinv(own / np.outer(unit, unit), rcond=1e-10, hermitian=True) @ (
        both / np.outer(unit, np.full(3, 255.0))
    )
    return solution * 255 / unit[:, None]
