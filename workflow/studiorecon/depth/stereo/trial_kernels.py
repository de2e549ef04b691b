# SPDX-License-Identifier: Apache-2.0
"""The compiled trial of primitives for ``photo_cost``: the change of all pixels' cost by one more primitive.

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
    UNSEEN,
    is_hidden,
    primitive_bounds,
    trace_primitive,
    warp_pixel,
    window_cost,
)

# Gain of a pixel that one camera alone sees and that differs fully from the wall; and of one of an unoccluded object on
# the floor, which then counts as explained like pixels on which two cameras agree.
_ODDS_WEIGHT, _STANDING_WEIGHT = 0.3, 0.4
# An object is unoccluded when so much of its foot has floor in front of it, this many pixels below, and wall on its
# sides, this many pixels away; its foot is on the floor within so many metres.
_CLEAR_FOOT, _BELOW, _BESIDE, _STANDING_M = 0.5, 2, 2, 0.03


@njit(cache=True, parallel=True)
def trial_gains(photos, explained, half, mean_weight, floor_m, primitives, thin):
    """(N,) decrease of the cost of all pixels with each of N primitives (N, 7) added alone.

    ``photos``: lens, pose, centre, rgb, known; ``explained``: depth, surface, pair, at, z, begin, dependents,
    cost, odds (``photo_cost.PhotoCostVolume``); ``floor_m``: height of the floor; ``thin``:
    they have too few pixels to match, and gain by all that they hide.
    """
    found = np.zeros(len(primitives))
    for k in prange(len(primitives)):
        found[k] = _gain(photos, explained, half, mean_weight, floor_m, primitives[k], thin)
    return found


@njit(cache=True)
def _is_unoccluded(number, known, surface, odds, top, bottom, left, right):
    """Whether a trial object (``number`` not 0) shows its whole outline: floor before its foot, wall on either side."""
    height, width = number.shape
    foot, clear, beside, total = 0, 0, 0, 0.0
    for x in range(left, right):
        low = -1
        for y in range(top, bottom):
            if number[y, x] > 0:
                low = y
        if low < 0:
            continue
        foot += 1
        y = low + _BELOW
        if y < height and known[y, x] and number[y, x] == 0 and surface[y, x] == 4 and odds[y, x] < 0:
            clear += 1
    for y in range(top, bottom):
        for x in range(left, right):
            if number[y, x] == 0:
                continue
            for step in (-_BESIDE, _BESIDE):
                i = x + step
                if 0 <= i < width and number[y, i] == 0 and known[y, i] and 0 <= surface[y, i] < 6:
                    total += odds[y, i]
                    beside += 1
    return clear >= _CLEAR_FOOT * foot and beside > 0 and total < 0


@njit(cache=True)
def _gain(photos, explained, half, mean_weight, floor_m, primitive, thin):
    lens, pose, centre, rgb, known = photos
    depth, surface, pair, at, z, begin, dependents, cost, odds = explained
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
    hiding, shown, unlike, clear = 0.0, 0.0, 0.0, 0.0
    for v in range(views):
        before_view = unlike
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
                    value = window_cost(
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
                    if value >= 0:
                        total[y, x] += value
                        count[y, x] += 1
        for y in range(rows):
            for x in range(columns):
                if number[v, y + top, x + left] == 0 or not known[v, y + top, x + left]:
                    continue
                was = cost[v, y + top, x + left]
                if count[y, x] > 0:
                    shown += was - total[y, x] / count[y, x]
                elif was < UNSEEN:
                    hiding += was - UNSEEN
                elif surface[v, y + top, x + left] < 6:
                    unlike += _ODDS_WEIGHT * odds[v, y + top, x + left]
        own = (unlike - before_view) / _ODDS_WEIGHT
        stands = own > 0 and primitive[5] <= floor_m + _STANDING_M
        if stands and _is_unoccluded(number[v], known[v], surface[v], odds[v], top, bottom, left, right):
            clear += _STANDING_WEIGHT * own
        # Pixels on other surfaces that another camera no longer sees.
        for y in range(height):
            for x in range(width):
                if not behind[v, y, x] or number[v, y, x] > 0:
                    continue
                sum_, n, lost = 0.0, 0, False
                for o in range(views):
                    if pair[v, o, y, x] < 0:
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
                    hiding += cost[v, y, x] - (sum_ / n if n else UNSEEN)
    # A floor in the wrong place matches nothing, and all that hides it would gain: no more than by what it shows.
    gain = shown + (hiding if thin else min(hiding, max(shown, 0.0)))
    # Dissimilarity extends regions on which cameras agree, and never counts more than them: one photo does not
    # determine the position of a floating object. It does determine that of an object whose foot it sees.
    return gain + max(min(unlike, max(gain, 0.0)), clear)
