# SPDX-License-Identifier: Apache-2.0
"""Detects contradictions between the room's straight edges and the cameras' relative rotations, and refines on both.

One person in one place fits calibrations that are degrees off. The room's edges do not depend on people. In a real room
they differ from a motion-capture system's calibration by less than a degree between any two cameras; from a hand-picked
calibration of the same cameras, 3.4° off that system's, by 2.4°, nearly five sigmas.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from studiorecon.geometry.bundle import BundleSettings, remove_drift
from studiorecon.geometry.rotations import angle
from studiorecon.geometry.triangulation import Limits
from studiorecon.rig.correspondences import Observations
from studiorecon.rig.moved_cameras import FREE_DEG, FREE_M
from studiorecon.rig.pose_uncertainty import ABOUT_ALL_AXES, rotation_interval_deg
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.rig.room_refinement import edge_rotations, refine_on_room
from studiorecon.rig.room_turns import RoomTurn
from studiorecon.scene.camera import Camera

# Edges contradict the relative rotation of two cameras if they differ by more than so many of their sigmas, and
# degrees.
_CALLED_SIGMAS, _CALLED_DEG = 3.5, 1.5
# Share of the edges' contradiction that may be left: what moved cameras do not explain has another cause, such as
# furniture that is not square. Of a real calibration that was 3.4° off 0.1 was left.
_MAX_LEFT = 0.5
# How much worse people may fit where the edges move cameras.
_PEOPLE_COST = 1.05


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


@dataclass(frozen=True)
class EdgeRefinement:
    """Cameras refined on edges and people together.

    Attributes:
        cameras: aligned to the given ones.
        before_deg, off_deg: contradiction of the edges before, and what is left of it.
        between_deg: half of the 95 % interval of the rotation between any two of them.
        people_px: median error of people's keypoints before and after.
        fits_people: whether people fit almost as well.
    """

    cameras: list[Camera]
    before_deg: float
    off_deg: float
    between_deg: float
    people_px: tuple[float, float]
    fits_people: bool

    @property
    def is_required(self) -> bool:
        """Whether the edges require these cameras instead of the given ones."""
        return self.fits_people and self.off_deg <= _MAX_LEFT * self.before_deg


def refine_on_edges(
    given: Sequence[Camera],
    adjusted: Sequence[Camera],
    before: EdgeContradiction,
    seen: Observations,
    rooms: Sequence[RoomPicture | None],
    limits: Limits,
    bundle: BundleSettings,
) -> EdgeRefinement | None:
    """``adjusted`` cameras refined on the edges in ``rooms`` and people, with the ``given`` ones as prior; None without
    edges."""
    free = replace(bundle, prior_deg=FREE_DEG, prior_m=FREE_M)
    found = refine_on_room(adjusted, given, seen, rooms, limits, free, people_cost=_PEOPLE_COST)
    if found is None:
        return None
    cameras = remove_drift(found.cameras, given)[0]
    after = edge_contradiction(cameras, edge_rotations(cameras, rooms))
    known_deg = ABOUT_ALL_AXES * rotation_interval_deg(np.degrees(found.adjusted.sigma[:, :3]).max(1))
    px = found.report["people_px_before"], found.report["people_px_after"]
    off_deg = 0.0 if after is None else after.off_deg
    return EdgeRefinement(cameras, before.off_deg, off_deg, known_deg, px, found.fits_people)
