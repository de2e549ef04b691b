# SPDX-License-Identifier: Apache-2.0
"""Gradients of the blended image by every splat, in a second front-to-back pass, as ten moments per splat.

Each pixel carries the transmittance T and R = (rendered · g) minus the prefix. With w·g the splat's colour and depth
times the incoming gradient, dL/dalpha = T·(colour·g) − R/(1 − alpha). Colours, depth, alpha and background collapse
into that one scalar, and T is never recovered by a division. The evaluation repeats the forward pass operation by
operation, so pixels finish at the same splat.

Moments (q = alpha·dL/dalpha, u = dx − k·dy): Σq, Σq·u, Σq·dy, Σq·u², Σq·u·dy, Σq·dy², and Σw·g for red, green, blue,
depth.
"""

from __future__ import annotations

import numpy as np
from numba import float32, int64, njit, prange

from studiorecon.splatting.conventions import (
    ALPHA_LOG2_MIN,
    ALPHA_MAX,
    BLOCK_PX,
    BLOCKS,
    BLOCKS_PER_SIDE,
    BLUE,
    DEPTH,
    ELLIPSE_A,
    ELLIPSE_C,
    ELLIPSE_K,
    GREEN,
    KERNEL,
    LANES,
    OPACITY_LOG2,
    RECORD,
    RED,
    TILE_PX,
    TRANSMITTANCE_MIN,
    X,
    Y,
)
from studiorecon.splatting.cpu.simd import (
    above,
    at_least,
    below,
    bits_from_mask,
    both,
    broadcast,
    exp2,
    least,
    madd,
    mask_from_bits,
    msub,
    nmadd,
    select,
    where,
    zeros,
)
from studiorecon.splatting.cpu.simd_rows import add_sums, item, load, lowest_bit, prefetch, store

STATE = 6 * LANES
"""Floats of one pixel block: gradients of red, green, blue, depth; transmittance T; remainder R."""


