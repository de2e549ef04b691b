# SPDX-License-Identifier: Apache-2.0
"""Kernels of Adam: fused with the activations on parameter blocks, and on flat arrays (``train/optimiser``)."""

from __future__ import annotations

import math

import numpy as np
from numba import float32, int64, njit, prange

from studiorecon.splatting.conventions import BLOCK_FLOATS, KERNEL, LANES, LOG2_E, OPACITY, PIECE, SCALE
from studiorecon.splatting.cpu.simd import (
    below,
    bits_from_mask,
    both,
    broadcast,
    exp2,
    least,
    madd,
    magnitude,
    mask_from_bits,
    most,
    root,
    select,
    where,
)
from studiorecon.splatting.cpu.simd_rows import load, store

RAW_ROWS = 4
"""Rows of one block that Adam keeps beside the activated ones: three log scales and the logit opacity."""
_ROWS_AT_ONCE = 256


@njit(**KERNEL)
def _step_some(parameter, gradient, first, second, moves, rate, beta1, beta2, epsilon, correction1, correction2):
    """``step_arrays`` for entries whose ``moves`` are not 0; selects instead of branches, so that it vectorises."""
    refused, zero = 0, gradient.dtype.type(0)
    for i in range(len(parameter)):
        finite, move = abs(gradient[i]) < np.inf, moves[i] != 0
        refused += move and not finite
        g = gradient[i] if finite else zero
        m, v = beta1 * first[i] + (1 - beta1) * g, beta2 * second[i] + (1 - beta2) * g * g
        change = rate * (m / correction1) / (math.sqrt(v / correction2) + epsilon)
        first[i], second[i] = (m if move else first[i]), (v if move else second[i])
        parameter[i] -= change if move else zero
    return refused


@njit(**KERNEL)
def step_arrays(parameter, gradient, first, second, rows, width, rate, beta1, beta2, epsilon, correction1, correction2):
    """Number of gradients that were not finite, after one Adam step of a flat array with rows of ``width``."""
    refused, count = 0, len(parameter) // width
    moves = np.ones(_ROWS_AT_ONCE * width, np.uint8)
    for begin in range(0, count, _ROWS_AT_ONCE):
        end = min(count, begin + _ROWS_AT_ONCE)
        if len(rows):
            for row in range(begin, end):
                for k in range(width):
                    moves[(row - begin) * width + k] = rows[row]
        low, high = begin * width, end * width
        refused += _step_some(
            parameter[low:high],
            gradient[low:high],
            first[low:high],
            second[low:high],
            moves,
            rate,
            beta1,
            beta2,
            epsilon,
            correction1,
            correction2,
        )
    return refused


@njit(**KERNEL)
def _step_some_blocks(
    begin,
    end,
    parameters,
    raw,
    gradient,
    first,
    second,
    rates,
    epsilons,
    beta1,
    beta2,
    correction1,
    correction2,
    visible,
    rows,
    log_scale_max,
    refused,
):
    b1, b2 = broadcast(beta1), broadcast(beta2)
    a1, a2 = broadcast(float32(1) - beta1), broadcast(float32(1) - beta2)
    unbias, infinity, sixty = broadcast(float32(1) / correction2), broadcast(float32(np.inf)), broadcast(float32(60))
    for block in range(begin, end):
        bits = int64(0)
        for lane in range(LANES):
            bits |= int64(visible[block * LANES + lane]) << lane
        refused[block] = 0
        if bits == 0:
            continue
        seen, base = mask_from_bits(bits), block * BLOCK_FLOATS
        for row in range(rows):
            at = base + row * LANES
            g, p = load(gradient, at), load(parameters, at)
            activated = (SCALE <= row < SCALE + 3) or row == OPACITY
            if row == OPACITY:
                g = g * p * (1 - p)
            elif activated:
                g = g * p
            finite = below(magnitude(g), infinity)
            wrong = bits & (bits_from_mask(finite) ^ 0xFFFF)
            while wrong:
                wrong &= wrong - 1
                refused[block] += 1
            g = where(both(finite, seen), g)
            m, v = load(first, at), load(second, at)
            m, v = select(seen, madd(b1, m, a1 * g), m), select(seen, madd(b2, v, a2 * g * g), v)
            store(first, at, m)
            store(second, at, v)
            change = where(
                seen, broadcast(rates[row] / correction1) * m / (root(v * unbias) + broadcast(epsilons[row]))
            )
            if activated:
                place = (block * RAW_ROWS + (3 if row == OPACITY else row - SCALE)) * LANES
                x = load(raw, place) - change
                if row == OPACITY:
                    store(raw, place, x)
                    store(parameters, at, 1 / (1 + exp2(least(most(-x * LOG2_E, -sixty), sixty))))
                else:
                    x = least(x, broadcast(log_scale_max))
                    store(raw, place, x)
                    store(parameters, at, exp2(most(least(x * LOG2_E, sixty), -sixty)))
            else:
                store(parameters, at, p - change)


@njit(parallel=True, **KERNEL)
def step_blocks(
    parameters,
    raw,
    gradient,
    first,
    second,
    rates,
    epsilons,
    beta1,
    beta2,
    correction1,
    correction2,
    visible,
    rows,
    log_scale_max,
    refused,
):
    """One Adam step of all visible Gaussians; ``raw`` holds log scales and logits, ``parameters`` their values.

    ``rates`` and ``epsilons`` are per row (59). ``rows`` is the number of rows that move; log scales stay at or below
    ``log_scale_max``. ``refused`` (blocks) counts gradients that were not finite. corrections: 1 − β^t.
    """
    blocks = len(visible) // LANES
    for piece in prange(-(-blocks // PIECE)):
        begin = piece * PIECE
        _step_some_blocks(
            begin,
            min(begin + PIECE, blocks),
            parameters,
            raw,
            gradient,
            first,
            second,
            rates,
            epsilons,
            beta1,
            beta2,
            correction1,
            correction2,
            visible,
            rows,
            log_scale_max,
            refused,
        )
