# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of a number: bootstrap intervals over frames and scenes, paired differences of runs, spread over seeds.

Neighbouring frames are similar, so frames are drawn in blocks (circular moving blocks of √T frames, the same blocks for
every camera). Drawing single frames would give intervals several times too narrow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

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


def paired_difference(scenes: Mapping[str, tuple[Frames, Frames]], bootstrap: Bootstrap) -> dict[str, Any]:
    """Second minus first run, paired per scene, camera and frame: difference, interval, unit drawn, number of pairs.

    Several scenes are drawn as wholes, for a statement about scenes; one scene's frames are drawn in blocks, for a
    statement about that scene. ``interval`` and ``significant`` are None when there is too little to draw from. A
    difference whose interval contains 0 is not significant.
    """
    tables = {scene: _difference(*pair) for scene, pair in scenes.items()}
    tables = {scene: table for scene, table in tables.items() if np.isfinite(table).any()}
    if not tables:
        return {"difference": None, "interval": None, "significant": None, "drawn": None, "pairs": 0}
    means = np.array([_mean(table) for table in tables.values()])
    if len(tables) >= _FEWEST_BLOCKS:
        rng, drawn = np.random.default_rng(bootstrap.seed), "scenes"
        draws = means[rng.integers(0, len(means), (bootstrap.samples, len(means)))].mean(axis=1)
    elif len(tables) == 1:
        draws, drawn = _drawn_means(next(iter(tables.values())), bootstrap), "blocks of frames"
    else:
        draws, drawn = None, None
    interval = None if draws is None else _interval(draws)
    return {
        "difference": float(means.mean()),
        "interval": interval,
        "significant": None if interval is None else not interval[0] <= 0 <= interval[1],
        "drawn": drawn,
        "pairs": int(sum(np.isfinite(table).sum() for table in tables.values())),
    }


def over_seeds(values: Sequence[float | None]) -> dict[str, Any]:
    """Mean and half range of one number over runs of different seeds; the half range is None below three runs."""
    used = [value for value in values if value is not None and np.isfinite(value)]
    if not used:
        return {"mean": None, "half_range": None, "seeds": 0}
    half_range = (max(used) - min(used)) / 2 if len(used) >= 3 else None
    return {"mean": float(np.mean(used)), "half_range": half_range, "seeds": len(used)}


def _table(frames: Frames) -> np.ndarray:
    """(cameras, frames) float64, NaN where there is no measurement or a camera has fewer frames."""
    longest = max((len(values) for values in frames.values()), default=0)
    table = np.full((len(frames), longest), np.nan)
    for row, values in zip(table, frames.values()):
        row[: len(values)] = [np.nan if value is None else value for value in values]
    table[~np.isfinite(table)] = np.nan
    return table


def _difference(first: Frames, second: Frames) -> np.ndarray:
    common = [camera for camera in first if camera in second]
    return (
        _table({c: second[c] for c in common}) - _table({c: first[c] for c in common}) if common else np.zeros((0, 0))
    )


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


def _mean(table: np.ndarray) -> float:
    """Mean over the measured cameras of their mean over frames."""
    rows = [row[np.isfinite(row)] for row in table]
    return float(np.mean([row.mean() for row in rows if len(row)]))


def _interval(draws: np.ndarray) -> list[float]:
    low, high = np.quantile(draws, [(1 - _SHARE) / 2, (1 + _SHARE) / 2])
    return [float(low), float(high)]
