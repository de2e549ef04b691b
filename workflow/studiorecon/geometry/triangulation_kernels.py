# SPDX-License-Identifier: Apache-2.0
"""The inner loops of triangulation, one point at a time, compiled; ``triangulation.py`` explains them.

A rig is the tuple (rotations (V, 3, 3), translations (V, 3), centres (V, 3), focal (V, 2), principal (V, 2), units
(V,)), all float64.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from studiorecon.geometry.triangulation_dlt import dlt

# The cost that _normal minimises: the Huber norm, or unweighted squared pixels (for covariances).
_HUBER, _PIXELS = 1, 2


@njit(cache=True, nogil=True)
def robust(rig, seen, weights, gates, filled):
    """Write ``filled``, the tuple (points (N, 3), covariance (N, 3, 3), error_px (V, N), inliers (V, N), state (N,)).

    State 0 is undetermined, 1 a point, 2 a verified one; undetermined points leave the arrays unchanged. All-pairs
    midpoints, truncated cost, damped Gauss-Newton under the Huber norm on the agreeing views only. ``seen`` (V, N, 2)
    has no NaN; ``weights`` (V, N) are 0 where a view has no pixel. ``gates``: outliers in error units, near plane in
    metres, sine of the smallest angle, noise in pixels.
    """
    gate, near, min_sine, _ = gates
    views, count = weights.shape
    rays, used, agreed, room = np.empty((views, 3)), np.empty(views, np.int64), np.zeros(views, np.bool_), np.empty(9)
    point, best = np.empty(3), np.empty(3)
    for n in range(count):
        usable = _rays(rig, seen, weights, n, rays, used)
        lowest = np.inf
        for i in range(usable):
            for j in range(i + 1, usable):
                if not _midpoint(rig, rays, used[i], used[j], near, min_sine, point):
                    continue
                cost = 0.0
                for k in range(usable):
                    v = used[k]
                    square = _error_units(rig, seen, v, n, point, near) ** 2 / gate**2
                    if square >= 1.0 and k in (i, j):
                        cost = np.inf
                    cost += weights[v, n] * min(square, 1.0)
                    if cost >= lowest:
                        break
                if cost < lowest:
                    lowest = cost
                    best[:] = point
        if lowest == np.inf:
            continue
        agreed[:] = False
        for _ in range(3):
            changed = False
            for k in range(usable):
                v = used[k]
                agrees = _error_units(rig, seen, v, n, best, near) < gate
                changed |= agrees != agreed[v]
                agreed[v] = agrees
            if not changed:
                break
            _refine(rig, seen, weights, n, used[:usable], agreed, _HUBER, 10, near, best, room)
        support = 0
        for k in range(usable):
            v = used[k]
            agreed[v] = _error_units(rig, seen, v, n, best, near) < gate
            support += agreed[v]
        # Two views of four are reported, unverified; two of ten agree by chance, and so do three (T09).
        if (2 * support >= usable) if support < 3 else (3 * support >= usable):
            _report(rig, seen, weights, n, used[:usable], agreed, gates, best, filled)


@njit(cache=True, nogil=True)
def linear(rig, seen, weights, gates, huber, filled):
    """The same outputs by plain DLT over all usable views, or, with ``huber``, refined with outliers."""
    near = gates[1]
    views, count = weights.shape
    used, everyone, room = np.empty(views, np.int64), np.ones(views, np.bool_), np.empty(9)
    rows, turned, point = np.empty((2 * views, 4)), np.empty((4, 4)), np.empty(3)
    for n in range(count):
        usable = 0
        for v in range(views):
            if weights[v, n] > 0:
                used[usable] = v
                usable += 1
        if usable < 2 or not dlt(rig, seen, weights, n, used[:usable], rows, turned, point):
            continue
        if huber:
            _refine(rig, seen, weights, n, used[:usable], everyone, _HUBER, 60, near, point, room)
        _report(rig, seen, weights, n, used[:usable], everyone, gates, point, filled)


@njit(cache=True, nogil=True)
def _rays(rig, seen, weights, n, rays, used):
    """Unit directions in the world of all usable pixels of point n; the number of usable views."""
    rotations, _, _, focal, principal, _ = rig
    usable = 0
    for v in range(len(weights)):
        if weights[v, n] > 0:
            x = (seen[v, n, 0] - principal[v, 0]) / focal[v, 0]
            y = (seen[v, n, 1] - principal[v, 1]) / focal[v, 1]
            shrink = 1.0 / np.sqrt(x * x + y * y + 1.0)
            for a in range(3):
                rays[v, a] = (rotations[v, 0, a] * x + rotations[v, 1, a] * y + rotations[v, 2, a]) * shrink
            used[usable] = v
            usable += 1
    return usable


@njit(cache=True, nogil=True)
def _midpoint(rig, rays, a, b, near, min_sine, point):
    """Middle of the common perpendicular of two rays; False where it is not in front of both or they are parallel."""
    centres = rig[2]
    cosine, along_a, along_b, cross = 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        baseline = centres[b, i] - centres[a, i]
        cosine += rays[a, i] * rays[b, i]
        along_a += rays[a, i] * baseline
        along_b += rays[b, i] * baseline
        j, k = (i + 1) % 3, (i + 2) % 3
        # The sine from the cross product: 1 - cosine² has no digits left for rays 0.05° apart (T14).
        cross += (rays[a, j] * rays[b, k] - rays[a, k] * rays[b, j]) ** 2
    if not cross > min_sine**2:
        return False
    range_a = (along_a - cosine * along_b) / cross
    range_b = (cosine * along_a - along_b) / cross
    if not (range_a > near and range_b > near):
        return False
    for i in range(3):
        point[i] = (centres[a, i] + range_a * rays[a, i] + centres[b, i] + range_b * rays[b, i]) / 2
    return True


@njit(cache=True, nogil=True)
def _error_units(rig, seen, v, n, point, near):
    """Reprojection error of a point in one view in error units; inf behind the near plane (C05)."""
    rotations, translations, _, focal, principal, units = rig
    r = rotations[v]
    z = r[2, 0] * point[0] + r[2, 1] * point[1] + r[2, 2] * point[2] + translations[v, 2]
    if not z > near:
        return np.inf
    x = r[0, 0] * point[0] + r[0, 1] * point[1] + r[0, 2] * point[2] + translations[v, 0]
    y = r[1, 0] * point[0] + r[1, 1] * point[1] + r[1, 2] * point[2] + translations[v, 1]
    dx = focal[v, 0] * x / z + principal[v, 0] - seen[v, n, 0]
    dy = focal[v, 1] * y / z + principal[v, 1] - seen[v, n, 1]
    return np.sqrt(dx * dx + dy * dy) / units[v]


@njit(cache=True, nogil=True)
def _normal(rig, seen, weights, n, used, chosen, mode, near, point, room):
    """Cost over the chosen views in error units, inf behind a camera; JᵀWJ (upper) and JᵀWr into ``room``.

    With ``_HUBER`` the norm of the two-dimensional residual has delta 1 unit: r² inside, 2r - 1 outside (T11).
    """
    rotations, translations, _, focal, principal, units = rig
    cost = 0.0
    room[:] = 0.0
    for v in used:
        if not chosen[v]:
            continue
        r = rotations[v]
        z = r[2, 0] * point[0] + r[2, 1] * point[1] + r[2, 2] * point[2] + translations[v, 2]
        if not z > near:
            return np.inf
        x = r[0, 0] * point[0] + r[0, 1] * point[1] + r[0, 2] * point[2] + translations[v, 0]
        y = r[1, 0] * point[0] + r[1, 1] * point[1] + r[1, 2] * point[2] + translations[v, 1]
        fx, fy = focal[v, 0] / (z * units[v]), focal[v, 1] / (z * units[v])
        dx = fx * x + (principal[v, 0] - seen[v, n, 0]) / units[v]
        dy = fy * y + (principal[v, 1] - seen[v, n, 1]) / units[v]
        square = dx * dx + dy * dy
        weight = weights[v, n] if mode != _PIXELS else units[v] ** 2
        if mode == _HUBER and square > 1.0:
            length = np.sqrt(square)
            cost += weight * (2 * length - 1)
            weight /= length
        else:
            cost += weight * square
        xz, yz = x / z, y / z
        ax, ay, az = fx * (r[0, 0] - xz * r[2, 0]), fx * (r[0, 1] - xz * r[2, 1]), fx * (r[0, 2] - xz * r[2, 2])
        bx, by, bz = fy * (r[1, 0] - yz * r[2, 0]), fy * (r[1, 1] - yz * r[2, 1]), fy * (r[1, 2] - yz * r[2, 2])
        room[0] += weight * (ax * ax + bx * bx)
        room[1] += weight * (ax * ay + bx * by)
        room[2] += weight * (ax * az + bx * bz)
        room[3] += weight * (ay * ay + by * by)
        room[4] += weight * (ay * az + by * bz)
        room[5] += weight * (az * az + bz * bz)
        room[6] += weight * (ax * dx + bx * dy)
        room[7] += weight * (ay * dx + by * dy)
        room[8] += weight * (az * dx + bz * dy)
    return cost


@njit(cache=True, nogil=True)
def _solve(room, lift, b0, b1, b2):
    """(ok, x0, x1, x2) of a symmetric 3×3 system by LDLᵀ; not ok where a pivot is not positive."""
    d0 = room[0] + lift
    if not d0 > 0:
        return False, 0.0, 0.0, 0.0
    l10, l20 = room[1] / d0, room[2] / d0
    d1 = room[3] + lift - l10 * room[1]
    if not d1 > 0:
        return False, 0.0, 0.0, 0.0
    l21 = (room[4] - l20 * room[1]) / d1
    d2 = room[5] + lift - l20 * room[2] - l21 * l21 * d1
    if not d2 > 0:
        return False, 0.0, 0.0, 0.0
    y1 = b1 - l10 * b0
    x2 = (b2 - l20 * b0 - l21 * y1) / d2
    x1 = y1 / d1 - l21 * x2
    return True, b0 / d0 - l10 * x1 - l20 * x2, x1, x2


@njit(cache=True, nogil=True)
def _refine(rig, seen, weights, n, used, chosen, mode, steps, near, point, room):
    """Refine the point by damped Gauss-Newton; steps that raise the cost or cross a near plane are refused (T12)."""
    cost = _normal(rig, seen, weights, n, used, chosen, mode, near, point, room)
    if cost == np.inf:
        return
    moved, ahead, damping = np.empty(3), np.empty(9), 1e-6
    for _ in range(steps):
        lift = damping * max((room[0] + room[3] + room[5]) / 3, 1e-12)
        ok, s0, s1, s2 = _solve(room, lift, room[6], room[7], room[8])
        new = np.inf
        if ok:
            moved[0], moved[1], moved[2] = point[0] - s0, point[1] - s1, point[2] - s2
            new = _normal(rig, seen, weights, n, used, chosen, mode, near, moved, ahead)
        if new <= cost:
            point[:], room[:] = moved, ahead
            gained, cost = cost - new, new
            damping /= 10
            if gained < 1e-12 * max(cost, 1e-12):
                return
        else:
            damping *= 10


@njit(cache=True, nogil=True)
def _report(rig, seen, weights, n, used, chosen, gates, point, filled):
    """Write point n if two chosen views see it in front, with rays neither parallel nor opposite (T01, T02, T06)."""
    centres, units = rig[2], rig[5]
    gate, near, min_sine, noise_px = gates
    points, covariance, error_px, inliers, state = filled
    support, agreeing, squares, sine = 0, 0, 0.0, 0.0
    for v in used:
        if not chosen[v]:
            continue
        error = _error_units(rig, seen, v, n, point, near)
        if error == np.inf:
            return
        support += 1
        agreeing += error < gate
        squares += (error * units[v]) ** 2
        for w in used:
            if w < v and chosen[w]:
                sine = max(sine, _sine_squared(point, centres[v], centres[w]))
    if support < 2 or not sine > min_sine**2:
        return
    room = np.empty(9)
    _normal(rig, seen, weights, n, used, chosen, _PIXELS, near, point, room)
    variance = max(noise_px**2, squares / max(2 * support - 3, 1))
    matrix = covariance[n]
    for column in range(3):
        ok, x0, x1, x2 = _solve(room, 0.0, 1.0 * (column == 0), 1.0 * (column == 1), 1.0 * (column == 2))
        if not (ok and np.isfinite(x0 + x1 + x2)):
            covariance[n] = np.inf
            return
        matrix[0, column], matrix[1, column], matrix[2, column] = variance * x0, variance * x1, variance * x2
    points[n] = point
    for v in used:
        inliers[v, n] = chosen[v]
        error_px[v, n] = _error_units(rig, seen, v, n, point, near) * units[v]
    state[n] = 2 if agreeing >= 3 else 1


@njit(cache=True, nogil=True)
def _sine_squared(point, first, second):
    """Squared sine of the angle at ``point`` between the directions from two camera centres."""
    square_a, square_b, cross = 0.0, 0.0, 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        a, b = point[i] - first[i], point[i] - second[i]
        square_a += a * a
        square_b += b * b
        cross += ((point[j] - first[j]) * (point[k] - second[k]) - (point[k] - first[k]) * (point[j] - second[j])) ** 2
    return cross / max(square_a * square_b, 1e-300)
