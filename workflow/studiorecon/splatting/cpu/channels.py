# SPDX-License-Identifier: Apache-2.0
"""Blends any values like colours, three channels at a time: with the colours, or again with the same lists."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit, prange

from studiorecon.splatting.conventions import KERNEL, RECORD

if TYPE_CHECKING:
    from jaxtyping import Float, Num


@njit(parallel=True, **KERNEL)
def write_record_fields(values, visible, field, splats):
    """Writes values (N, 3) into three fields of the visible splats' records (N·16), from ``field`` on."""
    for i in prange(len(values)):
        if visible[i]:
            for channel in range(3):
                splats[i * RECORD + field + channel] = values[i, channel]


@njit(parallel=True, **KERNEL)
def copy_planes(planes, first, image):
    """Copies up to three drawn planes (3 or more, H, W) into the channels of ``image`` (H, W, C) from ``first`` on."""
    height, width, channels = image.shape
    for y in prange(height):
        for x in range(width):
            for channel in range(min(3, channels - first)):
                image[y, x, first + channel] = planes[channel, y, x]


def split_into_threes(values: Num[np.ndarray, "N C"]) -> list[Float[np.ndarray, "N 3"]]:
    """(N, C) → arrays of float32, the last padded with zeros."""
    count, channels = values.shape
    if channels % 3 == 0:
        padded = np.asarray(values, np.float32)
    else:
        padded = np.zeros((count, -(-channels // 3) * 3), np.float32)
        padded[:, :channels] = values
    return [np.ascontiguousarray(padded[:, first : first + 3]) for first in range(0, padded.shape[1], 3)]
