# SPDX-License-Identifier: Apache-2.0
"""Lists of the splats that touch each tile, front to back: a radix sort by depth, then a stable scatter into tiles.

Every tile's list comes out sorted, and ties resolve by index.
"""

from __future__ import annotations

import math

import numpy as np
from numba import float32, int64, njit, prange

from studiorecon.splatting.conventions import (
    ALPHA_LOG2_MIN,
    ELLIPSE_A,
    ELLIPSE_C,
    ELLIPSE_K,
    HALF_HEIGHT,
    HALF_WIDTH,
    INLINE,
    KERNEL,
    OPACITY_LOG2,
    RECORD,
    TILE_PX,
    X,
    Y,
)
from studiorecon.splatting.cpu.simd_rows import prefetch

DIGIT_BITS = 11
DIGITS = 1 << DIGIT_BITS


@njit(**KERNEL)
def depth_order(depth_bits, visible, order, order_scratch, keys, keys_scratch):
    """Number of visible indices, which fill ``order`` by increasing depth (three stable passes of 11 bits).

    ``depth_bits`` are the uint32 bit patterns of positive float32 depths, which sort like the depths.
    """
    histogram = np.zeros((3, DIGITS), np.uint32)
    count = 0
    for i in range(len(depth_bits)):
        if visible[i]:
            bits = depth_bits[i]
            keys[count] = bits
            order[count] = i
            count += 1
            histogram[0, bits & (DIGITS - 1)] += 1
            histogram[1, (bits >> DIGIT_BITS) & (DIGITS - 1)] += 1
            histogram[2, bits >> (2 * DIGIT_BITS)] += 1
    for digit in range(3):
        total = np.uint32(0)
        for j in range(DIGITS):
            here = histogram[digit, j]
            histogram[digit, j] = total
            total += here
    _scatter(count, np.uint32(0), histogram[0], keys, order, keys_scratch, order_scratch)
    _scatter(count, np.uint32(DIGIT_BITS), histogram[1], keys_scratch, order_scratch, keys, order)
    _scatter(count, np.uint32(2 * DIGIT_BITS), histogram[2], keys, order, keys_scratch, order_scratch)
    for i in range(count):
        order[i] = order_scratch[i]
    return count


@njit(**INLINE)
def _scatter(count, shift, starts, keys, order, keys_out, order_out):
    for i in range(count):
        digit = (keys[i] >> shift) & np.uint32(DIGITS - 1)
        place = starts[digit]
        starts[digit] = place + np.uint32(1)
        keys_out[place] = keys[i]
        order_out[place] = order[i]


@njit(**INLINE)
def _tile_range(centre, half, tiles):
    """First and last tile whose pixel centres the interval centre ± half reaches; last < first when there is none."""
    first = int64(max(centre - half + float32(0.499), float32(0))) // TILE_PX
    last = min(tiles - 1, int64(min(centre + half - float32(0.499), float32(1e6))) // TILE_PX)
    if centre + half < float32(0.49):
        last = int64(-1)
    return first, last


@njit(**INLINE)
def _columns_in_row(x, y, k, c, reach, inverse_root_a, tip, half_h, row, columns):
    """First and last tile column that the ellipse meets in tile row ``row``; ``tip``: dy of its rightmost point."""
    above = max(float32(row * TILE_PX) + float32(0.5) - y, -half_h)
    below = min(float32(row * TILE_PX + TILE_PX) - float32(0.5) - y, half_h)
    if above > below:
        return int64(0), int64(-1)
    right_y, left_y = min(max(tip, above), below), min(max(-tip, above), below)
    right = x + k * right_y + math.sqrt(max(float32(0), reach - c * right_y * right_y)) * inverse_root_a
    left = x + k * left_y - math.sqrt(max(float32(0), reach - c * left_y * left_y)) * inverse_root_a
    first = int64(max(left + float32(0.499), float32(0))) // TILE_PX
    last = min(columns - 1, int64(min(right - float32(0.499), float32(1e6))) // TILE_PX)
    if right < float32(0.49):
        last = int64(-1)
    return first, last


@njit(**KERNEL)
def _scatter_share(share, count, order, splats, columns, rows, shares, cursor, rectangles, pairs, fill):
    offset = share * columns * rows
    for i in range(count * share // shares, count * (share + 1) // shares):
        at = int64(order[i]) * RECORD
        if fill:
            row0, row1 = int64(rectangles[4 * i]), int64(rectangles[4 * i + 1])
            column0, column1 = int64(rectangles[4 * i + 2]), int64(rectangles[4 * i + 3])
        else:
            if i + 8 < count:
                prefetch(splats, int64(order[i + 8]) * RECORD)
            row0, row1 = _tile_range(splats[at + Y], splats[at + HALF_HEIGHT], rows)
            column0, column1 = _tile_range(splats[at + X], splats[at + HALF_WIDTH], columns)
            rectangles[4 * i], rectangles[4 * i + 1], rectangles[4 * i + 2], rectangles[4 * i + 3] = (
                row0,
                row1,
                column0,
                column1,
            )
        if row0 > row1 or column0 > column1:
            continue
        strip = row0 == row1 or column0 == column1
        x, y, k, c = splats[at + X], splats[at + Y], splats[at + ELLIPSE_K], splats[at + ELLIPSE_C]
        reach = splats[at + OPACITY_LOG2] - ALPHA_LOG2_MIN
        half_w, half_h = splats[at + HALF_WIDTH], splats[at + HALF_HEIGHT]
        inverse_root_a, tip = float32(0), float32(0)
        if not strip:
            inverse_root_a = float32(1) / math.sqrt(splats[at + ELLIPSE_A])
            tip = k * half_h * half_h / half_w
        for row in range(row0, row1 + 1):
            first, last = column0, column1
            if not strip:
                first, last = _columns_in_row(x, y, k, c, reach, inverse_root_a, tip, half_h, row, columns)
            for cell in range(offset + row * columns + first, offset + row * columns + last + 1):
                place = cursor[cell]
                if fill:
                    pairs[place] = order[i]
                cursor[cell] = place + np.uint32(1)


@njit(parallel=True, **KERNEL)
def scatter_into_tiles(count, order, splats, columns, rows, shares, cursor, rectangles, pairs, fill):
    """Pass one (``fill`` False) counts pairs per share and tile; pass two writes splat indices at ``cursor``.

    ``cursor`` is (shares · tiles) uint32, zero before pass one; ``place_tiles`` turns it into places in between. A
    bounding box one tile wide or high needs no ellipse test: a convex splat meets every tile of such a strip.
    """
    for share in prange(shares):
        _scatter_share(int64(share), count, order, splats, columns, rows, shares, cursor, rectangles, pairs, fill)


@njit(**KERNEL)
def place_tiles(cursor, shares, starts):
    """Total of the counts, which become first places by tile, then share; fills ``starts`` (tiles + 1).

    When the 64-bit total does not fit 32 bits the places are meaningless; the caller must refuse.
    """
    tiles = len(starts) - 1
    total = int64(0)
    for tile in range(tiles):
        starts[tile] = np.uint32(total)
        for share in range(shares):
            here = cursor[share * tiles + tile]
            cursor[share * tiles + tile] = np.uint32(total)
            total += int64(here)
    starts[tiles] = np.uint32(total)
    return total
