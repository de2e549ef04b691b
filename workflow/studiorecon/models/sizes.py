# SPDX-License-Identifier: Apache-2.0
"""Pictures at the sizes that networks ask for, in numpy alone: adapters run inside images that have little else."""

from __future__ import annotations

import numpy as np


def resampled(picture: np.ndarray, hw: tuple[int, int]) -> np.ndarray:
    """(h, w, ...) float32 picture from (H, W, ...): a triangle filter, as wide as an input pixel or an output pixel, whichever is larger.

    Half-pixel centres: the picture's borders stay where they are. At its own size a picture comes back as it is.
    """
    taken = picture.astype(np.float32)
    for axis, size in enumerate(hw):
        if taken.shape[axis] != size:
            taken = np.moveaxis(np.tensordot(_weights(taken.shape[axis], size), taken, axes=(1, axis)), 0, axis)
    return np.ascontiguousarray(taken)


def _weights(before: int, after: int) -> np.ndarray:
    step = before / after
    reach = max(step, 1.0)
    centres = (np.arange(after) + 0.5) * step
    share = np.maximum(1 - np.abs(np.arange(before) + 0.5 - centres[:, None]) / reach, 0)
    return (share / share.sum(axis=1, keepdims=True)).astype(np.float32)


def nearest(values: np.ndarray, hw: tuple[int, int]) -> np.ndarray:
    """(h, w, ...) from (H, W, ...): every pixel takes the one its centre falls into; for depth and labels, which have no means."""
    rows, columns = (((np.arange(size) + 0.5) * before / size).astype(np.int64) for size, before in zip(hw, values.shape[:2]))
    return values[rows[:, None], columns]


def grown(picture: np.ndarray, multiple: int) -> np.ndarray:
    """(H', W', ...) picture with its last row and column repeated until both sides are multiples of ``multiple``."""
    missing = [-side % multiple for side in picture.shape[:2]]
    return np.pad(picture, [(0, missing[0]), (0, missing[1])] + [(0, 0)] * (picture.ndim - 2), mode="edge")


def as_float(picture: np.ndarray) -> np.ndarray:
    """(H, W, 3) float32 RGB in [0, 1] of a uint8 or float picture; ValueError for anything that is no colour picture."""
    if picture.ndim != 3 or picture.shape[2] != 3 or not picture.size:
        raise ValueError(f"picture has shape {picture.shape}, expected (H, W, 3)")
    if picture.dtype == np.uint8:
        return picture.astype(np.float32) / np.float32(255)
    return np.clip(np.nan_to_num(picture), 0, 1).astype(np.float32)
