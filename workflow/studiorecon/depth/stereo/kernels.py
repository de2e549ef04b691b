# SPDX-License-Identifier: Apache-2.0
"""Compiled loops of ``photo_cost``: colours of surfaces in other cameras, windowed correlation, visible primitives.

``trial_kernels`` computes the change by one more primitive. Arrays are (V, H, W) for V views; a primitive is seven
numbers (``primitives.Primitive.numbers``).
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from studiorecon.depth.layout.primitives import ray_entry_length

# Cost of a pixel whose surface no other camera sees: between a match (about 0.1) and chance (about 0.9).
UNSEEN = np.float32(0.5)
# A surface hides another when it is nearer by this share and this many metres (as in passes.py, a little stricter).
HIDING_SHARE, HIDING_M = 0.03, 0.03
# As in matching.py: flat windows always correlate, so they are compared by their means and cost at least this.
_FLAT_VARIANCE, _FLAT_COST, _MIN_VARIANCE = 4e-4, 0.3, 1e-3
_MAX_DIFFERENCE, _MAX_COST = 0.6, 1.2
_MIN_PIXELS = 8
NEAR_M = 0.1
# Depth is stored in single precision: nearer by less than this share is the same surface.
BEFORE = 1 - 1e-5
# Surfaces are numbered: the room box's faces 0-5, then ten for every primitive.
FIRST = 10


@njit(cache=True)
def warp_pixel(lens, pose, rgb, known, depth, v, o, y, x, sample):
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
    if z < NEAR_M:
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
def window_cost(rgb, v, y, x, samples, seen, surface, top, left, half, mean_weight):
    """Cost of a pixel in one other camera over its surface's pixels in the window from (top, left); -1 with too few."""
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
    if n < _MIN_PIXELS:
        return np.float32(-1)
    k = 1 / n
    a0, a1, a2, b0, b1, b2 = a0 * k, a1 * k, a2 * k, b0 * k, b1 * k, b2 * k
    va = max(aa * k - a0 * a0 - a1 * a1 - a2 * a2, np.float32(0))
    vb = max(bb * k - b0 * b0 - b1 * b1 - b2 * b2, np.float32(0))
    cov = ab * k - a0 * b0 - a1 * b1 - a2 * b2
    apart = min(abs(a0 - b0) + abs(a1 - b1) + abs(a2 - b2), np.float32(_MAX_DIFFERENCE))
    score = (cov + _FLAT_VARIANCE) / np.sqrt((va + _FLAT_VARIANCE) * (vb + _FLAT_VARIANCE)) - mean_weight * apart
    cost = min(max(1 - score, 0.0), _MAX_COST)
    if va < _MIN_VARIANCE:
        cost = max(cost, _FLAT_COST)
    return np.float32(cost)


@njit(cache=True)
def is_hidden(depth, o, flat, z):
    return depth[o].flat[flat] < z * (1 - HIDING_SHARE) - HIDING_M


@njit(cache=True, parallel=True)
def explain_all(lens, pose, centre, rgb, known, depth, surface, half, mean_weight):
    """Costs of the surfaces: ``pair``, ``at``, ``z``, ``cost``, ``view_count`` (``PhotoCostVolume``)."""
    views, height, width = known.shape
    pair = np.full((views, views, height, width), -1, np.float32)
    at, z = np.zeros(pair.shape, np.int32), np.zeros(pair.shape, np.float32)
    cost, view_count = np.zeros(known.shape, np.float32), np.zeros(known.shape, np.uint8)
    for job in prange(views * views):
        v, o = job // views, job % views
        if v == o:
            continue
        samples, seen = np.zeros((height, width, 3), np.float32), np.zeros((height, width), np.bool_)
        for y in range(height):
            for x in range(width):
                if known[v, y, x]:
                    at[v, o, y, x], z[v, o, y, x] = warp_pixel(lens, pose, rgb, known, depth, v, o, y, x, samples[y, x])
                    seen[y, x] = at[v, o, y, x] >= 0
        for y in range(height):
            for x in range(width):
                if seen[y, x]:
                    pair[v, o, y, x] = window_cost(rgb, v, y, x, samples, seen, surface[v], 0, 0, half, mean_weight)
    for v in prange(views):
        for y in range(height):
            for x in range(width):
                total, count = 0.0, 0
                for o in range(views):
                    if (
                        known[v, y, x]
                        and pair[v, o, y, x] >= 0
                        and not is_hidden(depth, o, at[v, o, y, x], z[v, o, y, x])
                    ):
                        total += pair[v, o, y, x]
                        count += 1
                view_count[v, y, x] = count
                cost[v, y, x] = (total / count if count else UNSEEN) if known[v, y, x] else 0
    return pair, at, z, cost, view_count


