# SPDX-License-Identifier: Apache-2.0
"""How much of a lamp bodies of capsules hide from points, and how near they come: soft, in closed form, without sampling a lamp."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numba
import numpy as np

from studiorecon.arrays import require

# Directions that stand for light from everywhere above, spread by the cosine; each is seen this wide.
_SKY, _SKY_TAN = 24, 0.32
_FAR_M = 50.0


def hidden(points_m: np.ndarray, lamps: np.ndarray, bodies: Sequence[np.ndarray]) -> np.ndarray:
    """(N, K) float32 share of every lamp that the bodies hide from points (N, 3).

    ``lamps`` (K, 4): position and radius in metres, seen as a disc; ``bodies``: capsules (C, 7) each, two ends and a radius.
    Capsules hide parts of a lamp independently of each other: against sampled rays that errs by a third less than letting the one count
    that hides most. Raises ValueError for other shapes.
    """
    require("points_m", points_m, ("N", 3))
    require("lamps", lamps, ("K", 4))
    seen = np.ones((len(points_m), len(lamps)), np.float32)
    points, discs = (np.ascontiguousarray(a, np.float64) for a in (points_m, lamps))
    for body in bodies:
        require("body", body, ("C", 7))
        if len(body):
            _hide(points, discs, np.ascontiguousarray(body, np.float64), seen)
    return 1 - seen


def sky_hidden(points_m: np.ndarray, bodies: Sequence[np.ndarray]) -> np.ndarray:
    """(N,) float32 share of the light from everywhere above that the bodies hide from points (N, 3) that face up."""
    # Points on the dome, uniform on the disc below it: that is the cosine of light on what faces up.
    k = np.arange(_SKY) + 0.5
    radius, angle = np.sqrt(k / _SKY), k * np.pi * (3 - np.sqrt(5))
    directions = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], axis=1)
    hidden_share = np.zeros(len(points_m), np.float32)
    # So far away that every point of a room sees it in the same direction.
    discs = np.concatenate([directions * _FAR_M**2, np.full((_SKY, 1), _SKY_TAN * _FAR_M**2)], axis=1)
    hidden_share[:] = hidden(points_m, discs, bodies).mean(axis=1)
    return hidden_share


def nearness(points_m: np.ndarray, bodies: Sequence[np.ndarray], reach_m: float) -> np.ndarray:
    """(N,) float32: 1 where a body touches a point (N, 3), exp(-1) at ``reach_m`` from its surface, and so on as a bell curve."""
    gap = np.full(len(points_m), np.inf)
    for body in bodies:
        if len(body):
            gap = np.minimum(gap, _gaps(np.ascontiguousarray(points_m, np.float64), np.ascontiguousarray(body, np.float64)))
    return np.exp(-((np.maximum(gap, 0) / reach_m) ** 2)).astype(np.float32)


@numba.njit(cache=True, nogil=True, parallel=True)
def _hide(points, discs, body, seen):
    # A ball around the body lets most rays pass at once.
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for c in range(len(body)):
        for axis in range(3):
            low[axis] = min(low[axis], min(body[c, axis], body[c, 3 + axis]) - body[c, 6])
            high[axis] = max(high[axis], max(body[c, axis], body[c, 3 + axis]) + body[c, 6])
    mx, my, mz = (low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2
    ball = math.sqrt((high[0] - mx) ** 2 + (high[1] - my) ** 2 + (high[2] - mz) ** 2)
    for n in numba.prange(len(points)):
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        for k in range(len(discs)):
            lx, ly, lz = discs[k, 0] - px, discs[k, 1] - py, discs[k, 2] - pz
            away = math.sqrt(lx * lx + ly * ly + lz * lz)
            if away < 1e-6:
                continue
            lx, ly, lz = lx / away, ly / away, lz / away
            spread = discs[k, 3] / away
            cx, cy, cz = mx - px, my - py, mz - pz
            along = cx * lx + cy * ly + cz * lz
            squared = cx * cx + cy * cy + cz * cz
            reach = ball + spread * (max(along, 0.0) + ball)
            if along < -ball or squared - along * along > reach * reach:
                continue
            left = 1.0
            for c in range(len(body)):
                left *= 1.0 - _covered(px, py, pz, lx, ly, lz, away, spread, body[c])
            seen[n, k] *= left


@numba.njit(cache=True, nogil=True, inline="always")
def _covered(px, py, pz, lx, ly, lz, away, spread, capsule):
    """Share of a disc that one capsule covers, by how far the ray to the disc's middle passes from its axis."""
    ux, uy, uz = capsule[3] - capsule[0], capsule[4] - capsule[1], capsule[5] - capsule[2]
    wx, wy, wz = px - capsule[0], py - capsule[1], pz - capsule[2]
    uu, ul = ux * ux + uy * uy + uz * uz, ux * lx + uy * ly + uz * lz
    uw, lw = ux * wx + uy * wy + uz * wz, lx * wx + ly * wy + lz * wz
    across = uu - ul * ul
    share = (uw - ul * lw) / across if across > 1e-9 * max(uu, 1e-9) else 0.5
    share = min(max(share, 0.0), 1.0)
    along = min(max(share * ul - lw, 0.0), away)
    # The ray is cut to what lies between point and lamp, which moves the nearest place of the axis.
    share = min(max((uw + along * ul) / uu, 0.0), 1.0) if uu > 1e-12 else 0.0
    dx, dy, dz = wx + along * lx - share * ux, wy + along * ly - share * uy, wz + along * lz - share * uz
    distance, radius = math.sqrt(dx * dx + dy * dy + dz * dz), capsule[6]
    wide = max(spread * along, 1e-4)
    edge = 0.5 + 0.5 * (radius - distance) / wide
    if edge <= 0.0:
        return 0.0
    edge = min(edge, 1.0)
    # What is narrower than the disc seen past it covers a strip of it.
    return edge * edge * (3.0 - 2.0 * edge) * min(1.0, 4.0 / math.pi * radius / wide)


@numba.njit(cache=True, nogil=True)
def _gaps(points, body):
    gap = np.full(len(points), np.inf)
    for n in range(len(points)):
        for c in range(len(body)):
            a, b = body[c, :3], body[c, 3:6]
            uu, uw = 0.0, 0.0
            for axis in range(3):
                uu += (b[axis] - a[axis]) ** 2
                uw += (b[axis] - a[axis]) * (points[n, axis] - a[axis])
            share = min(max(uw / uu, 0.0), 1.0) if uu > 1e-12 else 0.0
            squared = 0.0
            for axis in range(3):
                squared += (points[n, axis] - a[axis] - share * (b[axis] - a[axis])) ** 2
            gap[n] = min(gap[n], math.sqrt(squared) - body[c, 6])
    return gap
