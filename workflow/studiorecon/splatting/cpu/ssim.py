# SPDX-License-Identifier: Apache-2.0
"""Kernels of the photometric loss: L1 and SSIM with their analytic gradient, sixteen pixels at a time.

Window and constants are those of the measure ``images.similarity``; outside the image are zeros, as in 3DGS. Images are
padded planes: three planes of (H + 10) rows, each a multiple of 16 wide with 16 zeros on either side, flat. The
target's own statistics are computed once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import float32, int64, njit, prange

from studiorecon.images import similarity
from studiorecon.images.similarity import K_1, K_2, RADIUS, WINDOW
from studiorecon.splatting.conventions import INLINE, KERNEL, LANES
from studiorecon.splatting.cpu.simd import above, below, broadcast, madd, magnitude, select, where, zeros
from studiorecon.splatting.cpu.simd_rows import load, store

if TYPE_CHECKING:
    from jaxtyping import Float

TAPS = WINDOW
PAD = LANES
C1, C2 = np.float32(K_1**2), np.float32(K_2**2)


def window() -> Float[np.ndarray, " 11"]:
    """Float32 window of the measure SSIM."""
    return similarity.window().astype(np.float32)


def padded_width(width: int) -> int:
    """Width of a padded plane."""
    return -(-width // LANES) * LANES + 2 * PAD


@njit(**INLINE)
def _across(line, start, x, taps):
    """Horizontal window over a padded line at columns x … x + 15."""
    total = zeros()
    for k in range(TAPS):
        total = madd(load(line, start + x + k - RADIUS), broadcast(taps[k]), total)
    return total


@njit(**INLINE)
def _sum_of_lanes(lanes, scratch):
    store(scratch, 0, lanes)
    total = float32(0)
    for lane in range(LANES):
        total += scratch[lane]
    return total


@njit(**KERNEL)
def pad_target(rgb, weight, wide, padded, wide_weight):
    """Number of weighted pixels of a target, which is written with its weights (H, W) to padded arrays that are 0
    before.

    Colours of other pixels are clipped to 0..1, 0 where they are NaN.
    """
    height, width = weight.shape
    rows, inner, used = height + 2 * RADIUS, wide - 2 * PAD, 0
    for y in range(height):
        for x in range(width):
            counts = weight[y, x] > float32(0)
            used += counts
            wide_weight[y * inner + x] = weight[y, x] if counts else float32(0)
            for channel in range(3):
                value = rgb[y, x, channel]
                if not counts:
                    value = min(max(value, float32(0)), float32(1)) if value == value else float32(0)
                padded[(channel * rows + y + RADIUS) * wide + PAD + x] = value
    return used


@njit(parallel=True, **KERNEL)
def target_statistics(target, height, wide, taps, mean, square):
    """Fills the windowed mean and the windowed mean square of a padded target."""
    rows = height + 2 * RADIUS
    for j in prange(3 * height):
        first = (j // height) * rows + j % height
        line = np.zeros(2 * wide, np.float32)
        for x in range(PAD, wide - PAD, LANES):
            a, b = zeros(), zeros()
            for k in range(TAPS):
                value, tap = load(target, (first + k) * wide + x), broadcast(taps[k])
                a, b = madd(value, tap, a), madd(value * value, tap, b)
            store(line, x, a)
            store(line, wide + x, b)
        out = (first + RADIUS) * wide
        for x in range(PAD, wide - PAD, LANES):
            store(mean, out + x, _across(line, 0, x, taps))
            store(square, out + x, _across(line, wide, x, taps))


@njit(**KERNEL)
def _pad_row(j, planes, target, weight, wide, padded):
    """Rendering (5, H, W) → padded planes, with the target's colours where the weight (H, wide − 32) is 0."""
    height, width = planes.shape[1], planes.shape[2]
    rows, inner = height + 2 * RADIUS, wide - 2 * PAD
    channel, y = j // height, j % height
    at = (channel * rows + y + RADIUS) * wide + PAD
    for x in range(width):
        padded[at + x] = planes[channel, y, x] if weight[y * inner + x] > float32(0) else target[at + x]