@njit(cache=True, parallel=True)
def invert_visibility(known, depth, pair, at, z):
    """Pixels whose cost depends on each pixel: (V, H W + 1) start indices, and (V, V H W) flat indices in (V, H, W).

    The inverse of ``at``, for pixels that are compared and not hidden.
    """
    views, height, width = known.shape
    size = height * width
    begin, dependents = np.zeros((views, size + 1), np.int64), np.empty((views, views * size), np.int32)
    for o in prange(views):
        for fill in range(2):
            for v in range(views):
                for y in range(height):
                    for x in range(width):
                        if not known[v, y, x] or pair[v, o, y, x] < 0:
                            continue
                        flat = at[v, o, y, x]
                        if is_hidden(depth, o, flat, z[v, o, y, x]):
                            continue
                        if fill:
                            dependents[o, begin[o, flat]] = (v * height + y) * width + x
                            begin[o, flat] += 1
                        else:
                            begin[o, flat + 1] += 1
            if fill:
                # Every pixel's start has become the next one's.
                for flat in range(size, 0, -1):
                    begin[o, flat] = begin[o, flat - 1]
                begin[o, 0] = 0
            else:
                for flat in range(size):
                    begin[o, flat + 1] += begin[o, flat]
    return begin, dependents


@njit(cache=True)
def primitive_bounds(lens, pose, primitive, v, height, width):
    """Rows and columns (top, bottom, left, right) of a view that a primitive in front of the camera can cover."""
    c, s = np.cos(primitive[2]), np.sin(primitive[2])
    top, bottom, left, right = float(height), 0.0, float(width), 0.0
    local = np.empty((8, 3))
    for corner in range(8):
        a = primitive[3] / 2 if corner & 1 else -primitive[3] / 2
        b = primitive[4] / 2 if corner & 2 else -primitive[4] / 2
        px, py, pz = (
            primitive[0] + c * a - s * b,
            primitive[1] + s * a + c * b,
            primitive[6] if corner & 4 else primitive[5],
        )
        for i in range(3):
            local[corner, i] = pose[v, i, 0] * px + pose[v, i, 1] * py + pose[v, i, 2] * pz + pose[v, i, 3]
    # Corners in front of the camera, and intersections of edges with the near plane.
    for first in range(8):
        for other in range(first, 8):
            apart = first ^ other
            if apart & (apart - 1):
                continue
            x, y, z = local[first]
            if first == other:
                if z < NEAR_M:
                    continue
            else:
                ahead = local[other, 2]
                if (z < NEAR_M) == (ahead < NEAR_M):
                    continue
                share = (NEAR_M - z) / (ahead - z)
                x, y, z = x + share * (local[other, 0] - x), y + share * (local[other, 1] - y), NEAR_M
            u, w = lens[v, 0] * x / z + lens[v, 2], lens[v, 1] * y / z + lens[v, 3]
            top, bottom, left, right = min(top, w), max(bottom, w), min(left, u), max(right, u)
    # A pixel more than the corners' bounds: clipping rounds differently from drawing.
    return (
        int(max(top - 1, 0.0)),
        int(min(bottom + 2, float(height))),
        int(max(left - 1, 0.0)),
        int(min(right + 2, float(width))),
    )


@njit(cache=True)
def trace_primitive(lens, pose, centre, v, y, x, primitive, c, s, ray, normal):
    """(depth or -1, face 1..6) at which a pixel's ray enters a primitive; ``c``, ``s``: cosine and sine of its yaw."""
    rx, ry = (x + 0.5 - lens[v, 2]) / lens[v, 0], (y + 0.5 - lens[v, 3]) / lens[v, 1]
    for i in range(3):
        ray[i] = pose[v, 0, i] * rx + pose[v, 1, i] * ry + pose[v, 2, i]
    d = ray_entry_length(primitive, c, s, centre[v], ray, normal)
    face = 0
    if normal[2] > 0.5:
        face = 1
    elif normal[2] < -0.5:
        face = 2
    else:
        u, w = c * normal[0] + s * normal[1], c * normal[1] - s * normal[0]
        face = (3 if u > 0 else 4) if abs(u) > abs(w) else (5 if w > 0 else 6)
    return d, face


@njit(cache=True)
def draw_primitive(lens, pose, centre, known, depth, surface, primitive, first):
    """Draw a primitive into depth and surface."""
    views, height, width = known.shape
    ray, normal = np.zeros(3), np.zeros(3)
    c, s = np.cos(primitive[2]), np.sin(primitive[2])
    for v in range(views):
        top, bottom, left, right = primitive_bounds(lens, pose, primitive, v, height, width)
        for y in range(top, bottom):
            for x in range(left, right):
                d, face = trace_primitive(lens, pose, centre, v, y, x, primitive, c, s, ray, normal)
                if d > NEAR_M and d < depth[v, y, x] * BEFORE:
                    depth[v, y, x], surface[v, y, x] = d, first + face
