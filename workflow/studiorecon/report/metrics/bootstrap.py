# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of a number: bootstrap intervals over frames, of a mean and of the difference of two runs.

Neighbouring frames are similar, so frames are drawn in blocks (circular moving blocks of √T frames, the same blocks for
every camera). Drawing single frames would give intervals several times too narrow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

# Fewer blocks than this do not show how much blocks differ.
_FEWEST_BLOCKS = 4
_SHARE = 0.95

Frames = Mapping[str, Sequence[float | None]]


@dataclass(frozen=True)
class Bootstrap:
    """Number of resamplings of the frames, and the seed of the draws."""

    samples: int
    seed: int


def mean_interval(frames: Frames, bootstrap: Bootstrap) -> list[float] | None:
    """95 % interval of the mean over frames, then cameras; None when there are too few frames.

    ``frames`` maps camera → value per frame, None where it was not measured.
    """
    means = _drawn_means(_table(frames), bootstrap)
    return None if means is None else _interval(means)


def difference_interval(first: Frames, second: Frames, bootstrap: Bootstrap) -> list[float] | None:
    """95 % interval of second minus first, paired per camera and frame; None when there are too few frames."""
    common = [camera for camera in first if camera in second]
    tables = [_table({camera: run[camera] for camera in common}) for run in (first, second)]
    means = _drawn_means(tables[1] - tables[0], bootstrap) if common else None
    return None if means is None else _interval(means)


def _table(frames: Frames) -> np.ndarray:
    """(cameras, frames) float64, NaN where there is no measurement or a camera has fewer frames."""
    longest = max((len(values) for values in frames.values()), default=0)
    table = np.full((len(frames), longest), np.nan)
    for row, values in zip(table, frames.values()):
        row[: len(values)] = [np.nan if value is None else value for value in values]
    table[~np.isfinite(table)] = np.nan
    return table


def _drawn_means(table: np.ndarray, bootstrap: Bootstrap) -> np.ndarray | None:
    """(samples,) mean over cameras of the mean over redrawn frames."""
    # Frames without a measurement in any camera (the first, for temporal measures) do not count for this measure.
    table = table[:, np.isfinite(table).any(axis=0)]
    length = table.shape[1]
    block = max(1, round(np.sqrt(length)))
    blocks = -(-length // block)
    if blocks < _FEWEST_BLOCKS:
        return None
    rng = np.random.default_rng(bootstrap.seed)
    starts = rng.integers(0, length, (bootstrap.samples, blocks, 1))
    index = ((starts + np.arange(block)) % length).reshape(bootstrap.samples, -1)[:, :length]
    known = np.isfinite(table)
    # Number of times each frame was drawn: means over draws are then two matrix products.
    weight = np.zeros((bootstrap.samples, length))
    np.add.at(weight, (np.arange(bootstrap.samples)[:, None], index), 1.0)
    count = weight @ known.T.astype(np.float64)
    total = weight @ np.where(known, table, 0.0).T
    measured = count > 0
    means = np.where(measured, total / np.where(measured, count, 1), 0.0)
    cameras = measured.sum(axis=1)
    return means.sum(axis=1)[cameras > 0] / cameras[cameras > 0]


def _interval(draws: np.ndarray) -> list[float]:
    low, high = np.quantile(draws, [(1 - _SHARE) / 2, (1 + _SHARE) / 2])
    return [float(low), float(high)]
