# SPDX-License-Identifier: Apache-2.0
"""Gaussians in the kernels' layout: blocks of sixteen, a parameter a row of sixteen floats, in Morton order if it pays.

One block is 59 consecutive cache lines (mean, scale, quaternion, opacity, harmonics), so projection, its gradient and
Adam are plain vector loads, and a block with nothing visible costs nothing. In Morton order, neighbours in space share
blocks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import float32, njit, prange

from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.conventions import BLOCK_FLOATS, KERNEL, LANES, MEAN, OPACITY, QUATERNION, SCALE, SH

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Shaped


@dataclass(frozen=True)
class BlockedGaussians:
    """Parameter blocks with activated scales and opacities.

    Attributes:
        parameters: (blocks · 59 · 16,) float32; the padding of the last block has opacity 0.
        count: how many Gaussians; the i-th of ``order`` is lane i % 16 of block i // 16.
        degree: spherical harmonics degree; higher rows are neither read nor written.
    """

    parameters: Float[np.ndarray, " P"]
    count: int
    degree: int

    @property
    def padded(self) -> int:
        return len(self.parameters) // BLOCK_FLOATS * LANES


def aligned_zeros(count: int, dtype: type = np.float32) -> Shaped[np.ndarray, " C"]:
    """Zeros that start at a cache line."""
    size = count * np.dtype(dtype).itemsize
    raw = np.zeros(size + 64, np.uint8)
    start = -raw.ctypes.data % 64
    return raw[start : start + size].view(dtype)


def padded_count(count: int) -> int:
    """``count`` rounded up to whole blocks; never 0, so that an empty set takes the same path."""
    return max(LANES, -(-count // LANES) * LANES)


def block(
    gaussians: Gaussians, order: Integer[np.ndarray, " N"] | None = None, within: Float[np.ndarray, " P"] | None = None
) -> BlockedGaussians:
    """Parameter blocks of the Gaussians in ``order`` (None: as given), in the memory ``within`` if it has their
    size."""
    order = np.arange(gaussians.count) if order is None else order
    size = padded_count(gaussians.count) * (BLOCK_FLOATS // LANES)
    parameters = within if within is not None and len(within) == size else aligned_zeros(size)
    blocked = BlockedGaussians(parameters, gaussians.count, gaussians.sh_degree)
    arrays = (gaussians.means_m, gaussians.quaternions, gaussians.log_scales, gaussians.logit_opacities, gaussians.sh)
    fill_blocks(*arrays, np.ascontiguousarray(order, np.int64), parameters)
    return blocked


def morton_order(means_m: Float[np.ndarray, "N 3"]) -> Integer[np.ndarray, " N"]:
    """Permutation that sorts means along a Z-order curve of 1024³ cells over their middle 98 %; non-finite ones
    last."""
    finite = np.isfinite(means_m).all(axis=1)
    if not finite.any():
        return np.arange(len(means_m))
    low, high = np.quantile(means_m[finite].astype(np.float64), (0.01, 0.99), axis=0)
    cells = np.clip((np.nan_to_num(means_m) - low) / np.maximum(high - low, 1e-9), 0, 1) * 1023
    code = np.zeros(len(means_m), np.uint64)
    for axis in range(3):
        spread = cells[:, axis].astype(np.uint64)
        for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
            spread = (spread | (spread << np.uint64(shift))) & np.uint64(mask)
        code |= spread << np.uint64(axis)
    code[~finite] = np.iinfo(np.uint64).max
    return np.argsort(code, kind="stable")


@njit(**KERNEL)
def fill_blocks(means_m, quaternions, log_scales, logit_opacities, sh, order, parameters):
    """Gaussians → blocks with activated scales and opacities; padding lanes have opacity 0, unit scale, no rotation."""
    count, bands = len(order), sh.shape[1]
    for block_index in range(len(parameters) // BLOCK_FLOATS):
        base = block_index * BLOCK_FLOATS
        for lane in range(LANES):
            at, i = base + lane, block_index * LANES + lane
            if i >= count:
                for row in range(BLOCK_FLOATS // LANES):
                    parameters[at + row * LANES] = float32(0)
                for axis in range(3):
                    parameters[at + (SCALE + axis) * LANES] = float32(1)
                parameters[at + QUATERNION * LANES] = float32(1)
                continue
            j = order[i]
            for axis in range(3):
                parameters[at + (MEAN + axis) * LANES] = means_m[j, axis]
                parameters[at + (SCALE + axis) * LANES] = math.exp(log_scales[j, axis])
            for axis in range(4):
                parameters[at + (QUATERNION + axis) * LANES] = quaternions[j, axis]
            parameters[at + OPACITY * LANES] = float32(1) / (float32(1) + math.exp(-logit_opacities[j]))
            for band in range(bands):
                for channel in range(3):
                    parameters[at + (SH + 3 * band + channel) * LANES] = sh[j, band, channel]


@njit(parallel=True, **KERNEL)
def take_gradients(
    gradient, parameters, visible, screen, means_m, quaternions, log_scales, logit_opacities, sh, screen_norm
):
    """Gradient blocks → arrays in block order, by log scale and logit opacity; 0 for invisible Gaussians."""
    count, bands, size = len(means_m), sh.shape[1], len(visible)
    for block_index in prange(size // LANES):
        for lane in range(min(LANES, count - block_index * LANES)):
            at, i = block_index * BLOCK_FLOATS + lane, block_index * LANES + lane
            shown = visible[i] != 0
            for axis in range(3):
                row = (SCALE + axis) * LANES
                means_m[i, axis] = gradient[at + (MEAN + axis) * LANES] if shown else float32(0)
                log_scales[i, axis] = gradient[at + row] * parameters[at + row] if shown else float32(0)
            for axis in range(4):
                quaternions[i, axis] = gradient[at + (QUATERNION + axis) * LANES] if shown else float32(0)
            opacity = parameters[at + OPACITY * LANES]
            slope = opacity * (float32(1) - opacity)
            logit_opacities[i] = gradient[at + OPACITY * LANES] * slope if shown else float32(0)
            for band in range(bands):
                for channel in range(3):
                    sh[i, band, channel] = gradient[at + (SH + 3 * band + channel) * LANES] if shown else float32(0)
            dx, dy = screen[i], screen[size + i]
            screen_norm[i] = math.sqrt(dx * dx + dy * dy) if shown else float32(0)
