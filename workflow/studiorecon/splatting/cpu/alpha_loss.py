# SPDX-License-Identifier: Apache-2.0
"""Kernels of the losses on the alpha plane: the density prior and the silhouette."""

from __future__ import annotations

import numpy as np
from numba import float32, njit, prange

from studiorecon.splatting.conventions import INLINE, KERNEL, LANES, LOG2_E
from studiorecon.splatting.cpu.simd import broadcast, exp2, log2
from studiorecon.splatting.cpu.simd_rows import load, store

DENSITY_OFFSET = np.float32(np.log1p(np.exp(-1.0)))
"""log(1 + 1/e): makes the density prior 0 for empty and for opaque pixels."""
LN_2 = np.float32(np.log(2.0))


@njit(**INLINE)
def _sixteen(flat, start, count, missing, scratch):
    """flat[start : start + count] in the first lanes, ``missing`` in the others; all ``missing`` for an empty array."""
    if len(flat) == 0:
        return broadcast(missing)
    if count >= LANES:
        return load(flat, start)
    for lane in range(LANES):
        scratch[lane] = flat[start + lane] if lane < count else missing
    return load(scratch, 0)


@njit(parallel=True, **KERNEL)
def density_terms(planes, weight, density, gradient, sums):
    """Add the gradient of density·w·D(α) by alpha to gradient[4]; sums (H,) = Σ w·D(α) per row.

    With u = e^{2α−1}: D = log(1 + 1/e) + α − log(1 + u) and D' = (1 − u)/(1 + u) = tanh(½ − α).
    """
    height, width = planes.shape[1], planes.shape[2]
    rest, slopes = planes[4].reshape(-1), gradient[4].reshape(-1)
    one = broadcast(float32(1))
    for y in prange(height):
        scratch = np.zeros(LANES, np.float32)
        row = y * width
        for x in range(0, width, LANES):
            count = width - x
            alpha = one - _sixteen(rest, row + x, count, float32(1), scratch)
            w = _sixteen(weight, row + x, count, float32(1), scratch)
            u = exp2((2 * alpha - one) * LOG2_E)
            prior = w * (alpha + DENSITY_OFFSET - LN_2 * log2(one + u))
            slope = w * (density * ((one - u) / (one + u)))
            if count >= LANES:
                store(slopes, row + x, load(slopes, row + x) + slope)
            else:
                store(scratch, 0, slope)
                for lane in range(count):
                    slopes[row + x + lane] += scratch[lane]
            store(scratch, 0, prior)
            for lane in range(min(LANES, count)):
                sums[y] += scratch[lane]


@njit(**KERNEL)
def silhouette_terms(planes, weight, wanted, strength, gradient, sums):
    """Add the gradient of strength · Σ weight |alpha − wanted| to ``gradient[4]``, and every row's sum to ``sums``
    (H,).
    """
    for y in range(weight.shape[0]):
        for x in range(weight.shape[1]):
            miss = float32(1) - planes[4, y, x] - (float32(1) if wanted[y, x] else float32(0))
            if miss != float32(0):
                sums[y] += weight[y, x] * abs(miss)
                gradient[4, y, x] += (strength if miss > float32(0) else -strength) * weight[y, x]
