# SPDX-License-Identifier: Apache-2.0
"""Front-to-back alpha blending of the tiles' lists, sixteen pixels at a time."""

from __future__ import annotations

import math

import numpy as np
from numba import float32, int64, njit, prange

from studiorecon.splatting.conventions import (
    ALL_LANES,
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
    HALF_HEIGHT,
    HALF_WIDTH,
    INLINE,
    KERNEL,
    LANES,
    MORE,
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
    bits_from_mask,
    both,
    broadcast,
    exp2,
    least,
    madd,
    mask_from_bits,
    nmadd,
    select,
    where,
    zeros,
)
from studiorecon.splatting.cpu.simd_rows import item, load, prefetch, store, take_ticket

STATE = 8 * LANES
"""Floats of one pixel block while it is blended: red, green, blue, depth sum, transmittance, and three channels more
when asked for."""

LANE_OFFSETS = np.array([i % BLOCK_PX for i in range(LANES)] + [i // BLOCK_PX for i in range(LANES)], np.float32)
"""Column (16) and row (16) of every lane within its block."""


@njit(**INLINE)
def lanes_outside(tile_x, tile_y, block, width, height):
    """Bits of the block's lanes that lie outside the image."""
    bits = int64(0)
    for lane in range(LANES):
        x = tile_x + (block % BLOCKS_PER_SIDE) * BLOCK_PX + lane % BLOCK_PX
        y = tile_y + (block // BLOCKS_PER_SIDE) * BLOCK_PX + lane // BLOCK_PX
        if x >= width or y >= height:
            bits |= int64(1) << lane
    return bits


@njit(**KERNEL)
def _blend_tile(
    tile,
    columns,
    width,
    height,
    splats,
    starts,
    pairs,
    touched,
    ends,
    background,
    offsets,
    state,
    finished,
    planes,
    more,
):
    # ``more`` is None or planes (3, H, W); code that depends on it is left out when the kernel is compiled for None.
    lane_x, lane_y = load(offsets, 0), load(offsets, LANES)
    tile_x, tile_y = (tile % columns) * TILE_PX, (tile // columns) * TILE_PX
    full_blocks = 0
    for block in range(BLOCKS):
        for channel in range(4):
            store(state, block * STATE + channel * LANES, zeros())
        store(state, block * STATE + 4 * LANES, broadcast(float32(1)))
        if more is not None:
            for channel in range(5, 8):
                store(state, block * STATE + channel * LANES, zeros())
        finished[block] = 0
        if tile_x + TILE_PX > width or tile_y + TILE_PX > height:
            finished[block] = lanes_outside(tile_x, tile_y, block, width, height)
        full_blocks += finished[block] == ALL_LANES
    faintest, strongest, opaque = broadcast(ALPHA_LOG2_MIN), broadcast(ALPHA_MAX), broadcast(TRANSMITTANCE_MIN)
    i, end = int64(item(starts, tile)), int64(item(starts, tile + 1))
    while i < end and full_blocks < BLOCKS:
        at = int64(item(pairs, i)) * RECORD
        if i + 4 < end:
            prefetch(splats, int64(item(pairs, i + 4)) * RECORD)
        x = item(splats, at + X) - float32(tile_x) - float32(0.5)
        y = item(splats, at + Y) - float32(tile_y) - float32(0.5)
        half_w, half_h = item(splats, at + HALF_WIDTH), item(splats, at + HALF_HEIGHT)
        x0 = int64(math.ceil(max(x - half_w, float32(0))))
        x1 = int64(math.floor(min(x + half_w, float32(TILE_PX - 1))))
        y0 = int64(math.ceil(max(y - half_h, float32(0))))
        y1 = int64(math.floor(min(y + half_h, float32(TILE_PX - 1))))
        touched_here = int64(0)
        if x0 <= x1 and y0 <= y1 and x + half_w >= float32(0) and y + half_h >= float32(0):
            a, k = broadcast(item(splats, at + ELLIPSE_A)), broadcast(item(splats, at + ELLIPSE_K))
            c, opacity = broadcast(item(splats, at + ELLIPSE_C)), broadcast(item(splats, at + OPACITY_LOG2))
            red, green = broadcast(item(splats, at + RED)), broadcast(item(splats, at + GREEN))
            blue, depth = broadcast(item(splats, at + BLUE)), broadcast(item(splats, at + DEPTH))
            if more is not None:
                first, second = broadcast(item(splats, at + MORE)), broadcast(item(splats, at + MORE + 1))
                third = broadcast(item(splats, at + MORE + 2))
            for block_y in range(y0 // BLOCK_PX, y1 // BLOCK_PX + 1):
                dy = lane_y + broadcast(float32(block_y * BLOCK_PX) - y)
                for block_x in range(x0 // BLOCK_PX, x1 // BLOCK_PX + 1):
                    block = block_y * BLOCKS_PER_SIDE + block_x
                    done = item(finished, block)
                    if done == ALL_LANES:
                        continue
                    here = block * STATE
                    dx = lane_x + broadcast(float32(block_x * BLOCK_PX) - x)
                    transmittance = load(state, here + 4 * LANES)
                    u = nmadd(k, dy, dx)
                    power = nmadd(a * u, u, nmadd(c * dy, dy, opacity))
                    alpha = least(exp2(power), strongest)
                    remaining = nmadd(alpha, transmittance, transmittance)
                    hit = both(at_least(power, faintest), mask_from_bits(~done))
                    blended = both(hit, above(remaining, opaque))
                    hit_bits = bits_from_mask(hit)
                    newly_done = hit_bits & ~bits_from_mask(blended)
                    if newly_done:
                        finished[block] = done | newly_done
                        full_blocks += (done | newly_done) == ALL_LANES
                    if hit_bits:
                        touched_here |= int64(1) << block
                    weight = where(blended, alpha * transmittance)
                    store(state, here + 4 * LANES, select(blended, remaining, transmittance))
                    store(state, here, madd(weight, red, load(state, here)))
                    store(state, here + LANES, madd(weight, green, load(state, here + LANES)))
                    store(state, here + 2 * LANES, madd(weight, blue, load(state, here + 2 * LANES)))
                    store(state, here + 3 * LANES, madd(weight, depth, load(state, here + 3 * LANES)))
                    if more is not None:
                        store(state, here + 5 * LANES, madd(weight, first, load(state, here + 5 * LANES)))
                        store(state, here + 6 * LANES, madd(weight, second, load(state, here + 6 * LANES)))
                        store(state, here + 7 * LANES, madd(weight, third, load(state, here + 7 * LANES)))
        touched[i] = touched_here
        i += 1
    ends[tile] = i
    for block in range(BLOCKS):
        for lane in range(LANES):
            px = tile_x + (block % BLOCKS_PER_SIDE) * BLOCK_PX + lane % BLOCK_PX
            py = tile_y + (block // BLOCKS_PER_SIDE) * BLOCK_PX + lane // BLOCK_PX
            if px < width and py < height:
                at = block * STATE + lane
                rest = state[at + 4 * LANES]
                planes[0, py, px] = state[at] + rest * background[0]
                planes[1, py, px] = state[at + LANES] + rest * background[1]
                planes[2, py, px] = state[at + 2 * LANES] + rest * background[2]
                planes[3, py, px] = state[at + 3 * LANES]
                planes[4, py, px] = rest
                if more is not None:
                    for channel in range(3):
                        more[channel, py, px] = state[at + (5 + channel) * LANES]


@njit(parallel=True, **KERNEL)
def blend(threads, columns, rows, splats, starts, pairs, touched, ends, background, offsets, planes, ticket):
    """Fill ``planes`` (5, H, W): red, green, blue over the background, depth sum, transmittance.

    Also fills, for the backward pass, one bit per touched pixel block for every list entry (``touched``), and where
    each tile's list ended for being opaque (``ends``). Threads take tiles as they become free; one thread computes a
    whole tile, so the result does not depend on which.
    """
    height, width = planes.shape[1], planes.shape[2]
    ticket[0] = 0
    for _ in prange(threads):
        state = np.empty(BLOCKS * STATE, np.float32)
        finished = np.empty(BLOCKS, np.int64)
        while True:
            tile = take_ticket(ticket)
            if tile >= columns * rows:
                break
            _blend_tile(
                tile,
                columns,
                width,
                height,
                splats,
                starts,
                pairs,
                touched,
                ends,
                background,
                offsets,
                state,
                finished,
                planes,
                None,
            )


@njit(parallel=True, **KERNEL)
def blend_more(threads, columns, rows, splats, starts, pairs, touched, ends, background, offsets, planes, more, ticket):
    """``blend`` that also fills ``more`` (3, H, W) with three further values of the splats' records, over 0."""
    height, width = planes.shape[1], planes.shape[2]
    ticket[0] = 0
    for _ in prange(threads):
        state = np.empty(BLOCKS * STATE, np.float32)
        finished = np.empty(BLOCKS, np.int64)
        while True:
            tile = take_ticket(ticket)
            if tile >= columns * rows:
                break
            _blend_tile(
                tile,
                columns,
                width,
                height,
                splats,
                starts,
                pairs,
                touched,
                ends,
                background,
                offsets,
                state,
                finished,
                planes,
                more,
            )
