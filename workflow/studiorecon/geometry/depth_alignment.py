# SPDX-License-Identifier: Apache-2.0
"""Fits a predicted depth map to a measured one: scale, and a shift where the scene's relief supports one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require
from studiorecon.geometry.statistics import SIGMA_OF_MAD

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# Relief (robust spread over median) below which shift and scale cannot be separated (D02).
_MIN_RELIEF = 0.05
_MIN_PIXELS = 50
# Number of pixel pairs that vote for the slope; more do not move their median.
_PAIRS = 20000
# Huber's limit in robust sigmas.
_HUBER = 1.5


@dataclass(frozen=True)
class Alignment:
    """aligned = scale · predicted + shift_m; ``model`` is "affine", "scale" or "undetermined" (scale 1, shift 0)."""

    scale: float
    shift_m: float
    model: str

    def apply(self, predicted: Num[np.ndarray, " ..."], near_m: float) -> Num[np.ndarray, " ..."]:
        """Aligned depth in metres; 0 where the prediction is unknown, not finite, or nearer than ``near_m`` (D04)."""
        known = np.isfinite(predicted) & (predicted > 0)
        aligned = self.scale * np.where(known, predicted, 1.0) + self.shift_m
        return np.where(known & (aligned >= near_m), aligned, 0.0)


def align_depth(
    predicted: Num[np.ndarray, " ..."],
    reference_m: Num[np.ndarray, " ..."],
    static: Bool[np.ndarray, " ..."],
    rng: np.random.Generator,
) -> Alignment:
    """Robust fit of ``predicted`` to ``reference_m`` (metres) over ``static`` pixels, all of one shape.

    In depth, not in disparity, whose fit to near pixels turns far ones negative (D03). Theil-Sen start and Huber rounds
    tolerate up to 45 % of moved pixels (D01); more need the mask. Both maps are noisy in proportion to their scale, so
    the slope is the geometric mean of the fits in both directions: one alone flattens it (D07). Values that are not
    finite or not positive count as unknown (D05). A scale ≤ 0 is never returned. Raises ValueError for unequal shapes.
    """
    require("reference_m", reference_m, np.shape(predicted))
    require("static", static, np.shape(predicted))
    usable = (
        np.asarray(static, dtype=bool)
        & np.isfinite(predicted)
        & np.isfinite(reference_m)
        & (predicted > 0)
        & (reference_m > 0)
    )
    x, y = predicted[usable].astype(np.float64), reference_m[usable].astype(np.float64)
    if len(x) < _MIN_PIXELS:
        return Alignment(1.0, 0.0, "undetermined")
    ratio = Alignment(float(np.median(y / x)), 0.0, "scale")
    if min(_relief(x), _relief(y)) < _MIN_RELIEF:
        return ratio
    first, second = rng.integers(0, len(x), (2, _PAIRS))
    steps_x, steps_y = x[first] - x[second], y[first] - y[second]
    # Only pairs with a difference in depth: the slope of near-equal depths is noise.
    apart = np.abs(steps_x) > np.median(np.abs(x - np.median(x)))
    if not apart.any():
        return ratio
    scale = float(np.median(steps_y[apart] / steps_x[apart]))
    if scale <= 0:
        return ratio
    shift = float(np.median(y - scale * x))
    for _ in range(20):
        residual = (y - scale * x - shift) / np.sqrt(1 + scale**2)
        sigma = max(SIGMA_OF_MAD * float(np.median(np.abs(residual))), 1e-9)
        size = np.abs(residual) / sigma
        # Huber, then nothing beyond twice its limit: Huber alone bounds an outlier's pull but never ends it.
        weight = np.where(size < 2 * _HUBER, np.minimum(1, _HUBER / np.maximum(size, 1e-12)), 0)
        mean_x, mean_y = np.average(x, weights=weight), np.average(y, weights=weight)
        spread_x = np.average((x - mean_x) ** 2, weights=weight)
        spread_y = np.average((y - mean_y) ** 2, weights=weight)
        together = np.average((x - mean_x) * (y - mean_y), weights=weight)
        if together <= 0:
            return ratio
        scale = float(np.sqrt(spread_y / spread_x))
        shift = float(mean_y - scale * mean_x)
    return Alignment(scale, shift, "affine")


def shared_alignment(frames: Sequence[Alignment]) -> Alignment:
    """One alignment for a static camera: median scale and shift of its frames against flicker (D06, U22).

    Affine when most determined frames are; undetermined without any.
    """
    known = [f for f in frames if f.model != "undetermined"]
    affine = [f for f in known if f.model == "affine"]
    if not known:
        return Alignment(1.0, 0.0, "undetermined")
    chosen = affine if 2 * len(affine) > len(known) else [f for f in known if f.model == "scale"] or known
    return Alignment(
        float(np.median([f.scale for f in chosen])), float(np.median([f.shift_m for f in chosen])), chosen[0].model
    )


def _relief(depth_m: np.ndarray) -> float:
    low, middle, high = np.percentile(depth_m, [10, 50, 90])
    return float((high - low) / middle)
