# SPDX-License-Identifier: Apache-2.0
"""The inner loop of undistortion, one point at a time, compiled; ``distortion.py`` explains it.

A lens is (k (8,), fisheye): k1 k2 p1 p2 k3 k4 k5 k6 of the opencv model, or k1 k2 k3 k4 of the fisheye model in the
first four places.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_PLANE_STEPS = 12
# Newton squares its relative error: after steps this small it is 1e-13 or less on the radius and in the plane.
_SETTLED, _PLANE_SETTLED = 2e-7, 1e-6
# Lenses with tangential terms: points solved together, and the residual above which one is solved separately.
_BLOCK, _BLOCK_SETTLED = 512, 1e-13
# Starts are read from a table of the radial inverse, even in the squared radius, up to this one (63° off axis without
# distortion).
_TABLE_SIZE, _TABLE_SPAN = 2048, 2.0


@njit(cache=True, nogil=True)
def undistort(points, k, fisheye, limit, tolerance, answers, valid):
    """Fill ``answers``, NaN for undefined, and ``valid`` for distorted ``points``; ``limit`` is the fold radius."""
    # A division is most of a step's time, and most lenses have no denominator.
    rational = k[5] != 0.0 or k[6] != 0.0 or k[7] != 0.0
    tangential = not fisheye and (k[2] != 0.0 or k[3] != 0.0)
    farthest = _radial(limit, k, fisheye)[0] if np.isfinite(limit) else np.inf
    # Always the same table, so that a point's result does not depend on its batch.
    span = min(farthest, _TABLE_SPAN)
    table = np.ones(_TABLE_SIZE + 1)
    for i in range(1, _TABLE_SIZE + 1):
        target = span * np.sqrt(i / _TABLE_SIZE)
        table[i] = _invert(target, min(target, 0.5 * limit), k, fisheye, limit, farthest) / target
    block = np.empty((3, _BLOCK))
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        if tangential:
            if n % _BLOCK == 0:
                _plane_block(points[n : n + _BLOCK], k, rational, table, span, block)
            u, v, off = block[0, n % _BLOCK], block[1, n % _BLOCK], block[2, n % _BLOCK]
            if off <= _BLOCK_SETTLED and u * u + v * v <= limit * limit:
                answers[n, 0], answers[n, 1] = u, v
                valid[n] = True
                continue
        answers[n, 0] = answers[n, 1] = np.nan
        valid[n] = False
        target = np.sqrt(x * x + y * y)
        # Tangential terms shift the reachable region a little: the residual check decides.
        if not target <= farthest * 1.05 + 1e-12 or target == np.inf:
            continue
        start = target * _ratio(target * target, table, span * span) if target < span else min(target, 0.5 * limit)
        radius = _invert(target, start, k, fisheye, limit, farthest)
        scale = (np.tan(radius) if fisheye else radius) / target if target > 1e-12 else 1.0
        u, v = x * scale, y * scale
        if fisheye:
            off = abs(_radial(radius, k, True)[0] - target)
        else:
            off = 0.0
            for step in range(_PLANE_STEPS):
                s = u * u + v * v
                under = 1 / (1 + s * (k[5] + s * (k[6] + s * k[7]))) if rational else 1.0
                gain = (1 + s * (k[0] + s * (k[1] + s * k[4]))) * under
                dx = u * gain + 2 * k[2] * u * v + k[3] * (s + 2 * u * u) - x
                dy = v * gain + k[2] * (s + 2 * v * v) + 2 * k[3] * u * v - y
                off = max(abs(dx), abs(dy))
                if not tangential or step == _PLANE_STEPS - 1 or off <= 1e-15 * target:
                    break
                slope = (k[0] + s * (2 * k[1] + 3 * s * k[4]) - gain * (k[5] + s * (2 * k[6] + 3 * s * k[7]))) * under
                mixed = 2 * (u * v * slope + k[2] * u + k[3] * v)
                across = gain + 2 * u * u * slope + 2 * k[2] * v + 6 * k[3] * u
                down = gain + 2 * v * v * slope + 6 * k[2] * v + 2 * k[3] * u
                determinant = across * down - mixed * mixed
                if abs(determinant) < 1e-12:
                    break
                turn = 1 / determinant
                move_u, move_v = (down * dx - mixed * dy) * turn, (across * dy - mixed * dx) * turn
                u -= move_u
                v -= move_v
                if abs(move_u) + abs(move_v) <= _PLANE_SETTLED * (abs(u) + abs(v)):
                    dx, dy = _plane_miss(u, v, x, y, k, rational)
                    off = max(abs(dx), abs(dy))
                    break
            radius = np.sqrt(u * u + v * v)
        if off < tolerance * max(1.0, target) and radius <= limit * (1 + 1e-9):
            answers[n, 0], answers[n, 1] = u, v
            valid[n] = True


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _plane_block(points, k, rational, table, span, block):
    """Write undistorted points and their error into the rows u, v, off of ``block``; inf outside the table.

    A large error needs more steps. Two Newton steps from two readings of the table, no branches: the processor works on
    several points at once, which a loop until convergence prevents.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7]
    reach = span * span
    per = _TABLE_SIZE / reach
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        square = x * x + y * y
        position = square * per if square < reach else 0.0
        j = int(position)
        ratio = table[j] + (position - j) * (table[j + 1] - table[j])
        u, v = x * ratio, y * ratio
        s = u * u + v * v
        # Subtract the approximate tangential terms before the radial inverse is read again.
        u, v = x - 2 * p1 * u * v - p2 * (s + 2 * u * u), y - p1 * (s + 2 * v * v) - 2 * p2 * u * v
        position = (u * u + v * v) * per
        position = position if position < _TABLE_SIZE else 0.0
        j = int(position)
        ratio = table[j] + (position - j) * (table[j + 1] - table[j])
        u *= ratio
        v *= ratio
        s = u * u + v * v
        under = 1 / (1 + s * (k4 + s * (k5 + s * k6))) if rational else 1.0
        gain = (1 + s * (k1 + s * (k2 + s * k3))) * under
        dx = u * gain + 2 * p1 * u * v + p2 * (s + 2 * u * u) - x
        dy = v * gain + p1 * (s + 2 * v * v) + 2 * p2 * u * v - y
        slope = k1 + s * (2 * k2 + 3 * s * k3)
        if rational:
            slope = (slope - gain * (k4 + s * (2 * k5 + 3 * s * k6))) * under
        mixed = 2 * (u * v * slope + p1 * u + p2 * v)
        across = gain + 2 * u * u * slope + 2 * p1 * v + 6 * p2 * u
        down = gain + 2 * v * v * slope + 6 * p1 * v + 2 * p2 * u
        turn = 1 / (across * down - mixed * mixed)
        u -= (down * dx - mixed * dy) * turn
        v -= (across * dy - mixed * dx) * turn
        # The second step reuses the first one's slopes: they changed as little as the point moved.
        dx, dy = _plane_miss(u, v, x, y, k, rational)
        u -= (down * dx - mixed * dy) * turn
        v -= (across * dy - mixed * dx) * turn
        dx, dy = _plane_miss(u, v, x, y, k, rational)
        block[0, i], block[1, i] = u, v
        block[2, i] = max(abs(dx), abs(dy)) if square < reach else np.inf


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def _plane_miss(u, v, x, y, k, rational):
    """Difference between the distorted (u, v) and (x, y), opencv model."""
    s = u * u + v * v
    gain = 1 + s * (k[0] + s * (k[1] + s * k[4]))
    if rational:
        gain /= 1 + s * (k[5] + s * (k[6] + s * k[7]))
    return u * gain + 2 * k[2] * u * v + k[3] * (s + 2 * u * u) - x, v * gain + k[2] * (s + 2 * v * v) + 2 * k[
        3
    ] * u * v - y


