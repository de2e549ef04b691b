# SPDX-License-Identifier: Apache-2.0
"""Factors of exposure and white balance that equalise the cameras, from colours of surfaces that two cameras see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require

if TYPE_CHECKING:
    from jaxtyping import Num

# Colours outside this range are clipped or noise: their ratio does not measure gains.
DARKEST, BRIGHTEST = 0.03, 0.97


@dataclass(frozen=True)
class Overlap:
    """Median log colour ratio of camera ``first`` over camera ``second`` (indices) on ``pixels`` common pixels."""

    first: int
    second: int
    log_ratio: Num[np.ndarray, " 3"]
    pixels: int


def compare_colours(
    first: int, second: int, first_rgb: Num[np.ndarray, "N 3"], second_rgb: Num[np.ndarray, "N 3"], least_pixels: int
) -> Overlap | None:
    """The overlap of two cameras from colours of the same surface points; None below ``least_pixels`` usable ones.

    Colours that are not finite are not usable. Raises ValueError if the numbers of colours differ.
    """
    require("second_rgb", second_rgb, ("N", 3), require("first_rgb", first_rgb, ("N", 3)))
    usable = ((first_rgb > DARKEST) & (first_rgb < BRIGHTEST) & (second_rgb > DARKEST) & (second_rgb < BRIGHTEST)).all(
        axis=-1
    )
    count = int(usable.sum())
    if count < max(least_pixels, 1):
        return None
    ratio = np.log(first_rgb[usable].astype(np.float64)) - np.log(second_rgb[usable].astype(np.float64))
    return Overlap(first, second, np.median(ratio, axis=0), count)


def solve_gains(cameras: int, overlaps: Sequence[Overlap]) -> Num[np.ndarray, "V 3"]:
    """Every camera's factors, geometric mean 1, that fit the overlaps in least squares; 1 without overlaps.

    Divide a photo by its factors to match the others. Without a chain of overlaps between them, each group of cameras
    has its own mean (minimum-norm solution). Raises ValueError for a ratio that is not three finite numbers.
    """
    for overlap in overlaps:
        require(f"log_ratio of cameras {overlap.first} and {overlap.second}", overlap.log_ratio, (3,), finite=True)
    if not overlaps:
        return np.ones((cameras, 3))
    weights = np.sqrt([o.pixels for o in overlaps])[:, None]
    design = np.zeros((len(overlaps), cameras))
    for row, overlap in enumerate(overlaps):
        design[row, overlap.first], design[row, overlap.second] = 1, -1
    ratios = np.stack([o.log_ratio for o in overlaps])
    # The common factor is in the null space; the minimum-norm solution sets its log to zero in every connected group.
    return np.exp(np.linalg.lstsq(design * weights, ratios * weights, rcond=1e-9)[0])
