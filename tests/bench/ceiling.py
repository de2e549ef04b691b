# SPDX-License-Identifier: Apache-2.0
"""How fast a blending step can be at all: one pair step of sixteen lanes held in registers, and how many such steps an
image takes."""

from __future__ import annotations

import numpy as np
from numba import float32, int64, njit
from studiorecon.splatting.conventions import (
    ALL_LANES,
    ALPHA_LOG2_MIN,
    ALPHA_MAX,
    BLOCK_PX,
    KERNEL,
    LANES,
    TILE_PX,
    TRANSMITTANCE_MIN,
)
from studiorecon.splatting.cpu.simd import above, at_least, both, broadcast, exp2, least, madd, nmadd, select, where
from studiorecon.splatting.cpu.simd_rows import load, store

FIELDS = 10
"""Numbers of ``steps_in_registers``: dx, dy, their steps, a, k, c, log2 opacity, colour, depth."""


@njit(**{**KERNEL, "cache": False})
def steps_in_registers(count, values, lanes, sums):
    """``count`` times what ``forward`` does to one block for one splat, without its loads, stores, boxes and lists.

    ``values`` (10,) and ``lanes`` (32,) float32 come from memory, so nothing is known when it is compiled; ``sums``
    (80,) receives the accumulators, so nothing is left out.
    """
    dx, dy = load(lanes, 0) + values[0], load(lanes, LANES) + values[1]
    step_x, step_y = broadcast(values[2]), broadcast(values[3])
    a, k, c, opacity = broadcast(values[4]), broadcast(values[5]), broadcast(values[6]), broadcast(values[7])
    colour, depth = broadcast(values[8]), broadcast(values[9])
    red, green, blue, far = load(sums, 0), load(sums, LANES), load(sums, 2 * LANES), load(sums, 3 * LANES)
    transmittance = load(sums, 4 * LANES)
    faintest, strongest, opaque = broadcast(ALPHA_LOG2_MIN), broadcast(ALPHA_MAX), broadcast(TRANSMITTANCE_MIN)
    for _ in range(count):
        u = nmadd(k, dy, dx)
        power = nmadd(a * u, u, nmadd(c * dy, dy, opacity))
        alpha = least(exp2(power), strongest)
        remaining = nmadd(alpha, transmittance, transmittance)
        blended = both(at_least(power, faintest), above(remaining, opaque))
        weight = where(blended, alpha * transmittance)
        transmittance = select(blended, remaining, transmittance)
        red, green, blue, far = (
            madd(weight, colour, red),
            madd(weight, a, green),
            madd(weight, c, blue),
            madd(weight, depth, far),
        )
        dx, dy = dx + step_x, dy + step_y
    store(sums, 0, red)
    store(sums, LANES, green)
    store(sums, 2 * LANES, blue)
    store(sums, 3 * LANES, far)
    store(sums, 4 * LANES, transmittance)


def registers(count: int) -> np.ndarray:
    """One run of ``count`` steps; returns the sums."""
    values = np.array([-2, -1, 1e-6, 2e-6, 0.02, 0.1, 0.03, -7.5, 0.4, 3.0], np.float32)
    lanes = np.array([i % BLOCK_PX for i in range(LANES)] + [i // BLOCK_PX for i in range(LANES)], np.float32)
    sums = np.zeros(5 * LANES, np.float32)
    sums[4 * LANES :] = 1
    steps_in_registers(count, values, lanes, sums)
    return sums


@njit(**{**KERNEL, "cache": False})
def lanes_evaluated(columns, rows, width, height, splats, starts, pairs):
    """(lanes that ``forward.blend`` evaluates, lanes of them that contribute), by replaying its boxes and early ends
    lane by lane."""
    evaluated, contributing = int64(0), int64(0)
    rest = np.empty(LANES, np.float32)
    for tile in range(columns * rows):
        tile_x, tile_y = tile % columns * TILE_PX, tile // columns * TILE_PX
        for block_y in range(0, TILE_PX, BLOCK_PX):
            for block_x in range(0, TILE_PX, BLOCK_PX):
                done = int64(0)
                for lane in range(LANES):
                    rest[lane] = 1
                    if tile_x + block_x + lane % BLOCK_PX >= width or tile_y + block_y + lane // BLOCK_PX >= height:
                        done |= int64(1) << lane
                for i in range(starts[tile], starts[tile + 1]):
                    if done == ALL_LANES:
                        break
                    s = splats[pairs[i]]
                    x, y = s[0] - float32(tile_x) - float32(0.5), s[1] - float32(tile_y) - float32(0.5)
                    first_x, last_x = (
                        np.ceil(max(x - s[10], float32(0))),
                        np.floor(min(x + s[10], float32(TILE_PX - 1))),
                    )
                    first_y, last_y = (
                        np.ceil(max(y - s[11], float32(0))),
                        np.floor(min(y + s[11], float32(TILE_PX - 1))),
                    )
                    if first_x > last_x or first_y > last_y or x + s[10] < 0 or y + s[11] < 0:
                        continue
                    # Whole blocks: from that of the first column to that of the last.
                    if not (
                        first_x // BLOCK_PX * BLOCK_PX <= block_x <= last_x
                        and first_y // BLOCK_PX * BLOCK_PX <= block_y <= last_y
                    ):
                        continue
                    evaluated += LANES
                    for lane in range(LANES):
                        if done >> lane & 1:
                            continue
                        dy = float32(block_y + lane // BLOCK_PX) - y
                        u = float32(block_x + lane % BLOCK_PX) - x - s[3] * dy
                        power = s[5] - s[2] * u * u - s[4] * dy * dy
                        if power < ALPHA_LOG2_MIN:
                            continue
                        after = rest[lane] * (1 - min(ALPHA_MAX, float32(2.0**power)))
                        if after <= TRANSMITTANCE_MIN:
                            done |= int64(1) << lane
                        else:
                            contributing += 1
                            rest[lane] = after
    return evaluated, contributing
