# SPDX-License-Identifier: Apache-2.0
"""Walls that no photo matches: one posterior of their distance behind the cameras.

Three things say where such a wall is. Rooms resemble each other: the margin between the outermost camera or person and
a wall is log-normal, alike for the walls of one room; a side of a courtyard or a pitch has none. Lower ends of upright
edges lie on the wall's foot, before it (furniture), or beyond it (a picture that hangs on it: its lower end, at any
height up to the camera's, would meet the floor at r with density d / r², for a wall at distance d). And where the floor
was matched, no wall is nearer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtr

from studiorecon.depth.layout.ground_contacts import GroundContacts, find_ground_contacts
from studiorecon.depth.layout.votes import PlaneSweep, Votes
from studiorecon.depth.stereo.plates import Picture
from studiorecon.geometry.camera_path import scene_centre
from studiorecon.rig.room_picture import make_room_picture
from studiorecon.scene.camera import Camera
from studiorecon.scene.room import RoomBox

if TYPE_CHECKING:
    from jaxtyping import Float

# Median margin between cameras on tripods, or people, and a wall; how rooms, then walls of one, differ from it (ln).
_MARGIN_M = 1.5
_ROOMS_SIGMA = 0.7
_WALLS_SIGMA = 0.6
# Share of sides without a wall: what is there is as far as depth reaches. A guess, which edges outweigh in a room: from
# 0.02 to 0.3 the demo's hidden walls are placed alike (python -m benchmarks.unseen_walls results/demo).
_OPEN = 0.1
# A camera on its tripod, or a person, is at least so far from a wall.
_MIN_MARGIN_M = 0.3
# On a side without cameras, while nobody is known, people use this share of the cameras' distance from the middle.
_PEOPLE_SHARE = 0.5
# Shares of lower ends on the foot of a wall (within 2 sigma) and before it, of 463 in three made captures; the rest
# hangs on it (python -m benchmarks.unseen_walls).
_ON_FOOT = 0.08
_BEFORE = 0.27
# Skirting and frames spread the foot so far.
_FOOT_SIGMA_M = 0.16
# Pictures hang in lines as feet do, so each of n edges in a line counts n to the power of minus this. At 0.75 a line of
# seven boards places no wall; at 0.5 the 80 % intervals miss two of the demo's four walls.
_ALIKE = 0.6
# Share of directions in which the furthest matched floor is not floor (a wall, or its reflection).
_WRONG_FLOOR = 0.15
# A direction's floor ends at this quantile of its matches: the last tenth may be wrong.
_FURTHEST = 0.9
# Fewer pixels of a direction have no quantile.
_MIN_PIXELS = 5
# Least cosine between a wall's normal and the line of sight.
_FACED = 0.35
_STEP_M = 0.05
# Planes so near to the floor are the floor.
FLOOR_REACH_M = 0.06


@dataclass(frozen=True)
class FloorEnds:
    """Furthest matched floor, per camera and degree: ``place_m`` x and y; ``towards``: unit, from the camera."""

    place_m: Float[np.ndarray, "N 2"]
    towards: Float[np.ndarray, "N 2"]


def find_floor_ends(pictures: Sequence[Picture], votes: Votes, floor_m: float) -> FloorEnds:
    """Where the floor, as confident pixels match it, ends in each camera's directions of one degree."""
    place_m, towards = [np.empty((0, 2))], [np.empty((0, 2))]
    for picture, on_floor in zip(pictures, votes.voters(np.array([0.0, 0.0, 1.0]), floor_m, FLOOR_REACH_M)):
        origin_m, rays = picture.camera.rays()
        downwards = rays[on_floor & (rays[..., 2] < 0)]
        away_m = downwards[:, :2] * ((floor_m - origin_m[2]) / downwards[:, 2])[:, None]
        distance_m = np.linalg.norm(away_m, axis=1)
        azimuth_deg = np.round(np.degrees(np.arctan2(away_m[:, 1], away_m[:, 0])))
        for degree in np.unique(azimuth_deg):
            own = np.flatnonzero(azimuth_deg == degree)
            if len(own) >= _MIN_PIXELS:
                end = own[np.argsort(distance_m[own], kind="stable")[int(_FURTHEST * (len(own) - 1))]]
                place_m.append((origin_m[:2] + away_m[end])[None])
                towards.append((away_m[end] / distance_m[end])[None])
    return FloorEnds(np.concatenate(place_m), np.concatenate(towards))


def complete_room(
    box: RoomBox,
    pictures: Sequence[Picture],
    cameras: Sequence[Camera],
    plates: Sequence[Path],
    swept: PlaneSweep,
    people_m: Float[np.ndarray, "M 2"],
    far_m: float,
) -> tuple[RoomBox, Float[np.ndarray, "4 2"]]:
    """``place_unseen_walls`` by the upright edges of the ``plates`` and the floor that the sweeps matched."""
    feet = find_ground_contacts(cameras, [make_room_picture(plate) for plate in plates], float(box.low_m[2]))
    floor = find_floor_ends(pictures, swept.votes, swept.floor_m)
    return place_unseen_walls(box, feet, floor, cameras, people_m, far_m)


