# SPDX-License-Identifier: Apache-2.0
"""Clocks of calibrated cameras made exact together: all pairs of cameras, and everybody whom they share, at once.

Pair by pair a calibration tells the frame, and little about fractions: where it is a little off, rays miss by a
constant that looks like a lag. Here every joint of every pair may miss by a constant of its own, and what is left over
all pairs is least at one set of clocks. Keypoints are never interpolated (V07): the residuals at three whole lags are a
parabola in the clocks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.clocks.agreement import HALF, Pair, reference_of, solved
from studiorecon.clocks.calibrated_lag import CalibratedPair

if TYPE_CHECKING:
    from jaxtyping import Float

# Tracks whose rays miss by more than this (median) may be two people; so many keypoints must meet, so many of a joint.
_ONE_PERSON_M, _LEAST_MEETING, _LEAST_OF_JOINT = 0.06, 60, 8
_ROUNDS, _BLOCKS, _CLIP = 3, 10, 2.0
# Errors of a detector wander for a third of a second, and with the pose: parts of a short film are not independent. On
# made films of two seconds clocks are off by twice what these scatter by.
_DEPENDENT = 2.0
# What is known this well, frames, is left alone; no clock from people is better than this.
_ENOUGH_FRAMES, _FLOOR_FRAMES = 0.1, 0.05
_CONTRADICTS = 3.0
# The sharper of two answers is the luckier one too: it must be so by this much.
_CLEARLY = 0.8
_LAGS = (-1, 0, 1)

Rays = Mapping[int, Sequence[tuple[int, np.ndarray]]]
"""camera → first row and rays (T, J, 3) of its tracks."""


@dataclass(frozen=True)
class _Meeting:
    """Gaps (3, N) of one joint of two cameras about a lag, metres, and the rows (N,) they are of."""

    gaps_m: Float[np.ndarray, "3 N"]
    row: Float[np.ndarray, " N"]


def together(
    pairs: Sequence[Pair], rays: Rays, geometry: Mapping[tuple[int, int], CalibratedPair], cameras: int, rate: float
) -> list[Pair]:
    """``pairs`` of ``cameras`` cameras, those that hang together put as pairs with their reference, each as exact as
    all of them tell; times at ``rate`` rows per second.

    ``rays``: in normalised coordinates; ``geometry``: of every two cameras (first below second) with rays. Where
    everything is known well enough, or the calibration contradicts, they stay as they are.
    """
    reference = reference_of({"": pairs}, cameras)
    known = solved("", pairs, cameras, reference, 0.0)
    members = [c for c in range(cameras) if known[c] is not None]
    offset = np.array([0.0 if p is None else p.offset_s * rate for p in known])
    sigma = np.array([0.0 if p is None else p.half_s / HALF * rate for p in known])
    inside = {ab: g for ab, g in geometry.items() if set(ab) <= set(members)}
    if sigma.max() <= _ENOUGH_FRAMES or not inside:
        return list(pairs)
    found = _exact(offset, rays, inside, reference)
    if found is None:
        return list(pairs)
    exact, scatter = found
    others = [c for c in members if c != reference]
    if any(abs(exact[c] - offset[c]) > _CONTRADICTS * np.hypot(scatter[c], sigma[c]) for c in others):
        return list(pairs)
    better = scatter < _CLEARLY * sigma
    offset, sigma = np.where(better, exact, offset), np.where(better, scatter, sigma)
    rest = [p for p in pairs if p.first not in members]
    return rest + [Pair(reference, c, float(offset[c]) / rate, float(sigma[c]) / rate) for c in others]


def _exact(
    offset: np.ndarray, rays: Rays, geometry: Mapping[tuple[int, int], CalibratedPair], reference: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """Rows by which cameras begin after the reference, and their standard deviations, NaN for those that share nobody;
    None where the rest do not hang together."""
    current, meetings, middle = offset.copy(), {}, {}
    for _ in range(_ROUNDS):
        middle = {(a, b): round(current[a] - current[b]) for a, b in geometry}
        meetings = {ab: _meetings(rays[ab[0]], rays[ab[1]], middle[ab], pair) for ab, pair in geometry.items()}
        found = _solved(meetings, middle, len(offset), reference)
        if found is None:
            return None
        current = np.where(np.isnan(found), offset, found)
    rows = [m.row for of_pair in meetings.values() for m in of_pair]
    begin, end = min(r.min() for r in rows), max(r.max() for r in rows) + 1
    parts = []
    for block in range(_BLOCKS):
        left = {ab: [_without(m, block, begin, end) for m in of_pair] for ab, of_pair in meetings.items()}
        part = _solved(left, middle, len(offset), reference)
        if part is None:
            return None
        parts.append(part)
    scatter = np.sqrt((_BLOCKS - 1) / _BLOCKS * ((np.array(parts) - np.mean(parts, axis=0)) ** 2).sum(0))
    return current, np.maximum(_DEPENDENT * scatter, _FLOOR_FRAMES)


def _meetings(
    first: Sequence[tuple[int, np.ndarray]], second: Sequence[tuple[int, np.ndarray]], lag: int, pair: CalibratedPair
) -> list[_Meeting]:
    """The gaps about a lag of all joints of everybody whom two cameras share."""
    found = []
    for begin_a, one in first:
        for begin_b, other in second:
            own = lag - (begin_b - begin_a)
            if own >= len(other) or own + len(one) <= 0:
                continue
            gaps = np.stack([pair.gaps_m(one, other, own + d) for d in _LAGS])
            there = np.isfinite(gaps).all(0)
            if there.sum() < _LEAST_MEETING or np.median(np.abs(gaps[1][there])) > _ONE_PERSON_M:
                continue
            row = begin_a + np.arange(len(one))
            found += [
                _Meeting(gaps[:, joint, j], row[joint])
                for j, joint in enumerate(there.T)
                if joint.sum() >= _LEAST_OF_JOINT
            ]
    return found


def _without(meeting: _Meeting, block: int, begin: float, end: float) -> _Meeting:
    kept = (meeting.row - begin) * _BLOCKS // (end - begin) != block
    return replace(meeting, gaps_m=meeting.gaps_m[:, kept], row=meeting.row[kept])


def _solved(
    meetings: Mapping[tuple[int, int], Sequence[_Meeting]],
    middle: Mapping[tuple[int, int], int],
    cameras: int,
    reference: int,
) -> np.ndarray | None:
    """(C,) rows by which cameras begin after the reference, where the parabolas of all pairs have their least sum;
    NaN for cameras that nothing is known of, None where the rest do not hang together."""
    normal, side = np.zeros((cameras, cameras)), np.zeros(cameras)
    for (a, b), of_pair in meetings.items():
        bend, lowest = _parabola([m.gaps_m for m in of_pair])
        if bend > 0:
            row = np.zeros(cameras)
            row[a], row[b] = 1, -1
            normal += bend * np.outer(row, row)
            side += bend * (middle[a, b] + lowest) * row
    free = [c for c in range(cameras) if c != reference and normal[c, c] > 0]
    inner = normal[np.ix_(free, free)]
    if not free or np.linalg.matrix_rank(inner) < len(free):
        return None
    found = np.full(cameras, np.nan)
    found[reference] = 0.0
    found[free] = np.linalg.solve(inner, side[free])
    return found


def _parabola(gaps_m: Sequence[Float[np.ndarray, "3 N"]]) -> tuple[float, float]:
    """How much the squared residuals of gaps bend over lags, in units of their noise, and at which lag they are least;
    (0, 0) where they do not. Every joint may miss by a constant of its own."""
    counted = [g for g in gaps_m if g.shape[1] >= _LEAST_OF_JOINT // 2]
    if not counted:
        return 0.0, 0.0
    middle = [np.median(g[1]) for g in counted]
    noise = 1.4826 * float(np.median(np.abs(np.concatenate([g[1] - m for g, m in zip(counted, middle)])))) + 1e-6
    cost = np.zeros(len(_LAGS))
    for gap, constant in zip(counted, middle):
        weight = 1 / np.maximum(1.0, np.abs(gap[1] - constant) / (_CLIP * noise))
        mean = (weight * gap).sum(1) / weight.sum()
        cost += (weight * (gap - mean[:, None]) ** 2).sum(1)
    before, at, after = cost
    bend = before - 2 * at + after
    return (float(bend) / noise**2, float(0.5 * (before - after) / bend)) if bend > 0 else (0.0, 0.0)
