# SPDX-License-Identifier: Apache-2.0
"""Converts the kernels' planes (5, H, W: red, green, blue, depth sum, transmittance) to images and back."""

from __future__ import annotations

import numpy as np
from numba import float32, njit, prange

from studiorecon.splatting.conventions import KERNEL

DEPTH_ALPHA_MIN = np.float32(1e-4)
"""Below this alpha a pixel has no expected depth."""


@njit(parallel=True, **KERNEL)
def planes_to_images(planes, rgb, alpha, depth_m):
    """Fill rgb (H, W, 3), alpha (H, W) and expected depth (H, W)."""
    for y in prange(planes.shape[1]):
        for x in range(planes.shape[2]):
            for channel in range(3):
                rgb[y, x, channel] = planes[channel, y, x]
            covered = float32(1) - planes[4, y, x]
            alpha[y, x] = covered
            depth_m[y, x] = planes[3, y, x] / covered if covered >= DEPTH_ALPHA_MIN else float32(0)


@njit(parallel=True, **KERNEL)
def gradients_into_planes(planes, by_rgb, by_alpha, by_depth, plane_gradients, behind):
    """Flat gradients by rgb, alpha and expected depth (empty means 0) → by rgb, depth sum and alpha (5, H, W).

    Each row's gradient by the background colour is added to ``behind`` (H, 3).
    """
    height, width = planes.shape[1], planes.shape[2]
    for y in prange(height):
        for x in range(width):
            at = y * width + x
            for channel in range(3):
                by_channel = by_rgb[3 * at + channel] if len(by_rgb) else float32(0)
                plane_gradients[channel, y, x] = by_channel
                behind[y, channel] += planes[4, y, x] * by_channel
            plane_gradients[3, y, x] = float32(0)
            plane_gradients[4, y, x] = by_alpha[at] if len(by_alpha) else float32(0)
            covered = float32(1) - planes[4, y, x]
            if len(by_depth) and covered >= DEPTH_ALPHA_MIN:
                share = by_depth[at] / covered
                plane_gradients[3, y, x] = share
                plane_gradients[4, y, x] -= share * planes[3, y, x] / covered
