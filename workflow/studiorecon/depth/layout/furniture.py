# SPDX-License-Identifier: Apache-2.0
"""Upright boxes and cylinders, added one by one where they explain all photos better than the room without them."""

from __future__ import annotations

import heapq
from collections.abc import Sequence

import numpy as np
from numba import njit

from studiorecon.depth.layout.primitives import Primitive
from studiorecon.depth.layout.proposals import fronts, standing, tops
from studiorecon.depth.layout.visibility import kept_from
from studiorecon.depth.stereo.photo_cost import Explained
from studiorecon.depth.stereo.plates import Picture
from studiorecon.scene.room import RoomBox

_STEPS_M = (0.16, 0.08, 0.04, 0.02)
_MOST_MOVES = 8
_LEAST_SIDE_M, _LEAST_HEIGHT_M = 0.05, 0.04
_CLEARANCE_M = 0.05
# A box is tried as a cylinder when its sides differ by less than this share; one of one photo always is, and may
# explain so much less.
_SQUARE_SHARE, _ROUND_SHARE = 0.4, 0.85
# So many proposals are priced anew at a time, and so many of them moved.
_HEAD, _CLIMBERS = 16, 2


def moves(solid: np.ndarray, step_m: float, turns: bool) -> np.ndarray:
    """(M, 8) neighbours of a solid: every face moved in or out, the whole moved, and turned if it may."""
    c, s = np.cos(solid[3]), np.sin(solid[3])
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
        other = solid.copy()
        other[1:] += (c * du - s * dv, s * du + c * dv, turn, du_size, dv_size, low, high)
        found.append(other)

    for step in (step_m, -step_m):
        moved(du=step)
        moved(dv=step)
        moved(high=step)
        moved(low=step)
        moved(low=step, high=step)
        if solid[0] == 0:
            for side in (-0.5, 0.5):
                moved(du=side * step, du_size=step)
                moved(dv=side * step, dv_size=step)
            if turns:
                moved(turn=step / max(np.hypot(solid[4], solid[5]) / 2, 0.2))
        else:
            moved(du_size=step, dv_size=step)
    return np.array(found)


def allowed(solids: np.ndarray, shell: RoomBox, taken: np.ndarray) -> np.ndarray:
    """(N,) bool: of some size, inside the room, and away from ``taken`` (M, 4: points and the distance to keep from
    each, metres)."""
    large = (solids[:, 4:6] >= _LEAST_SIDE_M).all(axis=1) & (solids[:, 7] - solids[:, 6] >= _LEAST_HEIGHT_M)
    centres = np.stack([solids[:, 1], solids[:, 2], (solids[:, 6] + solids[:, 7]) / 2], axis=-1)
    fits = (
        shell.contains(centres) & (solids[:, 6] >= shell.low_m[2] - 0.021) & (solids[:, 7] <= shell.high_m[2] + 0.021)
    )
    fits &= large
    fits[fits] = ~around(solids[fits], np.ascontiguousarray(taken, np.float64))
    return fits


