# SPDX-License-Identifier: Apache-2.0
"""Motion of the camera and changes of light, from the room's own pixels in blocks, without people."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require
from studiorecon.geometry.statistics import SIGMA_OF_MAD
from studiorecon.images.exposure import BRIGHTEST, DARKEST

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Blocks per side, fewest usable blocks, and the texture in grey levels per pixel below which a block gives no flow.
_BLOCKS, _MIN_BLOCKS, _MIN_TEXTURE = 6, 6, 1.5
# Gauss-Newton steps per block; phase correlation gives the start.
_STEPS = 3


def block_shifts(
    reference: Integer[np.ndarray, "H W 3"], picture: Integer[np.ndarray, "H W 3"], free: Bool[np.ndarray, "H W"]
) -> Float[np.ndarray, "B 2"]:
    """Shift in px of every block of ``picture`` against ``reference``, where ``free``; NaN without texture.

    Lucas-Kanade with a gain and an offset per block, so that changes of light do not count as motion; started by phase
    correlation.
    """
    require("picture", picture, ("H", "W", 3))
    require("free", free, picture.shape[:2])
    first, second = (
        cv2.GaussianBlur(cv2.cvtColor(p, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 1.0)
        for p in (reference, picture)
    )
    height, width = first.shape
    window = cv2.createHanningWindow((width, height), cv2.CV_32F) * free
    (dx, dy), response = cv2.phaseCorrelate((first - first.mean()) * window, (second - second.mean()) * window)
    start = np.array([dx, dy]) if response > 0.1 and np.hypot(dx, dy) < 0.1 * width else np.zeros(2)
    shifts = np.full((_BLOCKS * _BLOCKS, 2), np.nan)
    rows, columns = (np.linspace(2, n - 2, _BLOCKS + 1).astype(int) for n in (height, width))
    gradient_x, gradient_y = (
        cv2.Sobel(first, cv2.CV_32F, 1, 0, scale=1 / 8),
        cv2.Sobel(first, cv2.CV_32F, 0, 1, scale=1 / 8),
    )
    for block in range(_BLOCKS * _BLOCKS):
        r, c = divmod(block, _BLOCKS)
        here = slice(rows[r], rows[r + 1]), slice(columns[c], columns[c + 1])
        use = free[here]
        if use.mean() < 0.5:
            continue
        g = np.stack([gradient_x[here][use], gradient_y[here][use]], axis=-1).astype(np.float64)
        if np.sqrt(np.linalg.eigvalsh(g.T @ g / len(g))[0]) < _MIN_TEXTURE:
            continue
        shift = start.copy()
        for _ in range(_STEPS):
            to_second = np.array([[1, 0, shift[0] + columns[c]], [0, 1, shift[1] + rows[r]]])
            moved = cv2.warpAffine(second, to_second, use.shape[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
            design = np.concatenate([-g, moved[use][:, None], np.ones((len(g), 1))], axis=1)
            step = np.linalg.lstsq(design, first[here][use].astype(np.float64), rcond=None)[0]
            shift += np.clip(-step[:2], -1, 1)
        shifts[block] = shift
    return shifts


def worst_shift(shifts: Float[np.ndarray, "T B 2"]) -> tuple[float, float]:
    """Median of ``block_shifts`` of the picture that surely moved the most, and its error, px.

    The error comes from the scatter of the blocks; NaN when too few blocks have a shift.
    """
    known = np.isfinite(shifts).all(-1)
    enough = known.sum(axis=1) >= _MIN_BLOCKS if len(shifts) else np.zeros(0, bool)
    frames = [_median_vector(f[k]) for f, k in zip(shifts[enough], known[enough])]
    return max(frames, key=lambda f: f[0] - 3 * f[1], default=(np.nan, np.nan))


def _median_vector(vectors: np.ndarray) -> tuple[float, float]:
    middle = np.median(vectors, axis=0)
    error = 1.25 * SIGMA_OF_MAD * np.median(np.abs(vectors - middle), axis=0) / np.sqrt(len(vectors))
    return float(np.hypot(*middle)), float(np.hypot(*error))


def room_brightness(
    frames: Integer[np.ndarray, "T H W 3"], free: Bool[np.ndarray, "T H W"]
) -> tuple[Float[np.ndarray, " T"], Float[np.ndarray, " T"]]:
    """Log of the room's brightness against the first frame, and its standard error; NaN where too little is visible.

    Each block contributes the middle of its densest half, so that a person may cover up to half of it. The result is
    the blocks' median and the error their scatter, because light changes in all blocks at once.
    """
    require("frames", frames, ("T", "H", "W", 3))
    require("free", free, frames.shape[:3])
    value, error = np.full(len(frames), np.nan), np.full(len(frames), np.nan)
    rows, columns = (np.linspace(0, n, _BLOCKS + 1).astype(int) for n in frames.shape[1:3])
    low, high = DARKEST * 255, BRIGHTEST * 255
    # Channel by channel: numpy is several times slower along a last axis of 3.
    usable = free.copy()
    for channel in range(3):
        usable &= (frames[..., channel] > low) & (frames[..., channel] < high)
    level = np.log(np.maximum(frames.sum(axis=-1, dtype=np.float32) / 3, 1.0))
    for t in range(len(frames)):
        middles = []
        for block in range(_BLOCKS * _BLOCKS):
            r, c = divmod(block, _BLOCKS)
            here = slice(rows[r], rows[r + 1]), slice(columns[c], columns[c + 1])
            both = usable[t][here] & usable[0][here]
            if both.sum() >= 0.25 * both.size:
                middles.append(_densest(level[t][here][both] - level[0][here][both]))
        if len(middles) >= _MIN_BLOCKS:
            value[t] = np.median(middles)
            error[t] = 1.25 * SIGMA_OF_MAD * np.median(np.abs(np.array(middles) - value[t])) / np.sqrt(len(middles))
    return value, error


def _densest(values: np.ndarray) -> float:
    """Middle of the shortest interval that contains half of the values."""
    ordered = np.sort(values)
    half = max(len(ordered) // 2, 1)
    at = int((ordered[half:] - ordered[: len(ordered) - half]).argmin()) if len(ordered) > half else 0
    return float(ordered[at : at + half + 1].mean())
