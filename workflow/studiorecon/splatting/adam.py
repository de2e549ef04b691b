# SPDX-License-Identifier: Apache-2.0
"""Adam: fused on parameter blocks for the training loop, and over plain arrays for loops that pose Gaussians themselves.

Three departures from the textbook, each from a failure seen elsewhere (numerics O04–O06): Gaussians that were not visible keep their
parameters and moments; epsilon is relative to the typical gradient, so rounding noise is not blown up to full steps; a gradient
that is not finite counts as 0 and is reported.

A loop of one's own, for instance for deformable people:

    rasteriser, blocked = Rasteriser(near_m=0.05), block(canonical)
    adam = Adam({"means_m": means, "sh": sh, "pose": pose}, betas=(0.9, 0.999), epsilon=1e-15)
    for iteration in range(iterations):
        repose(blocked, *posed(means, quaternions, pose))      # or block(Gaussians(...)) when scales or colours change too
        picture = rasteriser.forward(blocked, camera, background_rgb)
        loss, by_rgb = photometric(picture.rgb, photo, weight, l1, ssim)
        g = rasteriser.backward(by_rgb)
        gradients = {"means_m": back_to_canonical(g.means_m), "sh": g.sh, "pose": by_pose(g)}
        adam.step(gradients, {"means_m": rate(iteration), "sh": 2.5e-3, "pose": 1e-4})   # updates the given arrays in place
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numba import float32, int64, njit, prange

from studiorecon.splatting.conventions import BLOCK_FLOATS, KERNEL, LANES, LOG2_E, OPACITY, PIECE, SCALE
from studiorecon.splatting.simd import (
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
from studiorecon.splatting.simd_rows import load, store

RAW_ROWS = 4
"""Rows of one block that Adam keeps beside the activated ones: three log scales and the logit opacity."""


class Adam:
    """Adam over named arrays, which ``step`` changes in place.

    Attributes:
        refused: gradient entries so far that were not finite.
    """

    def __init__(self, parameters: Mapping[str, np.ndarray], betas: tuple[float, float], epsilon: float) -> None:
        for name, value in parameters.items():
            if not value.flags.c_contiguous or value.dtype not in (np.float32, np.float64):
                raise ValueError(f"{name} must be a C-contiguous float array, to be updated in place")
        self.parameters = dict(parameters)
        self.refused = 0
        self._betas, self._epsilon = betas, epsilon
        self._moments = {name: (np.zeros_like(p).reshape(-1), np.zeros_like(p).reshape(-1)) for name, p in parameters.items()}
        self._steps = dict.fromkeys(parameters, 0)

    def arrays(self) -> dict[str, np.ndarray]:
        """Parameters, moments, steps and the count of refused entries, for a checkpoint."""
        held = {f"parameter.{name}": value for name, value in self.parameters.items()}
        for name, (first, second) in self._moments.items():
            held |= {f"first.{name}": first, f"second.{name}": second, f"steps.{name}": np.array(self._steps[name])}
        return {**held, "refused": np.array(self.refused)}

    def resume(self, held: Mapping[str, np.ndarray]) -> None:
        """Puts ``arrays`` back, in place."""
        for name, value in self.parameters.items():
            value[...] = held[f"parameter.{name}"]
            for moment, kind in zip(self._moments[name], ("first", "second")):
                moment[...] = held[f"{kind}.{name}"]
            self._steps[name] = int(held[f"steps.{name}"])
        self.refused = int(held["refused"])

    def step(self, gradients: Mapping[str, np.ndarray], rates: Mapping[str, float], rows: np.ndarray | None = None) -> None:
        """One step of the parameters named in ``gradients``; with ``rows`` (N,) bool only those entries of the first axis move.

        Raises ValueError for a gradient or rows of another shape.
        """
        for name, gradient in gradients.items():
            parameter, (first, second) = self.parameters[name], self._moments[name]
            if gradient.shape != parameter.shape:
                raise ValueError(f"gradient of {name} has shape {gradient.shape}, expected {parameter.shape}")
            if rows is not None and rows.shape != parameter.shape[:1]:
                raise ValueError(f"rows has shape {rows.shape}, expected {parameter.shape[:1]} for {name}")
            self._steps[name] += 1
            corrections = tuple(1 - beta ** self._steps[name] for beta in self._betas)
            kind = parameter.dtype.type  # scalars of the array's own type: float32 stays float32 in the kernel
            width = max(1, parameter.size // max(1, len(parameter)))
            chosen = np.zeros(0, np.bool_) if rows is None else np.ascontiguousarray(rows, np.bool_)
            self.refused += step_arrays(
                parameter.reshape(-1), np.ascontiguousarray(gradient, parameter.dtype).reshape(-1), first, second, chosen, width,
                *(kind(x) for x in (rates[name], *self._betas, self._epsilon, *corrections)),
            )  # fmt: skip


@njit(parallel=True, **KERNEL)
def step_arrays(parameter, gradient, first, second, rows, width, rate, beta1, beta2, epsilon, correction1, correction2):
    """One Adam step of a flat array whose rows are ``width`` long; returns how many gradients were not finite."""
    refused = 0
    for i in prange(len(parameter)):
        if len(rows) and not rows[i // width]:
            continue
        g = gradient[i]
        if not math.isfinite(g):
            refused += 1
            g = gradient.dtype.type(0)
        m, v = beta1 * first[i] + (1 - beta1) * g, beta2 * second[i] + (1 - beta2) * g * g
        first[i], second[i] = m, v
        parameter[i] -= rate * (m / correction1) / (math.sqrt(v / correction2) + epsilon)
    return refused


@njit(**KERNEL)
def _step_some_blocks(
    begin, end, parameters, raw, gradient, first, second, rates, epsilons, beta1, beta2, correction1, correction2, visible, rows,
    opacity_pull, log_scale_max, refused,
):  # fmt: skip
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
                g = (g + broadcast(opacity_pull)) * p * (1 - p)
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
            change = where(seen, broadcast(rates[row] / correction1) * m / (root(v * unbias) + broadcast(epsilons[row])))
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
    parameters, raw, gradient, first, second, rates, epsilons, beta1, beta2, correction1, correction2, visible, rows, opacity_pull,
    log_scale_max, refused,
):  # fmt: skip
    """One Adam step of all visible Gaussians, with the activations: ``raw`` holds log scales and logits, ``parameters`` their values.

    ``rates`` and ``epsilons`` are per row (59), ``rows`` is how many rows move, ``opacity_pull`` is added to the gradient by opacity,
    log scales stay at or below ``log_scale_max``. ``refused`` (blocks) counts gradients that were not finite. corrections: 1 − β^t.
    """
    blocks = len(visible) // LANES
    for piece in prange(-(-blocks // PIECE)):
        begin = piece * PIECE
        _step_some_blocks(
            begin, min(begin + PIECE, blocks), parameters, raw, gradient, first, second, rates, epsilons, beta1, beta2, correction1,
            correction2, visible, rows, opacity_pull, log_scale_max, refused,
        )  # fmt: skip