@njit(cache=True)
def around(solids: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """(N,) bool: any of the points is in the solid (N, 8) grown by that point's distance; ``points_m`` (M, 4): x, y, z,
    distance."""
    found = np.zeros(len(solids), np.bool_)
    for k in range(len(solids)):
        solid = solids[k]
        c, s = np.cos(solid[3]), np.sin(solid[3])
        for m in range(len(points_m)):
            margin_m = points_m[m, 3]
            if not solid[6] - margin_m < points_m[m, 2] < solid[7] + margin_m:
                continue
            x, y = points_m[m, 0] - solid[1], points_m[m, 1] - solid[2]
            u, v = abs(c * x + s * y), abs(c * y - s * x)
            if solid[0] == 0:
                inside = u < solid[4] / 2 + margin_m and v < solid[5] / 2 + margin_m
            else:
                inside = np.hypot(u, v) < solid[4] / 2 + margin_m
            if inside:
                found[k] = True
                break
    return found


def climb(
    room: Explained, shell: RoomBox, taken: np.ndarray, solid: np.ndarray, gain: float, steps_m: tuple[float, ...]
) -> tuple[np.ndarray, float]:
    """The solid moved face by face while that explains more, in steps down to centimetres, and what it gains then."""
    # What stands along the walls stays along them: two faces seen do not tell a small turn from a wrong place.
    turns = abs((solid[3] - shell.yaw_rad + np.pi / 4) % (np.pi / 2) - np.pi / 4) > 1e-6
    for step in steps_m:
        for _ in range(_MOST_MOVES):
            others = moves(solid, step, turns)
            others = others[allowed(others, shell, taken)]
            if not len(others):
                break
            found = room.gains(others)
            best = int(found.argmax())
            if found[best] <= gain + 0.2:
                break
            solid, gain = others[best], float(found[best])
    return solid, gain


def furnish(
    pictures: Sequence[Picture],
    shell: RoomBox,
    free_m: np.ndarray,
    *,
    window: int,
    mean_weight: float,
    least_gain: float,
    most: int,
) -> list[Primitive]:
    """The solids that explain the pictures better than the bare shell, in the order they were found.

    Greedy: of all proposals the best is moved to where it explains most, added when the photos' disagreement falls by
    ``least_gain`` pixels, and the rest are priced anew. Nothing is put where a camera or one of ``free_m`` (M, 4:
    points and distances to keep) is: somebody walked there, or was seen through it. Costs some 25 s for four pictures
    160 pixels wide.
    """
    room = Explained.by_shell(pictures, shell, window, mean_weight)
    taken = np.concatenate([kept_from(room.centre, _CLEARANCE_M), free_m])
    proposals = np.array([solid for source in (tops, fronts, standing) for _, solid in source(room, shell)]).reshape(
        -1, 8
    )
    proposals = proposals[allowed(proposals, shell, taken)]
    gains = room.gains(proposals)
    heap = [(-gain, k) for k, gain in enumerate(gains) if gain >= least_gain / 2]
    heapq.heapify(heap)
    evidence: list[float] = []
    while heap and len(evidence) < most:
        # Prices only fall as solids are added, so the best few by their last price, priced anew, hold the best of all.
        head = [heapq.heappop(heap)[1] for _ in range(min(_HEAD, len(heap)))]
        ranked = sorted((-gain, k) for k, gain in zip(head, room.gains(proposals[head])) if gain >= least_gain / 2)
        fresh = [entry for entry in ranked if not heap or entry <= heap[0]]
        for entry in ranked if not fresh else [r for r in ranked if r is not fresh[0]]:
            heapq.heappush(heap, entry)
        if not fresh:
            continue
        tried = [climb(room, shell, taken, proposals[k], -price, _STEPS_M[:2]) for price, k in fresh[:_CLIMBERS]]
        solid, gain = max(tried, key=lambda found: found[1])
        solid, gain = climb(room, shell, taken, solid, gain, _STEPS_M[2:])
        solid, gain = rounded(room, shell, taken, solid, gain)
        if gain >= least_gain:
            room.add(solid)
            evidence.append(gain)
    return [Primitive.from_numbers(solid, gain) for solid, gain in zip(room.solids, evidence)]


def rounded(
    room: Explained, shell: RoomBox, taken: np.ndarray, solid: np.ndarray, gain: float
) -> tuple[np.ndarray, float]:
    """A cylinder in place of a nearly square box when it explains more; two numbers less, so a tie is its own.

    Of what one photo alone shows nobody knows how deep it is: it is as deep as it is wide, a cylinder, unless that
    explains clearly less.
    """
    if solid[0] != 0:
        return solid, gain
    alone = gain - float(room.gains(solid[None], looks=False)[0]) > gain / 2
    side = solid[4:6].max() if alone else solid[4:6].mean()
    if not alone and abs(solid[4] - solid[5]) > _SQUARE_SHARE * side:
        return solid, gain
    start = np.array([1, *solid[1:3], 0, side, side, *solid[6:]])
    round_solid, round_gain = climb(room, shell, taken, start, float(room.gains(start[None])[0]), _STEPS_M[1:])
    return (round_solid, round_gain) if round_gain >= (_ROUND_SHARE if alone else 1.0) * gain else (solid, gain)