@njit(cache=True, nogil=True)
def _radial(radius, k, fisheye):
    """Distorted radius of an undistorted one (fisheye: of the angle), and its derivative."""
    s = radius * radius
    if fisheye:
        gain = 1 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3])))
        return radius * gain, 1 + s * (3 * k[0] + s * (5 * k[1] + s * (7 * k[2] + 9 * s * k[3])))
    bottom = 1 + s * (k[5] + s * (k[6] + s * k[7]))
    gain = (1 + s * (k[0] + s * (k[1] + s * k[4]))) / bottom
    slope = (k[0] + s * (2 * k[1] + 3 * s * k[4]) - gain * (k[5] + s * (2 * k[6] + 3 * s * k[7]))) / bottom
    return radius * gain, gain + 2 * s * slope


@njit(cache=True, nogil=True)
def _ratio(square, table, reach):
    """Undistorted over distorted radius at a squared distorted one up to ``reach``, interpolated in the square."""
    position = square * (_TABLE_SIZE / reach)
    i = min(int(position), _TABLE_SIZE - 1)
    return table[i] + (position - i) * (table[i + 1] - table[i])


@njit(cache=True, nogil=True)
def _invert(target, radius, k, fisheye, limit, farthest):
    """Radius up to ``limit`` whose distortion is ``target``: Newton inside a bracket, else bisection (C09)."""
    if target >= farthest:
        return limit
    low, high = 0.0, limit
    for _ in range(100):
        grown, slope = _radial(radius, k, fisheye)
        if grown < target:
            low = radius
        else:
            high = radius
        moved = radius - (grown - target) / slope if slope > 0 else np.nan
        if not (low <= moved <= high):
            moved = 0.5 * (low + high) if high < np.inf else 2 * radius + 1e-3
        if abs(moved - radius) <= _SETTLED * radius:
            return moved
        radius = moved
    return radius
