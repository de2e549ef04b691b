# SPDX-License-Identifier: Apache-2.0
"""Combines lags between pairs of cameras to one clock per camera, if sound, people and motion agree."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

# Half of a 95 % interval in standard deviations.
HALF = 1.96
# A pair that contradicts the others by this many sigmas is left out, where there are others.
_CONTRADICTS = 4.0
# A smaller offset, frames, is not worth resampling; a smaller drift over the whole clip counts as none.
_NEGLIGIBLE_FRAMES = 0.1
_DRIFT_SIGMAS = 3.0


@dataclass(frozen=True)
class Pair:
    """One method's result for two cameras: the second one's first frame is ``offset_s`` after the first one's, by a
    common clock."""

    first: int
    second: int
    offset_s: float
    sigma_s: float
    drift_ppm: float = 0.0
    drift_sigma_ppm: float = np.inf


@dataclass(frozen=True)
class Proposal:
    """One method's result for one camera: its first frame is ``offset_s`` ± ``half_s`` (95 %) after the reference
    camera's."""

    method: str
    offset_s: float
    half_s: float
    drift_ppm: float
    drift_half_ppm: float


@dataclass(frozen=True)
class ClockVerdict:
    """The decision on a camera's proposals.

    Attributes:
        kind: "reference", "in step", "found", or "undetermined": then the camera stays as filmed.
        offset_s, half_s, drift_ppm: to be applied, with half of the 95 % interval (inf: unknown).
        method: of the chosen proposal.
        reason: why it is undetermined.
    """

    kind: str
    offset_s: float = 0.0
    half_s: float = np.inf
    drift_ppm: float = 0.0
    method: str = ""
    reason: str = ""


def choose_reference(pairs: Mapping[str, Sequence[Pair]], cameras: int) -> int:
    """The camera in most pairs; the first of several."""
    heard = np.zeros(cameras, int)
    for pair in (p for found in pairs.values() for p in found):
        heard[[pair.first, pair.second]] += 1
    return int(np.argmax(heard))


def solve_offsets(
    method: str, pairs: Sequence[Pair], cameras: int, reference: int, systematic_s: float
) -> list[Proposal | None]:
    """One proposal per camera, None where no chain of pairs leads to the reference; weighted least squares over all
    pairs.

    Pairs that contradict the rest are left out, worst first; ``systematic_s`` is a sigma of every camera that pairs do
    not contain.
    """
    left = list(pairs)
    while True:
        reached = _reached(left, cameras, reference)
        inside = [p for p in left if p.first in reached and p.second in reached]
        if not inside:
            return [None] * cameras
        offsets, covariance, rest = _least_squares(
            inside, cameras, [p.offset_s for p in inside], [p.sigma_s for p in inside], reference
        )
        loops = len(inside) - (len(reached) - 1)
        if loops > 0 and np.abs(rest).max() > _CONTRADICTS:
            left.remove(inside[int(np.argmax(np.abs(rest)))])
            continue
        break
    stretch = max(1.0, float((rest**2).sum()) / loops) if loops > 0 else 1.0
    steady = [(p, p.drift_sigma_ppm) for p in inside if np.isfinite(p.drift_sigma_ppm)]
    drifts, drift_covariance = np.zeros(cameras), np.full((cameras, cameras), np.inf)
    if len(_reached([p for p, _ in steady], cameras, reference)) == len(reached):
        drifts, drift_covariance, _ = _least_squares(
            [p for p, _ in steady], cameras, [p.drift_ppm for p, _ in steady], [s for _, s in steady], reference
        )
    found: list[Proposal | None] = [None] * cameras
    for c in reached:
        sigma = float(np.sqrt(covariance[c, c] * stretch + systematic_s**2))
        drift_sigma = float(np.sqrt(drift_covariance[c, c]))
        clear = abs(drifts[c]) > _DRIFT_SIGMAS * drift_sigma
        found[c] = Proposal(
            method, float(offsets[c]), HALF * sigma, float(drifts[c]) if clear else 0.0, HALF * drift_sigma
        )
    return found


