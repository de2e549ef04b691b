# SPDX-License-Identifier: Apache-2.0
"""The inner loop of undistortion, one point at a time, compiled; read ``distortion.py`` for what it means.

A lens is (k (8,), fisheye): k1 k2 p1 p2 k3 k4 k5 k6 of the opencv model, or k1 k2 k3 k4 of the fisheye model in the first four places.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_RADIAL_STEPS = 100
_PLANE_STEPS = 12
# Newton squares its relative error: what is left after steps this small is 1e-13 or less on the radius and in the plane.
_SETTLED, _PLANE_SETTLED = 2e-7, 1e-6
# Starts are read from a table of the radial inverse up to this distorted radius (63° off axis without distortion).
_TABLE_SIZE, _TABLE_SPAN = 2048, 2.0


@njit(cache=True, nogil=True)
def undistort(points, k, fisheye, limit, tolerance, answers, valid):
    """Fill answers (N, 2), NaN where there is none, and valid (N,) for distorted ``points`` (N, 2); ``limit`` is the fold radius."""
    # A division is most of a step's time, and most lenses have no denominator.
    rational = k[5] != 0.0 or k[6] != 0.0 or k[7] != 0.0
    tangential = not fisheye and (k[2] != 0.0 or k[3] != 0.0)
    farthest = _radial(limit, k, fisheye)[0] if np.isfinite(limit) else np.inf
    # Always the same table, so that a point's answer does not depend on its batch.
    span = min(farthest, _TABLE_SPAN)
    table = np.ones(_TABLE_SIZE + 1)
    for i in range(1, _TABLE_SIZE + 1):
        target = span * i / _TABLE_SIZE
        table[i] = _invert(target, min(target, 0.5 * limit), k, fisheye, limit, farthest) / target
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        answers[n, 0] = answers[n, 1] = np.nan
        valid[n] = False
        target = np.sqrt(x * x + y * y)
        # Tangential terms shift the reachable region a little: leave that decision to the residual check.
        if not target <= farthest * 1.05 + 1e-12 or target == np.inf:
            continue
        start = target * _ratio(target, table, span) if target < span else min(target, 0.5 * limit)
        if not tangential or target >= span:
            radius = _invert(target, start, k, fisheye, limit, farthest)
        else:
            # What the tangential terms add, roughly, comes off before the radial inverse is read again.
            scale = start / target if target > 1e-12 else 1.0
            u, v = x * scale, y * scale
            s = u * u + v * v
            u, v = x - 2 * k[2] * u * v - k[3] * (s + 2 * u * u), y - k[2] * (s + 2 * v * v) - 2 * k[3] * u * v
            shifted = min(np.sqrt(u * u + v * v), span)
            scale = _ratio(shifted, table, span)
            u, v = u * scale, v * scale
        if fisheye:
            grown = _radial(radius, k, True)[0]
            off = abs(grown - target)
            scale = np.tan(radius) / target if target > 1e-12 else 1.0
            u, v = x * scale, y * scale
        else:
            if not tangential or target >= span:
                scale = radius / target if target > 1e-12 else 1.0
                u, v = x * scale, y * scale
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
                    off = _plane_error(u, v, x, y, k, rational)
                    break
            radius = np.sqrt(u * u + v * v)
        if off < tolerance * max(1.0, target) and radius <= limit * (1 + 1e-9):
            answers[n, 0], answers[n, 1] = u, v
            valid[n] = True


@njit(cache=True, nogil=True)
def _plane_error(u, v, x, y, k, rational):
    """Largest coordinate difference of the distorted (u, v) from (x, y), opencv model."""
    s = u * u + v * v
    gain = 1 + s * (k[0] + s * (k[1] + s * k[4]))
    if rational:
        gain /= 1 + s * (k[5] + s * (k[6] + s * k[7]))
    dx = u * gain + 2 * k[2] * u * v + k[3] * (s + 2 * u * u) - x
    dy = v * gain + k[2] * (s + 2 * v * v) + 2 * k[3] * u * v - y
    return max(abs(dx), abs(dy))


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
def _ratio(target, table, span):
    """Undistorted over distorted radius, interpolated."""
    position = target * (_TABLE_SIZE / span)
    i = min(int(position), _TABLE_SIZE - 1)
    return table[i] + (position - i) * (table[i + 1] - table[i])


@njit(cache=True, nogil=True)
def _invert(target, radius, k, fisheye, limit, farthest):
    """Radius up to ``limit`` whose distortion is ``target``: Newton from ``radius`` inside a bracket, else bisection (C09)."""
    if target >= farthest:
        return limit
    low, high = 0.0, limit
    for _ in range(_RADIAL_STEPS):
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