@njit(**KERNEL)
def _start_tile(tile_x, tile_y, state, finished, planes, gradients):
    height, width = planes.shape[1], planes.shape[2]
    for block in range(BLOCKS):
        outside = int64(0)
        for lane in range(LANES):
            x = tile_x + (block % BLOCKS_PER_SIDE) * BLOCK_PX + lane % BLOCK_PX
            y = tile_y + (block // BLOCKS_PER_SIDE) * BLOCK_PX + lane // BLOCK_PX
            at = block * STATE + lane
            if x < width and y < height:
                red, green, blue, depth = gradients[0, y, x], gradients[1, y, x], gradients[2, y, x], gradients[3, y, x]
                state[at], state[at + LANES], state[at + 2 * LANES], state[at + 3 * LANES] = red, green, blue, depth
                state[at + 4 * LANES] = float32(1)
                rendered = (
                    planes[0, y, x] * red + planes[1, y, x] * green + planes[2, y, x] * blue + planes[3, y, x] * depth
                )
                state[at + 5 * LANES] = rendered - planes[4, y, x] * gradients[4, y, x]
            else:
                for channel in range(6):
                    state[at + channel * LANES] = float32(0)
                outside |= int64(1) << lane
        finished[block] = outside


@njit(**KERNEL)
def _gather_tile(
    tile, columns, splats, starts, pairs, touched, ends, offsets, state, finished, planes, gradients, moments
):
    lane_x, lane_y = load(offsets, 0), load(offsets, LANES)
    tile_x, tile_y = (tile % columns) * TILE_PX, (tile // columns) * TILE_PX
    _start_tile(tile_x, tile_y, state, finished, planes, gradients)
    faintest, strongest, opaque = broadcast(ALPHA_LOG2_MIN), broadcast(ALPHA_MAX), broadcast(TRANSMITTANCE_MIN)
    one = broadcast(float32(1))
    end = int64(item(ends, tile))
    for i in range(int64(item(starts, tile)), end):
        blocks = int64(item(touched, i))
        if i + 3 < end:
            ahead = int64(item(pairs, i + 3)) * RECORD
            prefetch(splats, ahead)
            prefetch(moments, ahead)
        if blocks == 0:
            continue
        at = int64(item(pairs, i)) * RECORD
        x = item(splats, at + X) - float32(tile_x) - float32(0.5)
        y = item(splats, at + Y) - float32(tile_y) - float32(0.5)
        a, k = broadcast(item(splats, at + ELLIPSE_A)), broadcast(item(splats, at + ELLIPSE_K))
        c, opacity = broadcast(item(splats, at + ELLIPSE_C)), broadcast(item(splats, at + OPACITY_LOG2))
        red, green = broadcast(item(splats, at + RED)), broadcast(item(splats, at + GREEN))
        blue, depth = broadcast(item(splats, at + BLUE)), broadcast(item(splats, at + DEPTH))
        m0, m1, m2, m3, m4 = zeros(), zeros(), zeros(), zeros(), zeros()
        m5, m6, m7, m8, m9 = zeros(), zeros(), zeros(), zeros(), zeros()
        while blocks:
            block = lowest_bit(blocks)
            blocks &= blocks - 1
            here = block * STATE
            dx = lane_x + broadcast(float32(block % BLOCKS_PER_SIDE * BLOCK_PX) - x)
            dy = lane_y + broadcast(float32(block // BLOCKS_PER_SIDE * BLOCK_PX) - y)
            transmittance = load(state, here + 4 * LANES)
            u = nmadd(k, dy, dx)
            power = nmadd(a * u, u, nmadd(c * dy, dy, opacity))
            uncut = exp2(power)
            alpha = least(uncut, strongest)
            remaining = nmadd(alpha, transmittance, transmittance)
            done = item(finished, block)
            hit = both(at_least(power, faintest), mask_from_bits(~done))
            blended = both(hit, above(remaining, opaque))
            finished[block] = done | (bits_from_mask(hit) & ~bits_from_mask(blended))
            weight = where(blended, alpha * transmittance)
            g_red, g_green = load(state, here), load(state, here + LANES)
            g_blue, g_depth = load(state, here + 2 * LANES), load(state, here + 3 * LANES)
            gain = madd(red, g_red, madd(green, g_green, madd(blue, g_blue, depth * g_depth)))
            remainder = nmadd(weight, gain, load(state, here + 5 * LANES))
            store(state, here + 5 * LANES, remainder)
            store(state, here + 4 * LANES, select(blended, remaining, transmittance))
            by_alpha = msub(transmittance, gain, remainder / (one - alpha))
            # Where alpha was cut at its maximum it no longer depends on the splat's shape or opacity.
            q = where(both(blended, below(uncut, strongest)), alpha * by_alpha)
            q_u, q_y = q * u, q * dy
            m0, m1, m2 = m0 + q, m1 + q_u, m2 + q_y
            m3, m4, m5 = madd(q_u, u, m3), madd(q_u, dy, m4), madd(q_y, dy, m5)
            m6, m7 = madd(weight, g_red, m6), madd(weight, g_green, m7)
            m8, m9 = madd(weight, g_blue, m8), madd(weight, g_depth, m9)
        add_sums(moments, at, m0, m1, m2, m3, m4, m5, m6, m7, m8, m9)


@njit(parallel=True, **KERNEL)
def gather(shares, columns, rows, splats, starts, pairs, touched, ends, offsets, planes, gradients, moments):
    """Add every splat's moments to ``moments`` (shares · N · 16) for image gradients (5, H, W): rgb, depth sum, alpha.

    Tile t belongs to share t modulo ``shares``, each with its own records: sums repeat bit for bit for equal
    ``shares``.
    """
    size = len(splats)
    for share in prange(shares):
        state = np.empty(BLOCKS * STATE, np.float32)
        finished = np.empty(BLOCKS, np.int64)
        own = moments[share * size : (share + 1) * size]
        for tile in range(share, columns * rows, shares):
            _gather_tile(
                tile, columns, splats, starts, pairs, touched, ends, offsets, state, finished, planes, gradients, own
            )
