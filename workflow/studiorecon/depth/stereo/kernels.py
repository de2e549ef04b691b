# SPDX-License-Identifier: Apache-2.0
"""Compiled loops of ``photo_cost``: colours of one camera's surfaces in the others, windowed correlation over a
surface, one primitive on trial.

Arrays are (V, H, W) for V views; a primitive is eight numbers (``primitives.Primitive.numbers``).
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from studiorecon.depth.layout.primitives import enter

# Cost of a pixel whose surface no other camera sees: between a match (about 0.1) and chance (about 0.9).
UNSEEN = np.float32(0.5)
# What stands before a surface hides it when nearer by this share and this many metres (as in passes.py, a little
# sharper).
_HIDING_SHARE, _HIDING_M = 0.03, 0.03
# As in matching.py: flat windows correlate, so they are told from each other by their means and cost at least this.
_FLAT_VARIANCE, _FLAT_COST, _LEAST_VARIANCE = 4e-4, 0.3, 1e-3
_MOST_DIFFERENCE, _MOST_COST = 0.6, 1.2
_LEAST_PIXELS = 8
_NEAR_M = 0.1
# Depth is stored in single precision: what is nearer by less than this share is the same surface.
_BEFORE = 1 - 1e-5
# Worth of a pixel that one camera alone sees and that looks not at all like the wall; of one of a thing that stands
# before everybody's eyes, which is explained as well then as what two cameras agree on.
_ODDS_WEIGHT, _STANDING_WEIGHT = 0.3, 0.4
# A thing stands before everybody's eyes when so much of its foot has floor before it, seen this many pixels below, and
# what is this many pixels beside it is wall again; its foot is on the floor within so many metres.
_CLEAR_FOOT, _BELOW, _BESIDE, _STANDING_M = 0.5, 2, 2, 0.03
# Surfaces are numbered: the room box's faces 0-5, then ten for every primitive; one on trial has the numbers from here.
FIRST, _TRIAL = 10, 30_000


@njit(cache=True)
def _warp(lens, pose, rgb, known, depth, v, o, y, x, sample):
    """Colour of a pixel's surface point in another camera into ``sample``: (flat pixel or -1, depth there)."""
    height, width = known.shape[1:]
    d = depth[v, y, x]
    # Camera coordinates, then world by the transposed rotation, then the other camera.
    px, py = (
        d * (x + 0.5 - lens[v, 2]) / lens[v, 0] - pose[v, 0, 3],
        d * (y + 0.5 - lens[v, 3]) / lens[v, 1] - pose[v, 1, 3],
    )
    pz = d - pose[v, 2, 3]
    wx = pose[v, 0, 0] * px + pose[v, 1, 0] * py + pose[v, 2, 0] * pz
    wy = pose[v, 0, 1] * px + pose[v, 1, 1] * py + pose[v, 2, 1] * pz
    wz = pose[v, 0, 2] * px + pose[v, 1, 2] * py + pose[v, 2, 2] * pz
    z = pose[o, 2, 0] * wx + pose[o, 2, 1] * wy + pose[o, 2, 2] * wz + pose[o, 2, 3]
    if z < _NEAR_M:
        return -1, 0.0
    u = (
        lens[o, 0] * (pose[o, 0, 0] * wx + pose[o, 0, 1] * wy + pose[o, 0, 2] * wz + pose[o, 0, 3]) / z
        + lens[o, 2]
        - 0.5
    )
    w = (
        lens[o, 1] * (pose[o, 1, 0] * wx + pose[o, 1, 1] * wy + pose[o, 1, 2] * wz + pose[o, 1, 3]) / z
        + lens[o, 3]
        - 0.5
    )
    if not (u >= 0 and w >= 0 and u < width - 1 and w < height - 1):
        return -1, 0.0
    i, j = int(u), int(w)
    if not (known[o, j, i] and known[o, j, i + 1] and known[o, j + 1, i] and known[o, j + 1, i + 1]):
        return -1, 0.0
    p, q = np.float32(u - i), np.float32(w - j)
    for c in range(3):
        upper = rgb[o, j, i, c] * (1 - p) + rgb[o, j, i + 1, c] * p
        lower = rgb[o, j + 1, i, c] * (1 - p) + rgb[o, j + 1, i + 1, c] * p
        sample[c] = upper * (1 - q) + lower * q
    return int(w + 0.5) * width + int(u + 0.5), z


