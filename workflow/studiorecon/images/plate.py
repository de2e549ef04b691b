# SPDX-License-Identifier: Apache-2.0
"""The static background of a camera: the colour that each pixel keeps returning to, and how often it does."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numba
import numpy as np

from studiorecon.arrays import require
from studiorecon.images.encoded import write_png

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num

# Rows that are transposed to time-last order at once: bounds the copy of the clip.
_BAND = 64
# A candidate colour shared by this share of the pictures needs no rival search: no other can win.
_CLEAR_SHARE = 0.9


def noise_levels(frames: Num[np.ndarray, "T H W 3"]) -> float:
    """Standard deviation of the noise of frames in grey levels, from successive differences; at least 0.3 (rounding).

    Half the pixels must be at rest between successive frames. Raises ValueError for other shapes.
    """
    require("frames", frames, ("T", "H", "W", 3))
    if len(frames) < 2:
        return 1.0
    pairs = np.linspace(0, len(frames) - 2, min(len(frames) - 1, 8)).astype(int)
    change = np.stack([np.abs(frames[i + 1, ::2, ::2].astype(np.int16) - frames[i, ::2, ::2]) for i in pairs])
    # The median of rounded values is a staircase; the mean of the lower half follows the noise smoothly. It is 0.325 of
    # the standard deviation of a difference (half-normal below its median), which is sqrt(2) of the noise.
    flat = np.partition(change.ravel(), change.size // 2)[: change.size // 2]
    return max(float(flat.mean()) / 0.325 / np.sqrt(2), 0.3)


def temporal_modes(
    frames: Num[np.ndarray, "T H W 3"], free: Bool[np.ndarray, "T H W"], agree_levels: float
) -> tuple[Float[np.ndarray, "H W 3"], Integer[np.ndarray, "H W"], Integer[np.ndarray, "H W"]]:
    """The colour most pictures agree on where the pixel is ``free``, how many agree, and how many on the best other
    one.

    Colours whose every channel differs by at most ``agree_levels`` are the same surface. The colour is the mean of the
    agreeing ones, float32, 0..255 (0 where never free). Costs at most T² comparisons per pixel. Raises ValueError if
    the shapes do not match or frames are not uint8.
    """
    require("free", free, ("T", "H", "W"), require("frames", frames, ("T", "H", "W", 3)))
    if frames.dtype != np.uint8:
        raise ValueError(f"frames are {frames.dtype}, expected uint8: agreement is in grey levels")
    height, width = frames.shape[1:3]
    colour = np.zeros((height, width, 3), np.float32)
    votes, rival = np.zeros((height, width), np.int32), np.zeros((height, width), np.int32)
    for top in range(0, height, _BAND):
        rows = slice(top, top + _BAND)
        band = np.ascontiguousarray(frames[:, rows].transpose(1, 2, 0, 3))
        unoccupied = np.ascontiguousarray(free[:, rows].transpose(1, 2, 0))
        _modes(band, unoccupied, np.int16(round(agree_levels)), colour[rows], votes[rows], rival[rows])
    return colour, votes, rival


@numba.njit(cache=True, nogil=True)
def _modes(values, free, tolerance, colour, votes, rival):
    height, width, count, _ = values.shape
    for y in range(height):
        for x in range(width):
            available = 0
            for t in range(count):
                available += free[y, x, t]
            if available == 0:
                continue
            best, best_votes = -1, 0
            for step in range(count):
                t = (step + count // 2) % count
                if not free[y, x, t]:
                    continue
                agreeing = 0
                for s in range(count):
                    if free[y, x, s] and _same(values[y, x, s], values[y, x, t], tolerance):
                        agreeing += 1
                if agreeing > best_votes:
                    best, best_votes = t, agreeing
                if best_votes >= _CLEAR_SHARE * available:
                    break
            total = np.zeros(3, np.float64)
            for s in range(count):
                if free[y, x, s] and _same(values[y, x, s], values[y, x, best], tolerance):
                    for c in range(3):
                        total[c] += values[y, x, s, c]
            for c in range(3):
                colour[y, x, c] = total[c] / best_votes
            votes[y, x] = best_votes
            if best_votes < _CLEAR_SHARE * available:
                rival[y, x] = _rival(values[y, x], free[y, x], values[y, x, best], tolerance)


@numba.njit(cache=True, nogil=True)
def _rival(values, free, winner, tolerance):
    """Most votes for any colour not shared with the winner."""
    count, most = len(values), 0
    for t in range(count):
        if not free[t] or _same(values[t], winner, 2 * tolerance):
            continue
        agreeing = 0
        for s in range(count):
            if free[s] and _same(values[s], values[t], tolerance):
                agreeing += 1
        most = max(most, agreeing)
    return most


@numba.njit(cache=True, nogil=True, inline="always")
def _same(a, b, tolerance):
    return (
        abs(np.int16(a[0]) - np.int16(b[0])) <= tolerance
        and abs(np.int16(a[1]) - np.int16(b[1])) <= tolerance
        and abs(np.int16(a[2]) - np.int16(b[2])) <= tolerance
    )


def write_plate(path: Path, rgb: Num[np.ndarray, "H W 3"], measured: Bool[np.ndarray, "H W"]) -> None:
    """Write a clean plate as RGBA PNG, alpha 255 where ``measured``, else a transparent black.

    Raises ValueError for a mask of another size.
    """
    require("measured", measured, ("H", "W"), require("rgb", rgb, ("H", "W", 3)))
    alpha = np.where(measured, np.uint8(255), np.uint8(0))
    write_png(path, np.concatenate([np.where(measured[..., None], rgb, np.uint8(0)), alpha[..., None]], axis=-1))
