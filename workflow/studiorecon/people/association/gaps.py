# SPDX-License-Identifier: Apache-2.0
"""Groups that follow each other in time joined as one person, by way, size and clothes, solved together over the clip.

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

from studiorecon.people.association.grouping import Group, TrackComparison, groups_at_once
from studiorecon.people.association.terms import Bones, Ratio, Term

if TYPE_CHECKING:
    from jaxtyping import Float

# Deviation of the place where somebody reappears at once, m: a joint's error at either end.
_PLACE_M = 0.2
# What a second unseen adds to it, m/s: people in a room turn and stop; they walk at 1.4 m/s.
_SPEED_M_S = 0.7
# Area in which somebody else may appear, at least, m².
_MIN_AREA_M2 = 10.0
# Factor between the bone lengths of one person, measured twice; and of two people: adults differ by 7 %.
_SIZE = Ratio((1.0, 0.04), (1.0, 0.09), -6, 1)
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
        terms: way, size and clothes.
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


def group_tracks(compared: TrackComparison, clothes: Clothes | None = None) -> tuple[list[Group], list[Return]]:
    """All groups of at least two cameras, joined over gaps where they are one person, and every return that is decided
    or in question; ``clothes`` compares two groups. ``acceptance`` decides which groups are people.
    """
    groups = groups_at_once(compared)
    if compared.limits.method == "star":
        return groups, []
    known = [np.flatnonzero(np.isfinite(g.centres_m).all(-1)) for g in groups]
    area_m2, fps, rows = _area_m2(groups), compared.fps, [compared.rows(g) for g in groups]
    terms: dict[tuple[int, int], tuple[Term, ...]] = {}
    nats = np.full((len(groups),) * 2, -np.inf)
    for (i, first), (j, second) in permutations(enumerate(groups), 2):
        follows = len(known[i]) and len(known[j]) and known[i][-1] < known[j][0]
        if follows and not compared.pairs.forbidden[np.ix_(rows[i], rows[j])].any():
            own = [_way(first, second, known[i][-1], known[j][0], fps, area_m2), _size(first.bones, second.bones)]
            if clothes is not None and sum(term.nats for term in own) > -2 * REACH_NATS:
                own.append(_worn(clothes(first, second)))
            terms[i, j], nats[i, j] = tuple(own), sum(term.nats for term in own)
    after, best = _assigned(nats)
    returns = []
    for (i, j), pair in sorted(terms.items()):
        margin, joined = -float(nats[i, j]), after.get(i) == j
        if joined:
            without = nats.copy()
            without[i, j] = -np.inf
            margin = best - _assigned(without)[1]
        elif i in after or j in after.values() or abs(margin) > REACH_NATS:
            continue
        ends = float(known[i][-1] / fps), float(known[j][0] / fps)
        returns.append(Return(groups[i].members[0], groups[j].members[0], *ends, pair, margin, joined))
    out = []
    for i in sorted(set(range(len(groups))) - set(after.values())):
        chain = [i]
        while chain[-1] in after:
            chain.append(after[chain[-1]])
        whole = [m for k in chain for m in groups[k].members]
        out.append(groups[i] if len(chain) == 1 else compared.group(whole))
    return out, returns


def _assigned(nats: Float[np.ndarray, "G G"]) -> tuple[dict[int, int], float]:
    """(who follows whom, their sum) with the largest sum, each group followed by one at most and none below 0."""
    gain = np.maximum(nats, 0.0)
    rows, columns = scipy.optimize.linear_sum_assignment(-gain)
    return {int(i): int(j) for i, j in zip(rows, columns) if gain[i, j] > 0}, float(gain[rows, columns].sum())


def _area_m2(groups: Sequence[Group]) -> float:
    centres = [g.centres_m[np.isfinite(g.centres_m).all(-1), :2] for g in groups]
    if not sum(map(len, centres)):
        return _MIN_AREA_M2
    low, high = np.quantile(np.concatenate(centres), [0.02, 0.98], axis=0)
    return max(float(np.prod(high - low + 1.0)), _MIN_AREA_M2)


def _way(first: Group, second: Group, left: int, back: int, fps: float, area_m2: float) -> Term:
    """Term of the distance between the end of the first and the beginning of the second, for the time between them."""
    gap_s = (back - left) / fps
    off_m = float(np.linalg.norm(second.centres_m[back, :2] - first.centres_m[left, :2]))
    variance = min((_PLACE_M + _SPEED_M_S * gap_s) ** 2, area_m2 / (2 * np.pi))
    nats = np.log(area_m2 / (2 * np.pi * variance)) - 0.5 * off_m**2 / variance
    return Term("way", float(np.clip(nats, -12, 5)), f"{off_m:.1f} m in {gap_s:.1f} s")


def _size(first: Bones, second: Bones) -> Term:
    """Term of the factor between their bone lengths."""
    factors = [np.median(second[part]) / np.median(first[part]) for part in first.keys() & second.keys()]
    factor = float(np.median(factors)) if factors else float("nan")
    said = f"sizes {100 * abs(factor - 1):.0f} % apart" if factors else "sizes unknown"
    return Term("size", _SIZE.nats(factor), said)


def _worn(apart: Float[np.ndarray, " P"]) -> Term:
    """Term of the difference of their clothes."""
    known = apart[np.isfinite(apart)]
    nats = sum(_COLOUR.nats(one) for one in known)
    said = f"clothes {np.median(known):.0f} apart in CIELAB" if len(known) else "clothes unknown"
    return Term("clothes", nats, said)