def place_unseen_walls(
    box: RoomBox,
    feet: GroundContacts,
    floor: FloorEnds,
    cameras: Sequence[Camera],
    people_m: Float[np.ndarray, "M 2"],
    far_m: float,
) -> tuple[RoomBox, Float[np.ndarray, "4 2"]]:
    """The box with the walls that are not ``fitted`` at their median, up to ``far_m`` behind the cameras, and all
    walls' 80 % intervals (coordinates along u, u, v and v). ``people_m`` are places of people, whom walls enclose.
    They stay defaults, because nothing was matched there."""
    outwards = np.array([[-1.0], [1.0], [-1.0], [1.0]])
    normals = outwards * box.axes[[0, 0, 1, 1], :2]
    centres_m, middle_m = np.stack([c.centre_m[:2] for c in cameras]), scene_centre(cameras)[:2]
    radius_m = np.linalg.norm(centres_m - middle_m, axis=1).mean()
    reach_m = (people_m @ normals.T).max(0) if len(people_m) else normals @ middle_m + _PEOPLE_SHARE * radius_m
    from_m = np.maximum((centres_m @ normals.T).max(0), reach_m)
    margins_m = np.arange(_MIN_MARGIN_M, max(far_m, 2 * _MIN_MARGIN_M), _STEP_M)
    likelihood = np.stack(
        [
            _known(margins_m, outwards[face, 0] * box.faces[face, 3] - from_m[face])
            if box.fitted[face]
            else _likelihood(from_m[face] + margins_m, normals[face], feet, floor, centres_m)
            for face in range(4)
        ]
    )
    # A room's own median margin is unknown too, which makes its walls alike.
    rooms_m = np.geomspace(_MARGIN_M / 8, _MARGIN_M * 8, 50)
    room = np.exp(-0.5 * (np.log(rooms_m / _MARGIN_M) / _ROOMS_SIGMA) ** 2)
    wall = np.exp(-0.5 * (np.log(margins_m / rooms_m[:, None]) / _WALLS_SIGMA) ** 2) / margins_m
    wall *= (1 - _OPEN) / wall.sum(1, keepdims=True)
    wall[:, -1] += _OPEN
    evidence = likelihood @ wall.T
    placed, interval_m = box.faces[:4, 3].copy(), np.repeat(box.faces[:4, 3, None], 2, axis=1)
    for face in np.flatnonzero(~box.fitted[:4]):
        others = room * np.delete(evidence, face, axis=0).prod(0)
        posterior = np.cumsum((others @ wall) * likelihood[face])
        low, median, high = margins_m[np.searchsorted(posterior / posterior[-1], (0.1, 0.5, 0.9))] + from_m[face]
        placed[face], interval_m[face] = outwards[face, 0] * median, np.sort(outwards[face, 0] * np.array([low, high]))
    low_m, high_m = np.array([*placed[::2], box.low_m[2]]), np.array([*placed[1::2], box.high_m[2]])
    return replace(box, low_m=low_m, high_m=high_m), interval_m


def _known(margins_m: Float[np.ndarray, " M"], margin_m: float) -> Float[np.ndarray, " M"]:
    return (np.arange(len(margins_m)) == np.abs(margins_m - margin_m).argmin()).astype(np.float64)


def _likelihood(
    walls_m: Float[np.ndarray, " M"],
    normal: Float[np.ndarray, " 2"],
    feet: GroundContacts,
    floor: FloorEnds,
    centres_m: Float[np.ndarray, "V 2"],
) -> Float[np.ndarray, " M"]:
    """Likelihood of a wall at each offset along ``normal``; the best one's is 1."""
    faced = feet.towards @ normal > _FACED
    foot_m, eye_m = (feet.place_m @ normal)[faced], (centres_m @ normal)[feet.camera[faced]]
    sigma_m = np.hypot(feet.sigma_m * (feet.towards @ normal), _FOOT_SIGMA_M)[faced]
    in_line = (np.abs(foot_m[:, None] - foot_m) < 2 * np.hypot(sigma_m[:, None], sigma_m)).sum(1)
    behind, distance_m = (foot_m - walls_m[:, None]) / sigma_m, np.maximum(walls_m[:, None] - eye_m, _STEP_M)
    density = (
        _ON_FOOT * np.exp(-0.5 * behind**2) / (sigma_m * np.sqrt(2 * np.pi))
        + _BEFORE * ndtr(-behind) / distance_m
        + (1 - _ON_FOOT - _BEFORE) * ndtr(behind) * distance_m / np.maximum(foot_m - eye_m, _STEP_M) ** 2
    )
    log = (np.log(density + 1e-12) * in_line**-_ALIKE).sum(1)
    floor_m = (floor.place_m @ normal)[floor.towards @ normal > _FACED]
    nearer = (walls_m[:, None] + 2 * _FOOT_SIGMA_M < floor_m).sum(1)
    log += nearer * np.log(_WRONG_FLOOR / (1 - _WRONG_FLOOR))
    return np.exp(log - log.max())