@njit(**KERNEL)
def _similarity_row(j, image, target, mean, square, weight, height, wide, taps, slopes, sums):
    """Fills ``slopes`` (padded: w·dSSIM by windowed mean, square and product) and sums[:, 0] = Σ w·(1 − SSIM)."""
    rows, inner, size = height + 2 * RADIUS, wide - 2 * PAD, len(image)
    one, two, c1, c2 = broadcast(float32(1)), broadcast(float32(2)), broadcast(C1), broadcast(C2)
    y = j % height
    first = (j // height) * rows + y
    line, scratch = np.zeros(3 * wide, np.float32), np.empty(LANES, np.float32)
    for x in range(PAD, wide - PAD, LANES):
        a, b, d = zeros(), zeros(), zeros()
        for k in range(TAPS):
            at = (first + k) * wide + x
            value = load(image, at)
            tapped = value * broadcast(taps[k])
            a, b, d = a + tapped, madd(tapped, value, b), madd(tapped, load(target, at), d)
        store(line, x, a)
        store(line, wide + x, b)
        store(line, 2 * wide + x, d)
    out = (first + RADIUS) * wide
    total = zeros()
    for x in range(PAD, wide - PAD, LANES):
        mx, xx, xy = _across(line, 0, x, taps), _across(line, wide, x, taps), _across(line, 2 * wide, x, taps)
        my, yy, w = load(mean, out + x), load(square, out + x), load(weight, y * inner + x - PAD)
        product, squares = mx * my, madd(mx, mx, my * my)
        a, b = madd(two, product, c1), madd(two, xy - product, c2)
        inverse_p, inverse_q = one / (squares + c1), one / (xx + yy - squares + c2)
        similarity = a * b * inverse_p * inverse_q
        total = madd(w, one - similarity, total)
        # By the mean with mean square and mean product fixed, through a, b, p and q.
        by_mean = two * my * (b - a) * inverse_p * inverse_q + two * mx * similarity * (inverse_q - inverse_p)
        store(slopes, out + x, w * by_mean)
        store(slopes, size + out + x, -(w * similarity * inverse_q))
        store(slopes, 2 * size + out + x, w * two * a * inverse_p * inverse_q)
    sums[j, 0] = _sum_of_lanes(total, scratch)


@njit(**KERNEL)
def _gradient_row(j, image, target, weight, height, wide, taps, slopes, l1, ssim, gradient, sums):
    """Add the gradient of l1·Σ w|x−y| + ssim·Σ w(1−SSIM) by the image to gradient (3, H, W).

    sums[:, 1:] = Σ w|x−y| and Σ over w > 0 of (x−y)², per row.
    """
    rows, inner, size, width = height + 2 * RADIUS, wide - 2 * PAD, len(image), gradient.shape[2]
    two, one, by_ssim = broadcast(float32(2)), broadcast(float32(1)), broadcast(-ssim)
    flat = gradient.reshape(-1)
    y = j % height
    first = (j // height) * rows + y
    line, scratch = np.zeros(3 * wide, np.float32), np.empty(LANES, np.float32)
    for x in range(PAD, wide - PAD, LANES):
        a, b, d = zeros(), zeros(), zeros()
        for k in range(TAPS):
            at, tap = (first + k) * wide + x, broadcast(taps[k])
            a, b = madd(load(slopes, at), tap, a), madd(load(slopes, size + at), tap, b)
            d = madd(load(slopes, 2 * size + at), tap, d)
        store(line, x, a)
        store(line, wide + x, b)
        store(line, 2 * wide + x, d)
    out = (first + RADIUS) * wide
    absolute, squared = zeros(), zeros()
    for x in range(PAD, wide - PAD, LANES):
        value, wanted, w = load(image, out + x), load(target, out + x), load(weight, y * inner + x - PAD)
        error = value - wanted
        sign = select(above(error, zeros()), one, select(below(error, zeros()), -one, zeros()))
        absolute, squared = madd(w, magnitude(error), absolute), squared + where(above(w, zeros()), error * error)
        similar = (
            _across(line, 0, x, taps)
            + two * value * _across(line, wide, x, taps)
            + wanted * _across(line, 2 * wide, x, taps)
        )
        slope = where(above(w, zeros()), madd(by_ssim, similar, broadcast(l1) * w * sign))
        column = x - PAD
        at = j * width + column
        if column + LANES <= width:
            store(flat, at, load(flat, at) + slope)
        else:
            store(scratch, 0, slope)
            for lane in range(width - column):
                flat[at + lane] += scratch[lane]
    sums[j, 1] = _sum_of_lanes(absolute, scratch)
    sums[j, 2] = _sum_of_lanes(squared, scratch)


@njit(parallel={"fusion": False}, **KERNEL)  # type: ignore[call-overload]  # numba's stubs know no dictionary here
def photometric_terms(
    planes, target, mean, square, weight, height, wide, taps, l1, ssim, image, slopes, gradient, sums
):
    """Compare a rendering (5, H, W) with a padded target: add to ``gradient`` and fill the rows' ``sums`` (3·H, 3).

    The rows' functions define the sums. One kernel, because each parallel kernel takes a second to compile.
    """
    for j in prange(3 * height):
        _pad_row(int64(j), planes, target, weight, wide, image)
    for j in prange(3 * height):
        _similarity_row(int64(j), image, target, mean, square, weight, height, wide, taps, slopes, sums)
    for j in prange(3 * height):
        _gradient_row(int64(j), image, target, weight, height, wide, taps, slopes, l1, ssim, gradient, sums)
