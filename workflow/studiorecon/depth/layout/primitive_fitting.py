# SPDX-License-Identifier: Apache-2.0
"""Adds upright boxes one by one where they explain all photos better than the room without them."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from studiorecon.depth.layout.primitives import Primitive
from studiorecon.depth.layout.proposals import front_proposals, leg_candidates, single_view_proposals, top_proposals
from studiorecon.depth.layout.visibility import append_distance
from studiorecon.depth.stereo.photo_cost import PhotoCostVolume
from studiorecon.depth.stereo.plates import Picture
from studiorecon.scene.room import Platform, RoomBox

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

_STEPS_M = (0.16, 0.08, 0.04, 0.02)
_MAX_MOVES = 8
# A move must explain so many pixels more; of a platform, such a share of its own gain, because errors of the
# surrounding floor give small gains.
_MIN_MORE, _MIN_MORE_SHARE = 0.2, 0.02
_MIN_SIDE_M, _MIN_HEIGHT_M = 0.05, 0.04
_CLEARANCE_M = 0.05
# So many proposals are evaluated again at a time, and so many of them moved.
_HEAD, _CLIMBERS = 16, 2


def neighbour_primitives(primitive: Float[np.ndarray, " 7"], step_m: float, turns: bool) -> Float[np.ndarray, "M 7"]:
    """Neighbours of a primitive: every face moved in or out, the whole moved, and turned if allowed."""
    c, s = np.cos(primitive[2]), np.sin(primitive[2])
    turn = 1 / max(np.hypot(primitive[3], primitive[4]) / 2, 0.2)
    along, across = np.array([c, s, 0, 0, 0, 0, 0]), np.array([-s, c, 0, 0, 0, 0, 0])
    longer, wider, low, high = np.eye(7)[3:]
    ways = [along, across, high, low, low + high, turn * np.eye(7)[2] * turns]
    ways += [size + side * shift for side in (-0.5, 0.5) for size, shift in ((longer, along), (wider, across))]
    return primitive + np.concatenate([step_m * np.array(ways), -step_m * np.array(ways)])


def is_allowed(
    primitives: Float[np.ndarray, "N 7"], room_box: RoomBox, taken: Float[np.ndarray, "M 4"]
) -> Bool[np.ndarray, " N"]:
    """Whether each is large enough, in the room, and away from ``taken`` (M, 4: points and least distances, metres)."""
    large = (primitives[:, 3:5] >= _MIN_SIDE_M).all(axis=1) & (primitives[:, 6] - primitives[:, 5] >= _MIN_HEIGHT_M)
    centres = np.stack([primitives[:, 0], primitives[:, 1], (primitives[:, 5] + primitives[:, 6]) / 2], axis=-1)
    fits = (
        room_box.contains(centres)
        & (primitives[:, 5] >= room_box.low_m[2] - 0.021)
        & (primitives[:, 6] <= room_box.high_m[2] + 0.021)
    )
    fits &= large
    fits[fits] = ~contains_any(primitives[fits], np.ascontiguousarray(taken, np.float64))
    return fits


@njit(cache=True)
def contains_any(primitives: Float[np.ndarray, "N 7"], points_m: Float[np.ndarray, "M 4"]) -> Bool[np.ndarray, " N"]:
    """Whether any of the points (x, y, z, distance) is in the primitive grown by that point's distance."""
    found = np.zeros(len(primitives), np.bool_)
    for k in range(len(primitives)):
        primitive = primitives[k]
        c, s = np.cos(primitive[2]), np.sin(primitive[2])
        for m in range(len(points_m)):
            margin_m = points_m[m, 3]
            if not primitive[5] - margin_m < points_m[m, 2] < primitive[6] + margin_m:
                continue
            x, y = points_m[m, 0] - primitive[0], points_m[m, 1] - primitive[1]
            u, v = abs(c * x + s * y), abs(c * y - s * x)
            if u < primitive[3] / 2 + margin_m and v < primitive[4] / 2 + margin_m:
                found[k] = True
                break
    return found


def hill_climb(
    room: PhotoCostVolume,
    room_box: RoomBox,
    taken: Float[np.ndarray, "M 4"],
    primitive: Float[np.ndarray, " 7"],
    gain: float,
    steps_m: tuple[float, ...],
) -> tuple[Float[np.ndarray, " 7"], float]:
    """The primitive moved face by face while that explains more, in steps down to centimetres, and its gain."""
    # Furniture along the walls stays parallel to them: two visible faces do not separate a small turn from a wrong
    # position.
    turns = abs((primitive[2] - room_box.yaw_rad + np.pi / 4) % (np.pi / 2) - np.pi / 4) > 1e-6

    def others(now: Float[np.ndarray, " 7"], step_m: float) -> Float[np.ndarray, "M 7"]:
        around = neighbour_primitives(now, step_m, turns)
        return around[is_allowed(around, room_box, taken)]

    return _move_primitive(room, primitive, gain, steps_m, others, _MIN_MORE)


def _widen_platform(
    room: PhotoCostVolume, platform: Float[np.ndarray, " 7"], gain: float
) -> tuple[Float[np.ndarray, " 7"], float]:
    """The platform with its sides moved outwards while that explains more, and its gain."""

    def others(now: Float[np.ndarray, " 7"], step_m: float) -> Float[np.ndarray, "M 7"]:
        around = neighbour_primitives(now, step_m, False)
        wider = around[:, 3:5].sum(axis=1) > now[3:5].sum()
        return around[wider & (around[:, 5:] == now[5:]).all(axis=1)]

    return _move_primitive(room, platform, gain, _STEPS_M[:3], others, _MIN_MORE_SHARE * gain)


