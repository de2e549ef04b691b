# SPDX-License-Identifier: Apache-2.0
"""Groups that follow each other in time joined as one person, by path, size and clothes, solved together over the clip.

For each group that ends and each that begins later: the log-likelihood ratio, in nats, that the same person came back
(or was hidden) to that another one appeared. The assignment with the largest sum is taken; a ratio below 0 joins none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.people.association.group import Group, has_no_rival
from studiorecon.people.association.terms import Ratio, Term, bone_lengths_m
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float

# Deviation of the place where somebody reappears at once, m: a joint's error at either end.
_PLACE_M = 0.2
# What a second unseen adds to it, m/s: people in a room turn and stop; they walk at 1.4 m/s.
_SPEED_M_S = 0.7
# Area in which somebody else may appear, at least, m².
_MIN_AREA_M2 = 10.0
# Deviation of the logarithm of one person's bone lengths, measured twice.
_SAME_SIZE = 0.04
# The same of two people's: adults differ by 7 %, and both are measured.
_OTHER_SIZE = 0.09
# Time at either end to which place and velocity are fitted, s: half a step.
_END_S = 0.4
# Fewer places give no velocity.
_MIN_PLACES = 4
# Time in which a velocity is forgotten to 1/e, s: about a step.
_KEPT_S = 0.8
# Velocities above this are errors, m/s: a fast walk.
_MAX_WALK_M_S = 3.0
# Difference of the colours of one part of the body in one camera, CIELAB: of one person's, and of two people's.
_COLOUR = Ratio((7.0, 0.7), (28.0, 0.6), -3, 1.5)
# Ratios within so many nats of 0 are worth a question.
REACH_NATS = 3.0

Clothes = Callable[[Group, Group], "Float[np.ndarray, ' P']"]
"""Difference of colours of the body's parts of two groups, CIELAB, NaN where unknown."""


@dataclass(frozen=True)
class Return:
    """A possible return of a person.

    Attributes:
        before, after: (view, track) of a track of the group that ends, and of the one that begins.
        left_s, back_s: times, seconds.
        terms: path, size and clothes.
        margin_nats: by how much the decision is better than the best other one.
        joined: whether the two are taken for one person.
    """

    before: tuple[int, int]
    after: tuple[int, int]
    left_s: float
    back_s: float
    terms: tuple[Term, ...]
    margin_nats: float
    joined: bool


def join_over_gaps(
    groups: Sequence[Group],
    stable: Sequence[Detections],
    fps: float,
    merge: Callable[[list[tuple[int, int]]], Group],
    clothes: Clothes | None = None,
) -> tuple[list[Group], list[Return]]:
    """The groups, joined by ``merge`` where they are one person, and every return that is decided or in question."""
    area_m2, seen = _area_m2(groups), [np.flatnonzero(np.isfinite(g.centres_m).all(-1)) for g in groups]
    terms: dict[tuple[int, int], tuple[Term, ...]] = {}
    for (i, first), (j, second) in permutations(enumerate(groups), 2):
        if len(seen[i]) and len(seen[j]) and seen[i][-1] < seen[j][0] and _apart(first, second, stable):
            terms[i, j] = _way(first, second, seen[i], seen[j], fps, area_m2), _size(first, second)
            if clothes is not None and sum(term.nats for term in terms[i, j]) > -2 * REACH_NATS:
                terms[i, j] += (_worn(clothes(first, second)),)
    nats = np.full((len(groups),) * 2, -np.inf)
    for pair, own in terms.items():
        nats[pair] = sum(term.nats for term in own)
    after, best = _assigned(nats)
    returns = []
    for (i, j), own in sorted(terms.items()):
        joined = after.get(i) == j
        if joined:
            without = nats.copy()
            without[i, j] = -np.inf
            margin = best - _assigned(without)[1]
        elif i in after or j in after.values() or abs(nats[i, j]) > REACH_NATS:
            continue
        else:
            margin = -float(nats[i, j])
        ends = seen[i][-1] / fps, seen[j][0] / fps
        returns.append(Return(groups[i].members[0], groups[j].members[0], *ends, own, margin, joined))
    out = []
    for i in sorted(set(range(len(groups))) - set(after.values())):
        chain = [i]
        while chain[-1] in after:
            chain.append(after[chain[-1]])
        out.append(groups[i] if len(chain) == 1 else merge([m for k in chain for m in groups[k].members]))
    return out, returns


