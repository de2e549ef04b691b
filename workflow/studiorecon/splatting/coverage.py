# SPDX-License-Identifier: Apache-2.0
"""Kernels of the losses on alpha and depth planes."""

from __future__ import annotations

import numpy as np
from numba import float32, njit, prange

from studiorecon.splatting.conventions import INLINE, KERNEL, LANES, LOG2_E
from studiorecon.splatting.planes import DEPTH_ALPHA_MIN
from studiorecon.splatting.simd import broadcast, exp2, log2, madd
from studiorecon.splatting.simd_rows import load, store

DENSITY_OFFSET = np.float32(np.log1p(np.exp(-1.0)))
"""log(1 + 1/e): makes the density prior 0 for empty and for opaque pixels."""
LN_2 = np.float32(np.log(2.0))
DEPTH_SOFTNESS = np.float32(0.02)
"""Relative depth error below which the absolute value is rounded to a parabola."""


@njit(**INLINE)
def _sixteen(flat, start, count, missing, scratch):
    """flat[start : start + count] in the first lanes, ``missing`` in the others; an empty array is ``missing`` everywhere."""
    if len(flat) == 0:
        return broadcast(missing)
    if count >= LANES:
        return load(flat, start)
    for lane in range(LANES):
        scratch[lane] = flat[start + lane] if lane < count else missing
    return load(scratch, 0)


@njit(parallel=True, **KERNEL)
def alpha_terms(planes, mask, weight, silhouette, density, gradient, sums):
    """gradient[4] = by alpha of silhouette·w(α − mask)² + density·w·D(α); sums (H, 2) = Σ w(α − mask)², Σ w·D(α) per row.

    With u = e^{2α−1}: D = log(1 + 1/e) + α − log(1 + u) and D' = (1 − u)/(1 + u) = tanh(½ − α).
    """
    height, width = planes.shape[1], planes.shape[2]
    rest, slopes = planes[4].reshape(-1), gradient[4].reshape(-1)
    one, twice = broadcast(float32(1)), broadcast(float32(2) * silhouette)
    for y in prange(height):
        scratch = np.zeros(LANES, np.float32)
        row = y * width
        for x in range(0, width, LANES):
            count = width - x
            alpha = one - _sixteen(rest, row + x, count, float32(1), scratch)
            w = _sixteen(weight, row + x, count, float32(1), scratch)
            error = alpha - _sixteen(mask, row + x, count, float32(0), scratch)
            u = exp2((2 * alpha - one) * LOG2_E)
            prior = alpha + DENSITY_OFFSET - LN_2 * log2(one + u)
            slope = w * madd(twice, error, density * ((one - u) / (one + u)))
            silhouette_terms, density_terms = w * error * error, w * prior
            if count >= LANES:
                store(slopes, row + x, slope)
            else:
                store(scratch, 0, slope)
                for lane in range(count):
                    slopes[row + x + lane] = scratch[lane]
            store(scratch, 0, silhouette_terms)
            for lane in range(min(LANES, count)):
                sums[y, 0] += scratch[lane]
            store(scratch, 0, density_terms)
            for lane in range(min(LANES, count)):
                sums[y, 1] += scratch[lane]


@njit(parallel=True, **KERNEL)
def depth_terms(planes, wanted_m, weight, strength, gradient, sums):
    """Adds to gradient[3] (depth sum) and gradient[4] (alpha) those of strength·w·ρ(d/wanted − 1), d = depth sum / alpha; sums (H,)."""
    for y in prange(planes.shape[1]):
        total = float32(0)
        for x in range(planes.shape[2]):
            wanted, alpha = wanted_m[y, x], float32(1) - planes[4, y, x]
            w = weight[y * planes.shape[2] + x] if len(weight) else float32(1)
            if not (wanted > float32(0) and w > float32(0) and alpha >= DEPTH_ALPHA_MIN):
                continue
            depth = planes[3, y, x] / alpha
            error = depth / wanted - float32(1)
            size = abs(error)
            if size < DEPTH_SOFTNESS:
                total += w * float32(0.5) * error * error / DEPTH_SOFTNESS
                slope = error / DEPTH_SOFTNESS
            else:
                total += w * (size - float32(0.5) * DEPTH_SOFTNESS)
                slope = float32(1) if error > float32(0) else float32(-1)
            by_depth = strength * w * slope / wanted
            gradient[3, y, x] += by_depth / alpha
            gradient[4, y, x] -= by_depth * depth / alpha
        sums[y] = total
