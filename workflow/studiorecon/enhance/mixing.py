# SPDX-License-Identifier: Apache-2.0
"""The inner loops of the injection: how far warped pictures are from a render, and what mixing them into it gives."""

from __future__ import annotations

import numba
import numpy as np

MEAN, NORM, SUM = 0, 1, 2


@numba.njit(cache=True, nogil=True)
def difference_levels(first: np.ndarray, second: np.ndarray, kind: int) -> np.ndarray:
    """(H, W) float32 difference of two pictures (H, W, 3) in [0, 1], in levels of 255; NaN where either is NaN.

    E11: of a grey difference of 20 levels the MEAN over channels is 20, the NORM 34.6 and the SUM 60.
    """
    height, width = first.shape[:2]
    levels = np.empty((height, width), np.float32)
    for i in range(height):
        for j in range(width):
            a = np.float32(255) * abs(first[i, j, 0] - second[i, j, 0])
            b = np.float32(255) * abs(first[i, j, 1] - second[i, j, 1])
            c = np.float32(255) * abs(first[i, j, 2] - second[i, j, 2])
            if kind == NORM:
                levels[i, j] = np.sqrt(a * a + b * b + c * c)
            else:
                levels[i, j] = (a + b + c) / (np.float32(3) if kind == MEAN else np.float32(1))
    return levels


@numba.njit(cache=True, nogil=True)
def add_share(added: np.ndarray, shares: np.ndarray, picture: np.ndarray, trust: np.ndarray, weight: float) -> None:
    """Adds weight × trust (H, W) to ``shares`` and that times ``picture`` (H, W, 3) to ``added``; where trust is zero the picture may be
    anything, NaN included."""
    for i in range(shares.shape[0]):
        for j in range(shares.shape[1]):
            share = np.float32(weight) * trust[i, j]
            if share > 0:
                shares[i, j] += share
                for c in range(3):
                    added[i, j, c] += share * picture[i, j, c]
