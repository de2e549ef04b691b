# SPDX-License-Identifier: Apache-2.0
"""Estimates with their confidence intervals: shares, means, medians, and the largest of several estimates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Num

# Standard errors on either side: 95 % for one number, and 99.7 % for the worst of several cameras.
_ONE, _WORST = 2.0, 3.0
SIGMA_OF_MAD = 1.4826
"""Standard deviation of normal errors over their median absolute deviation."""


@dataclass(frozen=True)
class Estimate:
    """A value and its interval (low, high); None for both without data. ``which`` names the source of the value."""

    value: float | None
    interval: tuple[float, float] | None
    which: int = 0


NOTHING = Estimate(None, None, -1)


def share_estimate(hits: int, count: int, independent: float | None = None) -> Estimate:
    """Share ``hits`` of ``count``, with Wilson's interval for ``independent`` samples (all); None without samples."""
    if count <= 0:
        return NOTHING
    n, p = max(float(independent if independent is not None else count), 1.0), hits / count
    z2 = _ONE**2 / n
    middle, half = (p + z2 / 2) / (1 + z2), np.sqrt(z2 * (p * (1 - p) + z2 / 4)) / (1 + z2)
    return Estimate(p, (float(min(max(middle - half, 0.0), p)), float(max(min(middle + half, 1.0), p))))


def median_estimate(values: Num[np.ndarray, " N"], least: int) -> Estimate:
    """Median of the finite ``values`` with its standard error, 1.25 robust sigmas over √N; None below ``least``."""
    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    if len(known) < max(least, 2):
        return NOTHING
    middle = float(np.median(known))
    error = 1.25 * SIGMA_OF_MAD * float(np.median(np.abs(known - middle))) / np.sqrt(len(known))
    return Estimate(middle, (middle - _ONE * error, middle + _ONE * error))


def mean_estimate(values: Num[np.ndarray, " N"], least: int) -> Estimate:
    """Mean of the finite ``values`` with its standard error; None below ``least``, which is 2 or more."""
    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    if len(known) < max(least, 2):
        return NOTHING
    middle, error = float(known.mean()), float(known.std(ddof=1) / np.sqrt(len(known)))
    return Estimate(middle, (middle - _ONE * error, middle + _ONE * error))


def largest_estimate(
    values: Sequence[float] | Num[np.ndarray, " N"], errors: Sequence[float] | Num[np.ndarray, " N"]
) -> Estimate:
    """The largest magnitude of several estimates with standard errors; ones that are not finite take no part.

    The lower end is the best lower end of any of them, the upper end the worst upper end.
    """
    size, error = np.abs(np.asarray(values, dtype=np.float64)), np.asarray(errors, dtype=np.float64)
    known = np.flatnonzero(np.isfinite(size) & np.isfinite(error))
    if not len(known):
        return NOTHING
    low, high = size[known] - _WORST * error[known], size[known] + _WORST * error[known]
    which = int(known[low.argmax() if low.max() > 0 else size[known].argmax()])
    return Estimate(float(size[which]), (float(max(low.max(), 0.0)), float(high.max())), which)


def peak_position(three: Num[np.ndarray, " 3"]) -> float:
    """Where the parabola through three neighbouring values is highest, in steps from the middle one, the largest."""
    before, at, after = (float(x) for x in three)
    bend = before - 2 * at + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0
