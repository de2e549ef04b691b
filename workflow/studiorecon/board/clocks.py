# SPDX-License-Identifier: Apache-2.0
"""Offsets between films, and poses between cameras, from the board that both see.

At the right offset the rotation from one camera to the other, by the board's pose before each, is the same at all
moments.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.board.poses import BoardTrack
from studiorecon.geometry.rotations import angle, project_to_so3

if TYPE_CHECKING:
    from jaxtyping import Num

# Standard deviation of a board's rotation before a camera, radians (1°): how near rotations count as the same.
_TURN_SIGMA = np.radians(1.0)
# Common pictures below which two cameras are not connected by the board.
MIN_COMMON = 5
# Rotations from which the mean of the agreeing ones is searched: one in four right ones among so many is certain.
_CANDIDATES = 20
# Halvings of the step around the best offset.
_REFINEMENTS = 8


@dataclass(frozen=True)
class Link:
    """Two cameras that see the board together.

    Attributes:
        first, second: indices of the cameras.
        delay_s: added to times of the first film, gives times of the second.
        support: pictures that agree, each counting by how well.
        rotation, place_m: second camera from first.
    """

    first: int
    second: int
    delay_s: float
    support: float
    rotation: Num[np.ndarray, "3 3"]
    place_m: Num[np.ndarray, " 3"]


def links(tracks: list[BoardTrack]) -> list[Link]:
    """The tree of links that connects the cameras with most support."""
    every = [found for a, b in combinations(range(len(tracks)), 2) if (found := _link(tracks, a, b))]
    chosen: list[Link] = []
    group = list(range(len(tracks)))
    for link in sorted(every, key=lambda each: -each.support):
        one, two = group[link.first], group[link.second]
        if one != two:
            group = [one if g == two else g for g in group]
            chosen.append(link)
    return chosen


def _link(tracks: list[BoardTrack], a: int, b: int) -> Link | None:
    one, two = tracks[a], tracks[b]
    if min(len(one.times_s), len(two.times_s)) < 2:
        return None
    step = float(np.median(np.diff(one.times_s)))
    low, high = two.times_s[0] - one.times_s[-1], two.times_s[-1] - one.times_s[0]
    tried = np.arange(np.floor(low / step), np.ceil(high / step) + 1) * step
    # The smallest of several that are as good, as of a board that never moves.
    tried = tried[np.argsort(np.abs(tried), kind="stable")]
    delay = float(tried[int(np.argmax(_support(one, two, tried)))])
    for _ in range(_REFINEMENTS):
        step /= 2
        near = delay + step * np.array([0.0, -1.0, 1.0])
        delay = float(near[int(np.argmax(_support(one, two, near)))])
    between, there = _between(one, two, delay)
    if there.sum() < MIN_COMMON:
        return None
    mean = _mean(between[there])
    support = 1 / (1 + (angle(mean, between[there]) / _TURN_SIGMA) ** 2)
    if support.sum() < MIN_COMMON:
        return None
    times = one.times_s[there]
    before, share, _ = two.neighbours(times + delay)
    after = np.minimum(before + 1, len(two.times_s) - 1)
    place = (1 - share)[:, None] * two.places_m[before] + share[:, None] * two.places_m[after]
    places = place - np.einsum("ij,tj->ti", mean, one.places_m[there])
    return Link(a, b, delay, float(support.sum()), mean, np.median(places[support > 0.5], axis=0))


def _between(one: BoardTrack, two: BoardTrack, delay_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotations of camera two from camera one at the pictures of one, and where both see the board."""
    other = two.rotations_at(one.times_s + delay_s)
    return other @ np.swapaxes(one.rotations, -1, -2), np.isfinite(other[:, 0, 0])


def _mean(rotations: Num[np.ndarray, "K 3 3"]) -> Num[np.ndarray, "3 3"]:
    """The rotation near which most are, refined by their mean with weights."""
    candidates = rotations[:: -(-len(rotations) // _CANDIDATES)]
    distances = angle(candidates[:, None], rotations[None])
    best = candidates[int((1 / (1 + (distances / _TURN_SIGMA) ** 2)).sum(1).argmax())]
    for _ in range(5):
        weights = 1 / (1 + (angle(best, rotations) / _TURN_SIGMA) ** 2)
        best = project_to_so3((weights[:, None, None] * rotations).sum(0))
    return best


def _support(one: BoardTrack, two: BoardTrack, delays_s: Num[np.ndarray, " D"]) -> Num[np.ndarray, " D"]:
    found = np.zeros(len(delays_s))
    for index, delay in enumerate(delays_s):
        between, there = _between(one, two, float(delay))
        if there.sum() >= MIN_COMMON:
            sample = between[there]
            found[index] = (1 / (1 + (angle(_mean(sample), sample) / _TURN_SIGMA) ** 2)).sum()
    return found
