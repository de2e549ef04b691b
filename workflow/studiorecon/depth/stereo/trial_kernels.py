# SPDX-License-Identifier: Apache-2.0
"""The compiled trial of primitives for ``photo_cost``: the change of all pixels' nats by one more primitive.

Arrays are (V, H, W) for V views; a primitive is seven numbers (``primitives.Primitive.numbers``).
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from studiorecon.depth.stereo.kernels import (
    BEFORE,
    HIDING_M,
    HIDING_SHARE,
    NEAR_M,
    NOT_JUDGED,
    is_hidden,
    primitive_bounds,
    trace_primitive,
    warp_pixel,
    window_nats,
)

# Nats of a pixel that one camera alone sees and that differs fully from the wall.
FOREGROUND_NATS = 2.1


@njit(cache=True, parallel=True)
def trial_gains(photos, explained, half, mean_weight, primitives):
    """(N,) nats by which all pixels are explained better with each of N primitives (N, 7) added alone.

    ``photos``: lens, pose, centre, rgb, known; ``explained``: depth, surface, pair, at, z, begin, dependents, nats,
    foreground (``photo_cost.PhotoCostVolume``).
    """
    found = np.zeros(len(primitives))
    for k in prange(len(primitives)):
        found[k] = _gain(photos, explained, half, mean_weight, primitives[k])
    return found


@njit(cache=True)
def _gain(photos, explained, half, mean_weight, primitive):
    lens, pose, centre, rgb, known = photos
    depth, surface, pair, at, z, begin, dependents, nats, foreground = explained
    views, height, width = known.shape
    trial = np.zeros((views, height, width), np.float32)
    number = np.zeros((views, height, width), np.int8)
    ray, normal = np.zeros(3), np.zeros(3)
    c, s = np.cos(primitive[2]), np.sin(primitive[2])
    touched = np.zeros((views, 4), np.int64)
    for v in range(views):
        top, bottom, left, right = primitive_bounds(lens, pose, primitive, v, height, width)
        touched[v, 0], touched[v, 1], touched[v, 2], touched[v, 3] = height, 0, width, 0
        for y in range(top, bottom):
            for x in range(left, right):
                d, face = trace_primitive(lens, pose, centre, v, y, x, primitive, c, s, ray, normal)
                if d > NEAR_M and d < depth[v, y, x] * BEFORE:
                    trial[v, y, x], number[v, y, x] = d, 1 + face
                    touched[v, 0], touched[v, 1] = min(touched[v, 0], y), max(touched[v, 1], y + 1)
                    touched[v, 2], touched[v, 3] = min(touched[v, 2], x), max(touched[v, 3], x + 1)
    # Pixels whose surface another camera may no longer see.
    behind = np.zeros((views, height, width), np.bool_)
    for o in range(views):
        for y in range(touched[o, 0], touched[o, 1]):
            for x in range(touched[o, 2], touched[o, 3]):
                if number[o, y, x] > 0:
                    flat_here = y * width + x
                    for entry in range(begin[o, flat_here], begin[o, flat_here + 1]):
                        behind.flat[dependents[o, entry]] = True
    gain = 0.0
    for v in range(views):
        # Pixels that now show the primitive.
        top, bottom, left, right = touched[v]
        rows, columns = max(bottom - top, 0), max(right - left, 0)
        total, count = np.zeros((rows, columns), np.float32), np.zeros((rows, columns), np.int32)
        samples, seen = np.empty((rows, columns, 3), np.float32), np.zeros((rows, columns), np.bool_)
        flat, there = np.empty((rows, columns), np.int64), np.empty((rows, columns), np.float32)
        for o in range(views):
            if o == v or rows == 0:
                continue
            for y in range(rows):
                for x in range(columns):
                    seen[y, x] = False
                    if number[v, y + top, x + left] > 0 and known[v, y + top, x + left]:
                        flat[y, x], there[y, x] = warp_pixel(
                            lens, pose, rgb, known, trial, v, o, y + top, x + left, samples[y, x]
                        )
                        seen[y, x] = flat[y, x] >= 0
            for y in range(rows):
                for x in range(columns):
                    if not seen[y, x] or is_hidden(depth, o, flat[y, x], there[y, x]):
                        continue
                    before = trial[o].flat[flat[y, x]]
                    if before > 0 and before < there[y, x] * (1 - HIDING_SHARE) - HIDING_M:
                        continue
                    value = window_nats(
                        rgb,
                        v,
                        y + top,
                        x + left,
                        samples,
                        seen,
                        number[v, top:bottom, left:right],
                        top,
                        left,
                        half,
                        mean_weight,
                    )
                    if value < NOT_JUDGED:
                        total[y, x] += value
                        count[y, x] += 1
        for y in range(rows):
            for x in range(columns):
                if number[v, y + top, x + left] == 0 or not known[v, y + top, x + left]:
                    continue
                was = nats[v, y + top, x + left]
                if count[y, x] > 0:
                    gain += was - total[y, x] / count[y, x]
                elif was < 0:
                    gain += was
                elif surface[v, y + top, x + left] < 6:
                    gain += FOREGROUND_NATS * foreground[v, y + top, x + left]
        # Pixels on other surfaces that another camera no longer sees.
        for y in range(height):
            for x in range(width):
                if not behind[v, y, x] or number[v, y, x] > 0:
                    continue
                sum_, n, lost = 0.0, 0, False
                for o in range(views):
                    if pair[v, o, y, x] >= NOT_JUDGED:
                        continue
                    before = trial[o].flat[at[v, o, y, x]]
                    gone = before > 0 and before < z[v, o, y, x] * (1 - HIDING_SHARE) - HIDING_M
                    if is_hidden(depth, o, at[v, o, y, x], z[v, o, y, x]):
                        continue
                    if gone:
                        lost = True
                    else:
                        sum_ += pair[v, o, y, x]
                        n += 1
                if lost:
                    gain += nats[v, y, x] - (sum_ / n if n else 0.0)
    return gain