def _assigned(nats: Float[np.ndarray, "G G"]) -> tuple[dict[int, int], float]:
    """(who follows whom, their sum) with the largest sum, each group followed by one at most and none below 0."""
    gain = np.maximum(nats, 0.0)
    rows, columns = scipy.optimize.linear_sum_assignment(-gain)
    return {int(i): int(j) for i, j in zip(rows, columns) if gain[i, j] > 0}, float(gain[rows, columns].sum())


def _apart(first: Group, second: Group, stable: Sequence[Detections]) -> bool:
    """Whether no camera shows both at once."""
    return all(has_no_rival(member, first.members, stable) for member in second.members)


def _area_m2(groups: Sequence[Group]) -> float:
    centres = [g.centres_m[np.isfinite(g.centres_m).all(-1), :2] for g in groups]
    if not sum(map(len, centres)):
        return _MIN_AREA_M2
    low, high = np.quantile(np.concatenate(centres), [0.02, 0.98], axis=0)
    return max(float(np.prod(high - low + 1.0)), _MIN_AREA_M2)


def _way(first: Group, second: Group, before: np.ndarray, after: np.ndarray, fps: float, area_m2: float) -> Term:
    """Term of the distance between the end of the first and the beginning of the second, for the time between them."""
    left, gone_m_s = _end(first, before[::-1], fps)
    back, came_m_s = _end(second, after, fps)
    gap_s = float((after[0] - before[-1]) / fps)
    expected = 0.5 * (gone_m_s + came_m_s) * _KEPT_S * (1 - np.exp(-gap_s / _KEPT_S))
    off_m = float(np.linalg.norm(back - left - expected))
    variance = min((_PLACE_M + _SPEED_M_S * gap_s) ** 2, area_m2 / (2 * np.pi))
    nats = np.log(area_m2 / (2 * np.pi * variance)) - 0.5 * off_m**2 / variance
    said = f"{np.linalg.norm(back - left):.1f} m in {gap_s:.1f} s"
    return Term("way", float(np.clip(nats, -12, 5)), said)


def _end(group: Group, frames: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """(2,) place on the floor, m, and (2,) velocity, m/s, at the first of the ``frames`` (ascending or descending)."""
    near = frames[np.abs(frames - frames[0]) < max(2, round(_END_S * fps))]
    places = group.centres_m[near, :2]
    if len(near) < _MIN_PLACES:
        return np.median(places, axis=0), np.zeros(2)
    times_s = (near - near[0]) / fps
    slope, place = np.polyfit(times_s, places, 1)
    return place, np.clip(slope, -_MAX_WALK_M_S, _MAX_WALK_M_S)


def _size(first: Group, second: Group) -> Term:
    """Term of the difference of their bone lengths."""
    lengths = [
        {part: np.median([np.median(v) for v in values]) for part, values in bone_lengths_m(g.points_m).items()}
        for g in (first, second)
    ]
    ratios = [float(np.log(lengths[1][part] / lengths[0][part])) for part in lengths[0] if part in lengths[1]]
    ratio = float(np.median(ratios)) if ratios else 0.0
    nats = 0.5 * ratio**2 * (_OTHER_SIZE**-2 - _SAME_SIZE**-2) + np.log(_OTHER_SIZE / _SAME_SIZE) if ratios else 0.0
    return Term("size", float(max(nats, -6.0)), f"sizes {100 * abs(np.expm1(ratio)):.0f} % apart")


def _worn(apart: Float[np.ndarray, " P"]) -> Term:
    """Term of the difference of their clothes."""
    known = apart[np.isfinite(apart)]
    nats = sum(_COLOUR.nats(one) for one in known)
    said = f"clothes {np.median(known):.0f} apart in CIELAB" if len(known) else "clothes unknown"
    return Term("clothes", nats, said)
