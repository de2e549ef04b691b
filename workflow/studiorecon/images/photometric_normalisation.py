# SPDX-License-Identifier: Apache-2.0
"""Divides light that changes over time out of a static camera's pictures.

Swinging lamps and automatic exposure change the whole picture at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num

# Number of grid pixels that represent the picture; grey levels between which a camera still measures brightness.
_PIXELS, _DARKEST, _BRIGHTEST = 6000, 12, 243
# A picture needs at least so many of these pixels free and unsaturated to measure its light.
_MIN_PIXELS = 50
STEADY = 0.02
"""Pictures whose brightness differs by less than this share are in one light: noise and people make as much."""


def light_factors(frames: Integer[np.ndarray, "T H W 3"], free: Bool[np.ndarray, "T H W"]) -> Float[np.ndarray, "T 3"]:
    """Brightness of each uint8 picture over the clip's median, per channel; 1 where too few pixels are usable.

    Only pixels ``free`` of people count. A gain of light is treated as a gain of grey levels, nearly true for a
    camera's curve. Medians over pixels and over time ignore moving objects. Raises ValueError if the shapes do not
    match.
    """
    require("free", free, ("T", "H", "W"), require("frames", frames, ("T", "H", "W", 3)))
    step = max(1, int(np.sqrt(frames.shape[1] * frames.shape[2] / _PIXELS)))
    grid = (slice(None), slice(step // 2, None, step), slice(step // 2, None, step))
    levels = frames[grid].reshape(len(frames), -1, 3).astype(np.float64)
    valid = free[grid].reshape(len(frames), -1) & ((levels > _DARKEST) & (levels < _BRIGHTEST)).all(axis=-1)
    usual = valid.sum(axis=0) >= len(frames) / 2
    levels, valid = np.log(np.maximum(levels[:, usual], 1.0)), valid[:, usual]
    is_measured = valid.sum(axis=1) >= _MIN_PIXELS
    factors = np.ones((len(frames), 3))
    seen = valid[is_measured].any(axis=0)
    if not seen.any():
        return factors
    logs = np.where(valid[..., None], levels, np.nan)[is_measured][:, seen]
    gains = np.zeros((len(logs), 3))
    for _ in range(3):
        room = np.nanmedian(logs - gains[:, None], axis=0)
        gains = np.nanmedian(logs - room, axis=1)
        gains -= np.median(gains, axis=0)
    factors[is_measured] = np.exp(gains)
    return factors


def normalise_light(
    frames: Integer[np.ndarray, "T H W 3"], factors: Num[np.ndarray, "T 3"]
) -> Integer[np.ndarray, "T H W 3"]:
    """Pictures divided by their ``factors``; the same array where all are 1."""
    if np.abs(np.log(factors)).max(initial=0.0) <= STEADY:
        return frames
    even = np.empty_like(frames)
    levels = np.arange(256)[:, None]
    for picture, factor, out in zip(frames, factors, even):
        table = np.clip(np.rint(levels / factor), 0, 255).astype(np.uint8)
        for channel in range(3):
            out[..., channel] = table[picture[..., channel], channel]
    return even