@njit(cache=True, fastmath=True)
def _window_cost(rgb, v, y, x, samples, seen, surface, top, left, half, mean_weight):
    """Cost of a pixel in one other camera over its surface's pixels in the window; -1 with too few. ``samples`` starts
    at (top, left)."""
    rows, columns = seen.shape
    mine = surface[y - top, x - left]
    n, aa, bb, ab = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
    a0, a1, a2 = np.float32(0), np.float32(0), np.float32(0)
    b0, b1, b2 = np.float32(0), np.float32(0), np.float32(0)
    for j in range(max(y - top - half, 0), min(y - top + half + 1, rows)):
        for i in range(max(x - left - half, 0), min(x - left + half + 1, columns)):
            if not seen[j, i] or surface[j, i] != mine:
                continue
            r0, r1, r2 = rgb[v, j + top, i + left, 0], rgb[v, j + top, i + left, 1], rgb[v, j + top, i + left, 2]
            s0, s1, s2 = samples[j, i, 0], samples[j, i, 1], samples[j, i, 2]
            a0, a1, a2, b0, b1, b2 = a0 + r0, a1 + r1, a2 + r2, b0 + s0, b1 + s1, b2 + s2
            aa += r0 * r0 + r1 * r1 + r2 * r2
            bb += s0 * s0 + s1 * s1 + s2 * s2
            ab += r0 * s0 + r1 * s1 + r2 * s2
            n += 1
    if n < _LEAST_PIXELS:
        return np.float32(-1)
    k = 1 / n
    a0, a1, a2, b0, b1, b2 = a0 * k, a1 * k, a2 * k, b0 * k, b1 * k, b2 * k
    va = max(aa * k - a0 * a0 - a1 * a1 - a2 * a2, np.float32(0))
    vb = max(bb * k - b0 * b0 - b1 * b1 - b2 * b2, np.float32(0))
    cov = ab * k - a0 * b0 - a1 * b1 - a2 * b2
    apart = min(abs(a0 - b0) + abs(a1 - b1) + abs(a2 - b2), np.float32(_MOST_DIFFERENCE))
    score = (cov + _FLAT_VARIANCE) / np.sqrt((va + _FLAT_VARIANCE) * (vb + _FLAT_VARIANCE)) - mean_weight * apart
    cost = min(max(1 - score, 0.0), _MOST_COST)
    if va < _LEAST_VARIANCE:
        cost = max(cost, _FLAT_COST)
    return np.float32(cost)


@njit(cache=True)
def _hidden(depth, o, flat, z):
    return depth[o].flat[flat] < z * (1 - _HIDING_SHARE) - _HIDING_M


@njit(cache=True, parallel=True)
def explain_all(lens, pose, centre, rgb, known, depth, surface, pair, at, z, cost, judges, half, mean_weight):
    """Fill ``pair``, ``at``, ``z``, ``cost`` and ``judges`` (see ``evidence.Explained``) for the surfaces in ``depth``
    and ``surface``."""
    views, height, width = known.shape
    for job in prange(views * views):
        v, o = job // views, job % views
        if v == o:
            pair[v, o] = -1
            continue
        samples, seen = np.zeros((height, width, 3), np.float32), np.zeros((height, width), np.bool_)
        for y in range(height):
            for x in range(width):
                if known[v, y, x]:
                    at[v, o, y, x], z[v, o, y, x] = _warp(lens, pose, rgb, known, depth, v, o, y, x, samples[y, x])
                    seen[y, x] = at[v, o, y, x] >= 0
        for y in range(height):
            for x in range(width):
                pair[v, o, y, x] = -1
                if seen[y, x]:
                    pair[v, o, y, x] = _window_cost(rgb, v, y, x, samples, seen, surface[v], 0, 0, half, mean_weight)
    for v in prange(views):
        for y in range(height):
            for x in range(width):
                total, count = 0.0, 0
                for o in range(views):
                    if (
                        known[v, y, x]
                        and pair[v, o, y, x] >= 0
                        and not _hidden(depth, o, at[v, o, y, x], z[v, o, y, x])
                    ):
                        total += pair[v, o, y, x]
                        count += 1
                judges[v, y, x] = count
                cost[v, y, x] = (total / count if count else UNSEEN) if known[v, y, x] else 0