def contradict(one: Proposal, other: Proposal) -> bool:
    """Whether two proposals about one camera leave no offset that both allow."""
    return abs(one.offset_s - other.offset_s) > one.half_s + other.half_s


def count_contradictions(
    weaker: Sequence[Proposal | None], stronger: Sequence[Sequence[Proposal | None]]
) -> tuple[int, int]:
    """In how many cameras a weaker method contradicts a stronger one, and in how many both have a proposal.

    Cameras where a proposal equals the reference's do not count, because it is exactly 0 by definition.
    """
    both = [
        (own, [other[c] for other in stronger if other[c] is not None])
        for c, own in enumerate(weaker)
        if own is not None
    ]
    compared = [(own, others) for own, others in both if others and own.half_s > 0]
    return sum(any(contradict(own, o) for o in others if o) for own, others in compared), len(compared)


def combine_proposals(
    proposals: Sequence[Proposal], fps: float, seconds: float, triggered: bool = True
) -> ClockVerdict:
    """The narrowest proposal if all agree within their intervals; in step where it does not exclude the camera as
    filmed.

    Where cameras were not ``triggered`` together there is no such prior: then any estimated offset counts, however
    small.
    """
    if not proposals:
        return ClockVerdict("undetermined", reason="no estimate")
    if any(contradict(*pair) for pair in itertools.combinations(proposals, 2)):
        return ClockVerdict("undetermined", reason="the estimates contradict each other")
    best = min(proposals, key=lambda p: p.half_s)
    drift = best.drift_ppm if abs(best.drift_ppm) * 1e-6 * seconds * fps > _NEGLIGIBLE_FRAMES else 0.0
    # An interval wider than a frame determines a frame and no fraction; and a fraction may be too small to matter.
    whole = round(best.offset_s * fps) / fps
    beside = abs(best.offset_s - whole) * fps
    on_the_beat = not drift and (best.half_s > 1 / fps or beside <= _NEGLIGIBLE_FRAMES)
    applied = whole if on_the_beat else best.offset_s
    if not drift and (abs(best.offset_s) <= max(best.half_s if triggered else 0.0, _NEGLIGIBLE_FRAMES / fps)):
        applied = 0.0
    # The interval around the applied value still covers the estimated one.
    half_s = best.half_s + abs(applied - best.offset_s)
    if not drift and not applied:
        return ClockVerdict("in step", 0.0, half_s, 0.0, best.method)
    return ClockVerdict("found", applied, half_s, drift, best.method)


def _reached(pairs: Sequence[Pair], cameras: int, reference: int) -> list[int]:
    reached, before = {reference}, 0
    while len(reached) > before:
        before = len(reached)
        for p in pairs:
            if p.first in reached or p.second in reached:
                reached |= {p.first, p.second}
    return [c for c in range(cameras) if c in reached]


def _least_squares(
    pairs: Sequence[Pair], cameras: int, values: Sequence[float], sigmas: Sequence[float], reference: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values per camera with the reference at 0, their covariance, and the residual of each pair in sigmas."""
    columns = np.zeros((len(pairs), cameras))
    for row, p in enumerate(pairs):
        columns[row, p.first], columns[row, p.second] = -1, 1
    weight = 1 / np.array(sigmas)
    information = (columns * weight[:, None] ** 2).T @ columns
    free = [c for c in range(cameras) if c != reference and columns[:, c].any()]
    covariance = np.zeros((cameras, cameras))
    covariance[np.ix_(free, free)] = np.linalg.inv(information[np.ix_(free, free)])
    solution = covariance @ (columns * weight[:, None] ** 2).T @ np.array(values)
    return solution, covariance, (np.array(values) - columns @ solution) * weight