def _move_primitive(
    room: PhotoCostVolume,
    primitive: Float[np.ndarray, " 7"],
    gain: float,
    steps_m: tuple[float, ...],
    others: Callable[[Float[np.ndarray, " 7"], float], Float[np.ndarray, "M 7"]],
    least_more: float,
) -> tuple[Float[np.ndarray, " 7"], float]:
    for step_m in steps_m:
        for _ in range(_MAX_MOVES):
            around = others(primitive, step_m)
            if not len(around):
                break
            found = room.gains(around)
            best = int(found.argmax())
            if found[best] <= gain + least_more:
                break
            primitive, gain = around[best], float(found[best])
    return primitive, gain


class Proposals:
    """Candidate primitives with their last gains; gains only fall as a room is filled."""

    def __init__(self, least: float, thin: bool = False) -> None:
        """Start empty; primitives, all ``thin`` or none, that explain fewer than ``least`` pixels are dropped."""
        self._least, self.thin = least, thin
        self._primitives: list[np.ndarray] = []
        self._heap: list[tuple[float, int]] = []

    def __bool__(self) -> bool:
        return bool(self._heap)

    def keep(self, primitives: Iterable[tuple[Float[np.ndarray, " 7"], float]]) -> None:
        """Add primitives, each with the number of pixels it explains."""
        for primitive, price in primitives:
            if price >= self._least:
                heapq.heappush(self._heap, (-float(price), len(self._primitives)))
                self._primitives.append(primitive)

    def take(self, room: PhotoCostVolume, most: int) -> list[tuple[Float[np.ndarray, " 7"], float]]:
        """Remove and return the best primitives by their current gain, at most ``most``, with that number of pixels."""
        while self._heap:
            # The best few by their last gain, evaluated again, include the best.
            head = [heapq.heappop(self._heap)[1] for _ in range(min(_HEAD, len(self._heap)))]
            prices = room.gains(np.array([self._primitives[k] for k in head]), self.thin)
            ranked = sorted((-float(price), k) for k, price in zip(head, prices) if price >= self._least)
            best = [entry for entry in ranked if not self._heap or entry <= self._heap[0]][:most]
            for entry in ranked[len(best) :]:
                heapq.heappush(self._heap, entry)
            if best:
                return [(self._primitives[k], -price) for price, k in best]
        return []


def fit_primitives(
    pictures: Sequence[Picture],
    room_box: RoomBox,
    free_m: Float[np.ndarray, "M 4"],
    *,
    window: int,
    mean_weight: float,
    least_gain: float,
    most: int,
) -> list[Primitive]:
    """The primitives that explain the pictures better than the bare room box, in the order of selection.

    Greedy: the best few proposals are moved to where they explain most. The best of them is added if the photos'
    disagreement falls by ``least_gain`` pixels; then the rest are evaluated again.
    No primitive may contain a camera or one of ``free_m`` (M, 4: points and distances to keep), where people were seen.
    The platform comes first. Costs some 10 s for four pictures 160 pixels wide.
    """
    room = PhotoCostVolume(pictures, room_box, window, mean_weight)
    evidence: list[float] = []
    if room_box.platform is not None:
        platform = _platform_box(room_box.platform, room_box)
        platform, gain = _widen_platform(room, platform, float(room.gains(platform[None])[0]))
        evidence.append(gain)
        room.add(platform)
    taken = np.concatenate([append_distance(room.centre, _CLEARANCE_M), free_m])
    sources = (top_proposals, front_proposals, single_view_proposals)
    found = [primitive for source in sources for primitive in source(room, room_box)]
    proposals = np.array(found).reshape(-1, 7)
    proposals = proposals[is_allowed(proposals, room_box, taken)]
    others, legs = Proposals(least_gain / 2), Proposals(least_gain / 2, thin=True)
    others.keep(zip(proposals, room.gains(proposals)))
    while len(evidence) < most and (others or legs):
        tried = [
            hill_climb(room, room_box, taken, primitive, gain, _STEPS_M[:2])
            for primitive, gain in others.take(room, _CLIMBERS)
        ]
        tried = sorted((one for one in tried if one[1] >= least_gain), key=lambda one: -one[1])
        leg = [one for one in legs.take(room, 1) if one[1] >= least_gain]
        if not tried and not leg:
            continue
        # Legs come after everything that explains more once it is moved, because four of them also explain part of a
        # box. They are tried every few centimetres, keep their size, and are too thin to match: they are only accepted
        # under a slab.
        is_leg = bool(leg) and (not tried or leg[0][1] > tried[0][1])
        primitive, gain = (leg if is_leg else tried).pop(0)
        others.keep(tried)
        legs.keep(leg)
        if not is_leg:
            primitive, gain = hill_climb(room, room_box, taken, primitive, gain, _STEPS_M[2:])
        room.add(primitive)
        evidence.append(gain)
        under = leg_candidates(primitive, room.floor_m)
        under = under[is_allowed(under, room_box, taken)]
        legs.keep(zip(under, room.gains(under, legs.thin)))
    return [Primitive.from_numbers(primitive, gain) for primitive, gain in zip(room.primitives, evidence)]


def _platform_box(platform: Platform, room_box: RoomBox) -> Float[np.ndarray, " 7"]:
    """The platform, from the floor up."""
    middle = (np.array([*(platform.low_m + platform.high_m) / 2, 0.0]) @ room_box.axes)[:2]
    size_m = platform.high_m - platform.low_m
    return np.array([*middle, room_box.yaw_rad, *size_m, room_box.low_m[2], platform.top_m])