@njit(cache=True)
def _bounds(lens, pose, primitive, v, height, width):
    """Rows and columns (top, bottom, left, right) that a primitive can cover in a view."""
    c, s = np.cos(primitive[3]), np.sin(primitive[3])
    top, bottom, left, right = float(height), 0.0, float(width), 0.0
    for corner in range(8):
        a = primitive[4] / 2 if corner & 1 else -primitive[4] / 2
        b = primitive[5] / 2 if corner & 2 else -primitive[5] / 2
        px, py, pz = (
            primitive[1] + c * a - s * b,
            primitive[2] + s * a + c * b,
            primitive[7] if corner & 4 else primitive[6],
        )
        z = pose[v, 2, 0] * px + pose[v, 2, 1] * py + pose[v, 2, 2] * pz + pose[v, 2, 3]
        if z < _NEAR_M:
            return 0, height, 0, width
        u = lens[v, 0] * (pose[v, 0, 0] * px + pose[v, 0, 1] * py + pose[v, 0, 2] * pz + pose[v, 0, 3]) / z + lens[v, 2]
        w = lens[v, 1] * (pose[v, 1, 0] * px + pose[v, 1, 1] * py + pose[v, 1, 2] * pz + pose[v, 1, 3]) / z + lens[v, 3]
        top, bottom, left, right = min(top, w), max(bottom, w), min(left, u), max(right, u)
    return (
        int(max(top, 0.0)),
        int(min(bottom + 1, float(height))),
        int(max(left, 0.0)),
        int(min(right + 1, float(width))),
    )


@njit(cache=True)
def _trace(lens, pose, centre, v, y, x, primitive, ray, normal):
    """(depth or -1, face 0..7) at which a pixel's ray enters a primitive."""
    rx, ry = (x + 0.5 - lens[v, 2]) / lens[v, 0], (y + 0.5 - lens[v, 3]) / lens[v, 1]
    for i in range(3):
        ray[i] = pose[v, 0, i] * rx + pose[v, 1, i] * ry + pose[v, 2, i]
    d = enter(primitive, centre[v], ray, normal)
    face = 0
    if normal[2] > 0.5:
        face = 1
    elif normal[2] < -0.5:
        face = 2
    elif primitive[0] == 0:
        u = np.cos(primitive[3]) * normal[0] + np.sin(primitive[3]) * normal[1]
        w = np.cos(primitive[3]) * normal[1] - np.sin(primitive[3]) * normal[0]
        face = (3 if u > 0 else 4) if abs(u) > abs(w) else (5 if w > 0 else 6)
    return d, face


@njit(cache=True)
def draw(lens, pose, centre, known, depth, surface, primitive, first):
    """Put a primitive into depth and surface."""
    views, height, width = known.shape
    ray, normal = np.zeros(3), np.zeros(3)
    for v in range(views):
        top, bottom, left, right = _bounds(lens, pose, primitive, v, height, width)
        for y in range(top, bottom):
            for x in range(left, right):
                d, face = _trace(lens, pose, centre, v, y, x, primitive, ray, normal)
                if d > _NEAR_M and d < depth[v, y, x] * _BEFORE:
                    depth[v, y, x], surface[v, y, x] = d, first + face


@njit(cache=True, parallel=True)
def gains(
    lens, pose, centre, rgb, known, depth, surface, pair, at, z, cost, odds, half, mean_weight, floor_m, primitives
):
    """(N, 3) by how much the cost of all pixels falls with each of N primitives (N, 8) added alone; then of the pixels
    that show it and that another camera judges, by how much theirs falls and what it was; ``floor_m``: height of the
    floor."""
    found = np.zeros((len(primitives), 3))
    for k in prange(len(primitives)):
        found[k, 0], found[k, 1], found[k, 2] = _gain(
            lens,
            pose,
            centre,
            rgb,
            known,
            depth,
            surface,
            pair,
            at,
            z,
            cost,
            odds,
            half,
            mean_weight,
            floor_m,
            primitives[k],
        )
    return found


