# SPDX-License-Identifier: Apache-2.0
"""The state of a training loop: blocked parameters, Adam's moments, and every Gaussian's source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import float32, njit, prange

from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.conventions import BLOCK_FLOATS, KERNEL, LANES, MEAN, QUATERNION, ROWS, SH
from studiorecon.splatting.cpu.adam import RAW_ROWS
from studiorecon.splatting.cpu.blocks import BlockedGaussians, aligned_zeros, block, morton_order

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Shaped

STORED = ("raw", "first", "second", "source", "gradient_sum", "gradient_count")
"""Fields of a TrainingState that a checkpoint holds beside the blocks."""


@dataclass
class TrainingState:
    """Everything per Gaussian, in Morton order.

    Attributes:
        blocked: parameters with activated scales and opacities.
        raw: (blocks · 4 · 16,) log scales and logits.
        first, second: Adam's moments, layout of the parameters.
        source: index of the initial Gaussian each one descends from.
        gradient_sum, gradient_count: (padded,) screen gradients of the views that saw it since the last growth.
    """

    blocked: BlockedGaussians
    raw: Float[np.ndarray, " R"]
    first: Float[np.ndarray, " P"]
    second: Float[np.ndarray, " P"]
    source: Integer[np.ndarray, " N"]
    gradient_sum: Float[np.ndarray, " p"]
    gradient_count: Float[np.ndarray, " p"]


def initial_state(gaussians: Gaussians) -> TrainingState:
    """The state before the first step."""
    n = gaussians.count
    moments = np.zeros(0, np.float32)
    return _laid_out(gaussians, np.arange(n), moments, moments, np.full(n, -1))


def regrow(
    state: TrainingState, gaussians: Gaussians, parent: Integer[np.ndarray, " M"], fresh: Bool[np.ndarray, " M"]
) -> TrainingState:
    """The state with other Gaussians: ``parent`` is the old index of each; ``fresh`` ones start without moments."""
    return _laid_out(gaussians, state.source[parent], state.first, state.second, np.where(fresh, -1, parent))


def _laid_out(
    gaussians: Gaussians, source: np.ndarray, first: np.ndarray, second: np.ndarray, moments_of: np.ndarray
) -> TrainingState:
    order = morton_order(gaussians.means_m)
    blocked = block(gaussians, order)
    size = len(blocked.parameters)
    raw = aligned_zeros(blocked.padded * RAW_ROWS)
    fill_raw(gaussians.log_scales, gaussians.logit_opacities, order, raw)
    lanes = np.full(blocked.padded, -1)
    lanes[: len(order)] = moments_of[order]
    moments = (aligned_zeros(size), aligned_zeros(size))
    move_lanes(first, lanes, moments[0])
    move_lanes(second, lanes, moments[1])
    sums = (np.zeros(blocked.padded, np.float32), np.zeros(blocked.padded, np.float32))
    return TrainingState(blocked, raw, *moments, source[order], *sums)


def state_arrays(state: TrainingState) -> dict[str, Shaped[np.ndarray, " ..."]]:
    """The whole state as named arrays, for a checkpoint."""
    arrays = {name: getattr(state, name) for name in STORED}
    return {
        **arrays,
        "parameters": state.blocked.parameters,
        "shape": np.array([state.blocked.count, state.blocked.degree]),
    }


def restore_state(arrays: Mapping[str, Shaped[np.ndarray, " ..."]]) -> TrainingState:
    """The state of ``state_arrays``, bit for bit."""
    count, degree = arrays["shape"].tolist()
    laid = {name: aligned_zeros(len(arrays[name])) for name in ("parameters", "raw", "first", "second")}
    for name, place in laid.items():
        place[:] = arrays[name]
    blocked = BlockedGaussians(laid["parameters"], count, degree)
    rest = (arrays[name].copy() for name in ("source", "gradient_sum", "gradient_count"))
    return TrainingState(blocked, laid["raw"], laid["first"], laid["second"], *rest)


def finite_mask(gaussians: Gaussians) -> Bool[np.ndarray, " N"]:
    """Gaussians without NaN or infinite values."""
    arrays = (gaussians.means_m, gaussians.quaternions, gaussians.log_scales, gaussians.logit_opacities, gaussians.sh)
    return np.all([np.isfinite(array).all(axis=tuple(range(1, array.ndim))) for array in arrays], axis=0)


def state_gaussians(state: TrainingState) -> Gaussians:
    """The Gaussians in the state's order, with the exact log scales and logits of Adam."""
    n, bands = state.blocked.count, (state.blocked.degree + 1) ** 2
    arrays = tuple(np.empty(shape, np.float32) for shape in ((n, 3), (n, 4), (n, 3), (n,), (n, bands, 3)))
    take_parameters(state.blocked.parameters, state.raw, *arrays)
    return Gaussians(*arrays)


@njit(**KERNEL)
def fill_raw(log_scales, logit_opacities, order, raw):
    """Write log scales and logits into blocks; padding gets logit −60.

    Adam writes the opacity of every lane of a visible block, and a logit of 0 would be a ghost of ½.
    """
    for i in range(len(order), len(raw) // RAW_ROWS):
        raw[((i // LANES) * RAW_ROWS + 3) * LANES + i % LANES] = float32(-60)
    for i in range(len(order)):
        at, j = (i // LANES) * RAW_ROWS * LANES + i % LANES, order[i]
        for axis in range(3):
            raw[at + axis * LANES] = log_scales[j, axis]
        raw[at + 3 * LANES] = logit_opacities[j]


@njit(**KERNEL)
def take_parameters(parameters, raw, means_m, quaternions, log_scales, logit_opacities, sh):
    """Copy blocks into arrays of the Gaussians in block order."""
    for i in range(len(means_m)):
        at, raw_at = (i // LANES) * BLOCK_FLOATS + i % LANES, (i // LANES) * RAW_ROWS * LANES + i % LANES
        for axis in range(3):
            means_m[i, axis] = parameters[at + (MEAN + axis) * LANES]
            log_scales[i, axis] = raw[raw_at + axis * LANES]
        for axis in range(4):
            quaternions[i, axis] = parameters[at + (QUATERNION + axis) * LANES]
        logit_opacities[i] = raw[raw_at + 3 * LANES]
        for band in range(sh.shape[1]):
            for channel in range(3):
                sh[i, band, channel] = parameters[at + (SH + 3 * band + channel) * LANES]


@njit(parallel=True, **KERNEL)
def move_lanes(given, lanes, taken):
    """Copy lanes: taken's lane i = given's lane lanes[i], all rows; 0 where that is −1."""
    for i in prange(len(lanes)):
        at = (i // LANES) * BLOCK_FLOATS + i % LANES
        j = lanes[i]
        for row in range(ROWS):
            if j < 0:
                taken[at + row * LANES] = float32(0)
            else:
                taken[at + row * LANES] = given[(j // LANES) * BLOCK_FLOATS + j % LANES + row * LANES]


@njit(parallel=True, **KERNEL)
def add_screen_gradient(visible, screen, scale, gradient_sum, gradient_count):
    """Add the length of dL/d(centre), times ``scale``, of every visible Gaussian."""
    size = len(visible)
    for i in prange(size):
        if visible[i]:
            gradient_sum[i] += scale * np.sqrt(screen[i] * screen[i] + screen[size + i] * screen[size + i])
            gradient_count[i] += float32(1)
