# SPDX-License-Identifier: Apache-2.0
"""LPIPS (Zhang et al. 2018, version 0.1) around a network that somebody else brings: this project has no weights of its own.

The distance is that of unit-length features: Σ over layers of the mean over positions of Σ_c w_c (f_c − g_c)².
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from studiorecon.arrays import require

# (3, H, W) float32 in [-1, 1] → one (C, h, w) float32 array per layer.
Features = Callable[[np.ndarray], Sequence[np.ndarray]]
SMALLEST_SIDE_PX = 64
# Inside the root: a dead position has length 0, and its features then stay 0 instead of becoming NaN (numerics I06).
_EPSILON = np.float32(1e-10)


def unit_length(features: np.ndarray) -> np.ndarray:
    """(C, h, w) float32 with features of length 1 at every position; zeros stay zeros, and no width below float32 is computed in.

    The largest feature is divided out first, so that neither 1e-25 nor 1e25 leaves the range of a squared float32.
    """
    wide = np.asarray(features, np.float32)
    largest = np.abs(wide).max(axis=0, keepdims=True)
    scaled = wide / np.where(largest > 0, largest, np.float32(1))
    return scaled / np.sqrt((scaled**2).sum(axis=0, keepdims=True) + _EPSILON)


def lpips(
    prediction: np.ndarray, truth: np.ndarray, features: Features, weights: Sequence[np.ndarray], rescaled: bool = True
) -> float | None:
    """LPIPS of two (H, W, 3) uint8 pictures; None when a side is under 64 pixels.

    ``features`` is the network with its own scaling of inputs in [-1, 1]; ``weights`` the non-negative weights (C,) of its layers.
    ``rescaled=False`` feeds it [0, 1] instead, as papers of the 3DGS lineage do by mistake ("LPIPS-3DGS"): for comparison only.
    Raises ValueError when the pictures differ in size, or the layers and their weights do not fit.
    """
    require("truth", truth, ("H", "W", 3), require("prediction", prediction, ("H", "W", 3)))
    if min(truth.shape[:2]) < SMALLEST_SIDE_PX:
        return None
    total = 0.0
    layers = [features(_input(picture, rescaled)) for picture in (prediction, truth)]
    if not len(layers[0]) == len(layers[1]) == len(weights):
        raise ValueError(f"the network has {len(layers[0])} layers and {len(weights)} sets of weights were given")
    for a, b, weight in zip(*layers, weights):
        if a.shape != b.shape or weight.shape != a.shape[:1]:
            raise ValueError(f"a layer of {a.shape[0]} features needs as many weights, not {weight.shape}")
        gap = (unit_length(a) - unit_length(b)) ** 2
        total += float(np.tensordot(weight.astype(np.float64), gap, axes=(0, 0)).mean())
    return total


def _input(picture: np.ndarray, rescaled: bool) -> np.ndarray:
    unit = picture.astype(np.float32).transpose(2, 0, 1) / np.float32(255)
    return unit * np.float32(2) - np.float32(1) if rescaled else unit