@njit(cache=True)
def _stands_clear(number, known, surface, odds, top, bottom, left, right):
    """Whether a thing on trial, where ``number`` (H, W) is not 0, shows its whole outline to one camera: floor before
    its foot, and on either side what looks like the wall behind."""
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
def _gain(
    lens, pose, centre, rgb, known, depth, surface, pair, at, z, cost, odds, half, mean_weight, floor_m, primitive
):
    views, height, width = known.shape
    trial = np.zeros((views, height, width), np.float32)
    number = np.zeros((views, height, width), np.int32)
    ray, normal = np.zeros(3), np.zeros(3)
    touched = np.zeros((views, 4), np.int64)
    for v in range(views):
        top, bottom, left, right = _bounds(lens, pose, primitive, v, height, width)
        touched[v, 0], touched[v, 1], touched[v, 2], touched[v, 3] = height, 0, width, 0
        for y in range(top, bottom):
            for x in range(left, right):
                d, face = _trace(lens, pose, centre, v, y, x, primitive, ray, normal)
                if d > _NEAR_M and d < depth[v, y, x] * _BEFORE:
                    trial[v, y, x], number[v, y, x] = d, _TRIAL + face
                    touched[v, 0], touched[v, 1] = min(touched[v, 0], y), max(touched[v, 1], y + 1)
                    touched[v, 2], touched[v, 3] = min(touched[v, 2], x), max(touched[v, 3], x + 1)
    gain, shown, before_cost, unlike, clear = 0.0, 0.0, 0.0, 0.0, 0.0
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
                        flat[y, x], there[y, x] = _warp(
                            lens, pose, rgb, known, trial, v, o, y + top, x + left, samples[y, x]
                        )
                        seen[y, x] = flat[y, x] >= 0
            for y in range(rows):
                for x in range(columns):
                    if not seen[y, x] or _hidden(depth, o, flat[y, x], there[y, x]):
                        continue
                    before = trial[o].flat[flat[y, x]]
                    if before > 0 and before < there[y, x] * (1 - _HIDING_SHARE) - _HIDING_M:
                        continue
                    value = _window_cost(
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
                    before_cost += was
                elif was < UNSEEN:
                    gain += was - UNSEEN
                elif surface[v, y + top, x + left] < 6:
                    unlike += _ODDS_WEIGHT * odds[v, y + top, x + left]
        own = (unlike - before_view) / _ODDS_WEIGHT
        stands = own > 0 and primitive[6] <= floor_m + _STANDING_M
        if stands and _stands_clear(number[v], known[v], surface[v], odds[v], top, bottom, left, right):
            clear += _STANDING_WEIGHT * own
        # Pixels on other surfaces that another camera no longer sees.
        for y in range(height):
            for x in range(width):
                if number[v, y, x] > 0 or not known[v, y, x]:
                    continue
                sum_, n, lost = 0.0, 0, False
                for o in range(views):
                    if pair[v, o, y, x] < 0:
                        continue
                    before = trial[o].flat[at[v, o, y, x]]
                    gone = before > 0 and before < z[v, o, y, x] * (1 - _HIDING_SHARE) - _HIDING_M
                    if _hidden(depth, o, at[v, o, y, x], z[v, o, y, x]):
                        continue
                    if gone:
                        lost = True
                    else:
                        sum_ += pair[v, o, y, x]
                        n += 1
                if lost:
                    gain += cost[v, y, x] - (sum_ / n if n else UNSEEN)
    # Looks extend what cameras agree on, and are never worth more than that: one photo does not tell where a thing
    # floats. It does tell where a thing stands whose foot it sees.
    gain += shown
    return gain + max(min(unlike, max(gain, 0.0)), clear), shown, before_cost
