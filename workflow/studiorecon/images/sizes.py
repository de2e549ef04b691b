# SPDX-License-Identifier: Apache-2.0
"""Resamples pictures to the sizes of networks, in numpy alone, because stages that run without torch use them as well.

The filter is PIL's and torch's (``antialias=True``), on which networks were trained. kornia's ``resize`` with antialias
blurs with a Gaussian first: making noise smaller, it differs by up to 80 levels of 255.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Num, Shaped


def resample(picture: Num[np.ndarray, "H W ..."], hw: tuple[int, int]) -> Float[np.ndarray, "h w ..."]:
    """A picture at another size, float32, by a triangle filter as wide as the larger of an input and an output pixel.

    Half-pixel centres: the picture's borders stay in place. At its own size the picture is returned unchanged.
    """
    taken = picture.astype(np.float32)
    for axis, size in enumerate(hw):
        if taken.shape[axis] != size:
            weights = _shares(taken.shape[axis], size, 0.0, taken.shape[axis] / size)
            taken = _along(axis, taken, weights / weights.sum(axis=1, keepdims=True))
    return np.ascontiguousarray(taken)


def corner_shares(count: int, size: int) -> Float[np.ndarray, "size count"]:
    """Float32 share of ``count`` nodes in each of ``size`` pixels, linear, corners aligned (torch's
    ``align_corners``)."""
    place = np.linspace(0, count - 1, size)[:, None]
    return np.maximum(1 - np.abs(place - np.arange(count)), 0).astype(np.float32)


def resample_corners(values: Num[np.ndarray, "H W ..."], hw: tuple[int, ...]) -> Float[np.ndarray, "h w ..."]:
    """A map at another size, float32, bilinear, by ``corner_shares``."""
    taken = values.astype(np.float32)
    for axis, size in enumerate(hw):
        taken = _along(axis, taken, corner_shares(taken.shape[axis], size))
    return np.ascontiguousarray(taken)


def sample_part(
    picture: Num[np.ndarray, "H W ..."], hw: tuple[int, int], start: tuple[float, float], step: float
) -> tuple[Float[np.ndarray, "h w ..."], Float[np.ndarray, "h w"]]:
    """A part of a picture, float32, 0 outside of it, and the share of every pixel that is inside.

    Pixel (i, j) shows the picture around row ``start[0] + (i + 0.5) * step`` and column ``start[1] + (j + 0.5) *
    step``.
    """
    taken, share = picture.astype(np.float32), np.ones(hw, np.float32)
    for axis, size in enumerate(hw):
        weights = _shares(taken.shape[axis], size, start[axis], step)
        inside = weights.sum(axis=1)
        taken = _along(axis, taken, weights / np.maximum(inside, 1e-6)[:, None])
        share *= np.expand_dims(inside, 1 - axis)
    return np.ascontiguousarray(taken), np.minimum(share, 1)


def sample_part_nearest(
    values: Shaped[np.ndarray, "H W ..."], hw: tuple[int, int], start: tuple[float, float], step: float
) -> Shaped[np.ndarray, "h w ..."]:
    """As ``sample_part``, but every pixel has the value of the pixel that contains its centre; 0 outside."""
    places = [np.floor(first + (np.arange(size) + 0.5) * step).astype(np.int64) for first, size in zip(start, hw)]
    inside = [(place >= 0) & (place < size) for place, size in zip(places, values.shape[:2])]
    rows, columns = (np.clip(place, 0, size - 1) for place, size in zip(places, values.shape[:2]))
    both = inside[0][:, None] & inside[1]
    return np.where(both.reshape(*hw, *[1] * (values.ndim - 2)), values[rows[:, None], columns], values.dtype.type(0))


def _along(axis: int, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return np.moveaxis(np.tensordot(weights, values, axes=(1, axis)), 0, axis)


def _shares(before: int, after: int, start: float, step: float) -> np.ndarray:
    """(after, before) float32 triangle weights; a row sums to the share of its triangle that is inside the input."""
    reach = max(step, 1.0)
    beyond = int(np.ceil(reach)) + 1
    centres = start + (np.arange(after) + 0.5) * step
    places = np.arange(before) + 0.5
    share = np.maximum(1 - np.abs(places - centres[:, None]) / reach, 0)
    around = centres[:, None] - (np.round(centres) - beyond + 0.5)[:, None] - np.arange(2 * beyond)
    whole = np.maximum(1 - np.abs(around) / reach, 0).sum(axis=1)
    return (share / whole[:, None]).astype(np.float32)


def resample_nearest(values: Shaped[np.ndarray, "H W ..."], hw: tuple[int, int]) -> Shaped[np.ndarray, "h w ..."]:
    """A map at another size without averaging, for depth and labels: every pixel has the value at its centre."""
    rows, columns = (
        ((np.arange(size) + 0.5) * before / size).astype(np.int64) for size, before in zip(hw, values.shape[:2])
    )
    return values[rows[:, None], columns]


def pad_to_multiple(picture: Shaped[np.ndarray, "H W ..."], multiple: int) -> Shaped[np.ndarray, "h w ..."]:
    """The picture with its last row and column repeated until both sides are multiples of ``multiple``."""
    missing = [-side % multiple for side in picture.shape[:2]]
    return np.pad(picture, [(0, missing[0]), (0, missing[1])] + [(0, 0)] * (picture.ndim - 2), mode="edge")


def as_float(picture: Num[np.ndarray, "H W 3"]) -> Float[np.ndarray, "H W 3"]:
    """RGB, float32 in [0, 1], of a uint8 or float picture. Raises ValueError if it is no colour picture."""
    if picture.ndim != 3 or picture.shape[2] != 3 or not picture.size:
        raise ValueError(f"picture has shape {picture.shape}, expected (H, W, 3)")
    if picture.dtype == np.uint8:
        return picture.astype(np.float32) / np.float32(255)
    return np.clip(np.nan_to_num(picture), 0, 1).astype(np.float32)
