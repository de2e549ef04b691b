# SPDX-License-Identifier: Apache-2.0
"""What the empty room shows of calibrated cameras: directions of its edges, and where people stand on its floor.

People in one place fit calibrations that are degrees off. The room's edges do not depend on people. In a real room they
differ from a motion-capture system's calibration by less than a degree between any two cameras; from a hand-picked
calibration of the same cameras, 3.4° off that system's, by 2.4°, nearly five sigmas.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.estimate.factors.poses import ANKLE_HEIGHT_M
from studiorecon.geometry.camera_path import scene_centre
from studiorecon.geometry.rotations import angle
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.rig.correspondences import Observations
from studiorecon.rig.gravity import lower_feet
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.rig.room_turns import RoomTurn, room_turns
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Num

# Bodies whose feet show the height of the floor.
_MIN_FEET = 10
# Least visible share of the room for using a picture's edges (one with 59 to 62 %, in specks, was 2.5° off).
_MIN_KNOWN = 0.7
# Edges contradict the relative rotation of two cameras if they differ by more than so many of their sigmas, and
# degrees.
_CALLED_SIGMAS, _CALLED_DEG = 3.5, 1.5


def edge_rotations(cameras: Sequence[Camera], rooms: Sequence[RoomPicture | None]) -> dict[int, RoomTurn]:
    """The cameras' rotations by the straight edges in the pictures of the room; empty where undetermined.

    A mostly hidden room gives no rotation: its few visible edges are a biased sample, and may agree on rotations that
    are degrees off.
    """
    edges = {v: room.edges_px for v, room in enumerate(rooms) if room is not None and room.known.mean() >= _MIN_KNOWN}
    return room_turns(dict(enumerate(cameras)), edges)


def standing_area(cameras: Sequence[Camera], seen: Observations, limits: Limits) -> tuple[Num[np.ndarray, " 2"], float]:
    """Middle of people's positions, metres, and the height of the surface under them.

    Without people: the middle of the cameras' view, and 0.
    """
    if len(seen.frame):
        found = triangulate(seen.pixels, seen.confidence, cameras, limits)
        counted = found.verified if len(cameras) > 2 else found.valid
        feet_m = lower_feet(found.points_m, seen, counted)
        if len(feet_m) >= _MIN_FEET:
            middle: np.ndarray = np.median(found.points_m[counted, :2], axis=0)
            return middle, float(np.median(feet_m[:, 2])) - ANKLE_HEIGHT_M
    return scene_centre(cameras)[:2], 0.0


@dataclass(frozen=True)
class EdgeContradiction:
    """The two cameras whose edges most contradict their relative rotation: by how many degrees, and how many sigmas."""

    cameras: tuple[str, str]
    off_deg: float
    sigmas: float

    @property
    def clear(self) -> bool:
        """Whether the contradiction is clearly larger than the edges' error."""
        return self.sigmas >= _CALLED_SIGMAS and self.off_deg >= _CALLED_DEG


def edge_contradiction(cameras: Sequence[Camera], turns: Mapping[int, RoomTurn]) -> EdgeContradiction | None:
    """The largest contradiction of the edges to ``cameras``; None where fewer than two cameras have enough edges."""
    found = []
    for a, b in combinations(sorted(turns), 2):
        by_edges = turns[a].rotation_camera_from_world @ turns[b].rotation_camera_from_world.T
        given = cameras[a].camera_from_world[:3, :3] @ cameras[b].camera_from_world[:3, :3].T
        off = float(np.degrees(angle(by_edges, given)))
        sigmas = off / float(np.hypot(turns[a].sigma_deg, turns[b].sigma_deg))
        found.append(EdgeContradiction((cameras[a].name, cameras[b].name), off, sigmas))
    return max(found, key=lambda one: one.sigmas, default=None)
