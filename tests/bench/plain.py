# SPDX-License-Identifier: Apache-2.0
"""The obvious numba rasteriser: one pixel at a time over its tile's list, scalar; the peer that the vector kernels are
measured against.

It blends the same splat records with the same thresholds, and its gradients by the records are those that ``backward``
turns into moments. Gradients are summed per thread, as in the fast one.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

TILE = 16


@njit(parallel=True, fastmath=True, cache=True)
def blend(columns, rows, splats, starts, pairs, planes):
    """Fills planes (5, H, W): red, green, blue, depth sum, transmittance."""
    height, width = planes.shape[1], planes.shape[2]
    for tile in prange(columns * rows):
        for y in range(tile // columns * TILE, min(height, tile // columns * TILE + TILE)):
            for x in range(tile % columns * TILE, min(width, tile % columns * TILE + TILE)):
                rest = np.float32(1)
                red, green, blue, depth = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
                for i in range(starts[tile], starts[tile + 1]):
                    s = splats[pairs[i]]
                    dy = np.float32(y) + np.float32(0.5) - s[1]
                    u = np.float32(x) + np.float32(0.5) - s[0] - s[3] * dy
                    power = s[5] - s[2] * u * u - s[4] * dy * dy
                    if power < np.float32(-7.9943534):
                        continue
                    alpha = min(np.float32(0.999), math.exp(power * np.float32(0.6931472)))
                    after = rest * (np.float32(1) - alpha)
                    if after <= np.float32(1e-4):
                        break
                    weight = alpha * rest
                    red, green, blue, depth = (
                        red + weight * s[6],
                        green + weight * s[7],
                        blue + weight * s[8],
                        depth + weight * s[9],
                    )
                    rest = after
                planes[0, y, x], planes[1, y, x], planes[2, y, x], planes[3, y, x], planes[4, y, x] = (
                    red,
                    green,
                    blue,
                    depth,
                    rest,
                )


@njit(parallel=True, fastmath=True, cache=True)
def gather(shares, columns, rows, splats, starts, pairs, planes, by, gradients):
    """Adds to gradients (shares, N, 10) by centre, ellipse, log2 opacity, colour and depth for image gradients (5, H,
    W)."""
    height, width = planes.shape[1], planes.shape[2]
    for share in prange(shares):
        for tile in range(share, columns * rows, shares):
            for y in range(tile // columns * TILE, min(height, tile // columns * TILE + TILE)):
                for x in range(tile % columns * TILE, min(width, tile % columns * TILE + TILE)):
                    rest = np.float32(1)
                    left = planes[0, y, x] * by[0, y, x] + planes[1, y, x] * by[1, y, x] + planes[2, y, x] * by[2, y, x]
                    left += planes[3, y, x] * by[3, y, x] - planes[4, y, x] * by[4, y, x]
                    for i in range(starts[tile], starts[tile + 1]):
                        j = pairs[i]
                        s = splats[j]
                        dy = np.float32(y) + np.float32(0.5) - s[1]
                        u = np.float32(x) + np.float32(0.5) - s[0] - s[3] * dy
                        power = s[5] - s[2] * u * u - s[4] * dy * dy
                        if power < np.float32(-7.9943534):
                            continue
                        uncut = math.exp(power * np.float32(0.6931472))
                        alpha = min(np.float32(0.999), uncut)
                        after = rest * (np.float32(1) - alpha)
                        if after <= np.float32(1e-4):
                            break
                        weight = alpha * rest
                        gain = s[6] * by[0, y, x] + s[7] * by[1, y, x] + s[8] * by[2, y, x] + s[9] * by[3, y, x]
                        left -= weight * gain
                        g = gradients[share, j]
                        for channel in range(4):
                            g[6 + channel] += weight * by[channel, y, x]
                        if uncut < np.float32(0.999):
                            q = alpha * (rest * gain - left / (np.float32(1) - alpha))
                            g[0] += q * u
                            g[1] += q * dy
                            g[2] += q * u * u
                            g[3] += q * u * dy
                            g[4] += q * dy * dy
                            g[5] += q
                        rest = after
