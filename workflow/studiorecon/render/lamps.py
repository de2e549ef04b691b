# SPDX-License-Identifier: Apache-2.0
"""Where light may come from, and how much of it does: the strengths that best explain what the floor loses beside people."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from studiorecon.geometry.occlusion import hidden, nearness, sky_hidden
from studiorecon.scene.light import Lamps
from studiorecon.scene.shell import Shell

# Walls shine from this height on: below it hardly any lamp or window stands clear of people.
_WALL_FROM_M = 1.2
# The sky: rings of so many patches at these elevations, this far off.
_SKY_RINGS = ((20.0, 12), (40.0, 10), (60.0, 6), (80.0, 3))
_SKY_M, _SKY_RADIUS = 200.0, 0.15
# Lamps below this share of the light are noise; strengths and total settle within so many rounds.
_LEAST_SHARE, _ROUNDS, _HUBER = 0.01, 5, 2.0


def patches(shell: Shell, spacing_m: float) -> Lamps:
    """Patches of the ceiling and of the upper walls about ``spacing_m`` apart, and of the sky."""
    low, high = shell.low_m, shell.high_m

    def steps(start: float, end: float) -> np.ndarray:
        count = max(round((end - start) / spacing_m), 1)
        return start + (np.arange(count) + 0.5) * (end - start) / count

    u, v, z = steps(low[0], high[0]), steps(low[1], high[1]), steps(min(low[2] + _WALL_FROM_M, high[2] - 0.1), high[2])
    parts = [(np.stack([g.ravel() for g in np.meshgrid(u, v, [high[2]], indexing="ij")], axis=1), [0, 0, -1])]
    for axis, along in ((0, v), (1, u)):
        for place, sign in ((low[axis], 1), (high[axis], -1)):
            a, b = (g.ravel() for g in np.meshgrid(along, z, indexing="ij"))
            points = np.stack([np.full(len(a), place), a, b] if axis == 0 else [a, np.full(len(a), place), b], axis=1)
            parts.append((points, np.eye(3)[axis] * sign))
    inside = np.concatenate([points for points, _ in parts]) @ shell.axes
    facing = np.concatenate([np.tile(normal, (len(points), 1)) for points, normal in parts]) @ shell.axes
    sky = []
    for elevation, count in _SKY_RINGS:
        azimuth, rise = np.arange(count) * 2 * np.pi / count, np.radians(elevation)
        sky.append(np.stack([np.cos(azimuth) * np.cos(rise), np.sin(azimuth) * np.cos(rise), np.full(count, np.sin(rise))], axis=1))
    far = np.concatenate(sky) * _SKY_M
    radius = np.concatenate([np.full(len(inside), spacing_m / np.sqrt(np.pi)), np.full(len(far), _SKY_RADIUS * _SKY_M)])
    return Lamps(np.concatenate([inside, far]), np.concatenate([facing, np.zeros_like(far)]), radius)


def losses(points_m: np.ndarray, bodies: Sequence[np.ndarray], lamps: Lamps, contact_m: float) -> np.ndarray:
    """(N, 2 + K) float32: hidden share of the sky, nearness of a body, and the hidden share of every lamp."""
    beside = np.stack([sky_hidden(points_m, bodies), nearness(points_m, bodies, contact_m)], axis=1)
    return np.concatenate([beside, hidden(points_m, lamps.discs, bodies)], axis=1)


def strengths(lost: np.ndarray, relative: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """(2 + K,) non-negative strengths of sky, contact and lamps, from what changes at each of P pixels over T pictures.

    ``lost`` (P, T, 2 + K) from ``losses``, ``relative`` (P, K) fall-off of every lamp over its mean, ``ratio`` (P, T) of picture to plate,
    NaN where unknown. A plate may hold a shadow that lay there most of the time, so every pixel has a level of its own that is fitted
    with the strengths and only its changes count. The light in the open follows from the strengths too: they take turns. Large
    residuals count by their root (Huber), since reflections and things that are carried are no shadow.
    """
    columns = lost.astype(np.float64)
    columns[..., 2:] *= relative[:, None]
    known = np.isfinite(ratio)
    seen, weight = np.where(known, ratio, 0.0), known.astype(np.float64)
    found, total, own = np.zeros(columns.shape[-1]), np.ones(len(ratio)), np.ones(len(ratio))
    for _ in range(_ROUNDS):
        share = weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-9)
        darker = 1 - seen / own[:, None]
        scaled = columns / total[:, None, None]
        changes = scaled - np.einsum("pt,ptk->pk", share, scaled)[:, None]
        target = darker - (share * darker).sum(axis=1)[:, None]
        root = np.sqrt(weight)
        # Normal equations keep the search small whatever the number of pixels.
        rows = np.concatenate([changes * root[..., None], (target * root)[..., None]], axis=-1).reshape(-1, len(found) + 1)
        triangle = np.linalg.qr(rows, mode="r")
        found = scipy.optimize.nnls(triangle[:, :-1], triangle[:, -1], maxiter=50 * len(found))[0]
        found[2:][found[2:] < _LEAST_SHARE] = 0
        left = 1 - scaled @ found
        own = own_levels(seen, left, weight)
        residual = np.abs(seen - own[:, None] * left)
        usual = max(1.4826 * float(np.median(residual[known])), 1e-4)
        weight = known * np.minimum(1, _HUBER * usual / np.maximum(residual, 1e-9))
        total = np.maximum(1 + (relative - 1) @ found[2:], 0.25)
    return found


def own_levels(seen: np.ndarray, left: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(P,) what pixels (P, T) would be as a ratio to their plate in the open, from ``left`` (P, T) of their light; 1 where unknown."""
    light = (weight * left).sum(axis=1)
    return np.where(light > 1e-9, (weight * seen).sum(axis=1) / np.maximum(light, 1e-9), 1.0)
