# SPDX-License-Identifier: Apache-2.0
"""Upright boxes and cylinders, added one by one where they explain all photos better than the room without them."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from studiorecon.depth.layout.primitives import Primitive
from studiorecon.depth.layout.proposals import fronts, posts, standing, tops
from studiorecon.depth.layout.visibility import kept_from
from studiorecon.depth.stereo.photo_cost import Explained
from studiorecon.depth.stereo.plates import Picture
from studiorecon.scene.room import RoomBox

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

_STEPS_M = (0.16, 0.08, 0.04, 0.02)
_MOST_MOVES = 8
_LEAST_SIDE_M, _LEAST_HEIGHT_M = 0.05, 0.04
_CLEARANCE_M = 0.05
# A box is tried as a cylinder when its sides differ by less than this share; one of one photo always is, and may
# explain so much less.
_SQUARE_SHARE, _ROUND_SHARE = 0.4, 0.85
# So many proposals are priced anew at a time, and so many of them moved.
_HEAD, _CLIMBERS = 16, 2


def moves(primitive: Float[np.ndarray, " 8"], step_m: float, turns: bool) -> Float[np.ndarray, "M 8"]:
    """(M, 8) neighbours of a primitive: every face moved in or out, the whole moved, and turned if it may."""
    c, s = np.cos(primitive[3]), np.sin(primitive[3])
    found = []

    def moved(
        du: float = 0.0,
        dv: float = 0.0,
        du_size: float = 0.0,
        dv_size: float = 0.0,
        turn: float = 0.0,
        low: float = 0.0,
        high: float = 0.0,
    ) -> None:
        other = primitive.copy()
        other[1:] += (c * du - s * dv, s * du + c * dv, turn, du_size, dv_size, low, high)
        found.append(other)

    for step in (step_m, -step_m):
        moved(du=step)
        moved(dv=step)
        moved(high=step)
        moved(low=step)
        moved(low=step, high=step)
        if primitive[0] == 0:
            for side in (-0.5, 0.5):
                moved(du=side * step, du_size=step)
                moved(dv=side * step, dv_size=step)
            if turns:
                moved(turn=step / max(np.hypot(primitive[4], primitive[5]) / 2, 0.2))
        else:
            moved(du_size=step, dv_size=step)
    return np.array(found)


def allowed(
    primitives: Float[np.ndarray, "N 8"], room_box: RoomBox, taken: Float[np.ndarray, "M 4"]
) -> Bool[np.ndarray, " N"]:
    """(N,) bool: of some size, inside the room, and away from ``taken`` (M, 4: points and the distance to keep from
    each, metres)."""
    large = (primitives[:, 4:6] >= _LEAST_SIDE_M).all(axis=1) & (primitives[:, 7] - primitives[:, 6] >= _LEAST_HEIGHT_M)
    centres = np.stack([primitives[:, 1], primitives[:, 2], (primitives[:, 6] + primitives[:, 7]) / 2], axis=-1)
    fits = (
        room_box.contains(centres)
        & (primitives[:, 6] >= room_box.low_m[2] - 0.021)
        & (primitives[:, 7] <= room_box.high_m[2] + 0.021)
    )
    fits &= large
    fits[fits] = ~around(primitives[fits], np.ascontiguousarray(taken, np.float64))
    return fits


@njit(cache=True)
def around(primitives: Float[np.ndarray, "N 8"], points_m: Float[np.ndarray, "M 4"]) -> Bool[np.ndarray, " N"]:
    """(N,) bool: any of the points is in the primitive (N, 8) grown by that point's distance; ``points_m`` (M, 4): x,
    y, z, distance."""
    found = np.zeros(len(primitives), np.bool_)
    for k in range(len(primitives)):
        primitive = primitives[k]
        c, s = np.cos(primitive[3]), np.sin(primitive[3])
        for m in range(len(points_m)):
            margin_m = points_m[m, 3]
            if not primitive[6] - margin_m < points_m[m, 2] < primitive[7] + margin_m:
                continue
            x, y = points_m[m, 0] - primitive[1], points_m[m, 1] - primitive[2]
            u, v = abs(c * x + s * y), abs(c * y - s * x)
            if primitive[0] == 0:
                inside = u < primitive[4] / 2 + margin_m and v < primitive[5] / 2 + margin_m
            else:
                inside = np.hypot(u, v) < primitive[4] / 2 + margin_m
            if inside:
                found[k] = True
                break
    return found


def climb(
    room: Explained,
    room_box: RoomBox,
    taken: Float[np.ndarray, "M 4"],
    primitive: Float[np.ndarray, " 8"],
    gain: float,
    steps_m: tuple[float, ...],
) -> tuple[Float[np.ndarray, " 8"], float]:
    """The primitive moved face by face while that explains more, in steps down to centimetres, and what it gains."""
    # What stands along the walls stays along them: two faces seen do not tell a small turn from a wrong place.
    turns = abs((primitive[3] - room_box.yaw_rad + np.pi / 4) % (np.pi / 2) - np.pi / 4) > 1e-6
    for step in steps_m:
        for _ in range(_MOST_MOVES):
            others = moves(primitive, step, turns)
            others = others[allowed(others, room_box, taken)]
            if not len(others):
                break
            found = room.gains(others)
            best = int(found.argmax())
            if found[best] <= gain + 0.2:
                break
            primitive, gain = others[best], float(found[best])
    return primitive, gain


def furnish(
    pictures: Sequence[Picture],
    room_box: RoomBox,
    free_m: Float[np.ndarray, "M 4"],
    *,
    window: int,
    mean_weight: float,
    least_gain: float,
    most: int,
) -> list[Primitive]:
    """The primitives that explain the pictures better than the bare room box, in the order they were found.

    Greedy: of all proposals the best is moved to where it explains most, added when the photos' disagreement falls by
    ``least_gain`` pixels, and the rest are priced anew. Nothing is put where a camera or one of ``free_m`` (M, 4:
    points and distances to keep) is: somebody walked there, or was seen through it. Costs some 25 s for four pictures
    160 pixels wide.
    """
    room = Explained.by_room_box(pictures, room_box, window, mean_weight)
    taken = np.concatenate([kept_from(room.centre, _CLEARANCE_M), free_m])
    proposals = np.array(
        [primitive for source in (tops, fronts, standing) for _, primitive in source(room, room_box)]
    ).reshape(-1, 8)
    proposals = proposals[allowed(proposals, room_box, taken)]
    first_leg = len(proposals)
    gains = room.gains(proposals)
    heap = [(-gain, k) for k, gain in enumerate(gains) if gain >= least_gain / 2]
    heapq.heapify(heap)
    evidence: list[float] = []
    while heap and len(evidence) < most:
        # Prices only fall as primitives are added, so the best few by their last price, priced anew, hold the best.
        head = [heapq.heappop(heap)[1] for _ in range(min(_HEAD, len(heap)))]
        ranked = sorted((-gain, k) for k, gain in zip(head, room.gains(proposals[head])) if gain >= least_gain / 2)
        fresh = [entry for entry in ranked if not heap or entry <= heap[0]]
        for entry in ranked if not fresh else [r for r in ranked if r is not fresh[0]]:
            heapq.heappush(heap, entry)
        if not fresh:
            continue
        if fresh[0][1] < first_leg:
            tried = [
                climb(room, room_box, taken, proposals[k], -price, _STEPS_M[:2])
                for price, k in fresh[:_CLIMBERS]
                if k < first_leg
            ]
            primitive, gain = max(tried, key=lambda found: found[1])
            primitive, gain = climb(room, room_box, taken, primitive, gain, _STEPS_M[2:])
            primitive, gain = rounded(room, room_box, taken, primitive, gain)
        else:
            # Legs are looked for every few centimetres, and stay as thin and as long as they are.
            primitive, gain = proposals[fresh[0][1]], -fresh[0][0]
        if gain >= least_gain:
            room.add(primitive)
            evidence.append(gain)
            legs = posts(primitive, room.floor_m)
            legs = legs[allowed(legs, room_box, taken)]
            for k, price in enumerate(room.gains(legs), start=len(proposals)):
                if price >= least_gain / 2:
                    heapq.heappush(heap, (-price, k))
            proposals = np.concatenate([proposals, legs])
    return [Primitive.from_numbers(primitive, gain) for primitive, gain in zip(room.primitives, evidence)]


def rounded(
    room: Explained, room_box: RoomBox, taken: Float[np.ndarray, "M 4"], primitive: Float[np.ndarray, " 8"], gain: float
) -> tuple[Float[np.ndarray, " 8"], float]:
    """A cylinder in place of a nearly square box when it explains more; two numbers less, so a tie is its own.

    Of what one photo alone shows nobody knows how deep it is: it is as deep as it is wide, a cylinder, unless that
    explains clearly less.
    """
    if primitive[0] != 0:
        return primitive, gain
    alone = gain - float(room.gains(primitive[None], looks=False)[0]) > gain / 2
    side = primitive[4:6].max() if alone else primitive[4:6].mean()
    if not alone and abs(primitive[4] - primitive[5]) > _SQUARE_SHARE * side:
        return primitive, gain
    start = np.array([1, *primitive[1:3], 0, side, side, *primitive[6:]])
    round_primitive, round_gain = climb(room, room_box, taken, start, float(room.gains(start[None])[0]), _STEPS_M[1:])
    return (round_primitive, round_gain) if round_gain >= (_ROUND_SHARE if alone else 1.0) * gain else (primitive, gain)
