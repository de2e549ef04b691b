# SPDX-License-Identifier: Apache-2.0
"""Improves an estimate of cameras from people by evidence of the empty room, where people agree."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.calibration.room_pictures import without_distortion
from studiorecon.estimate.intervals import camera_intervals
from studiorecon.progress import say
from studiorecon.rig.estimate import RigEstimate, RoomEvidence, add_room_evidence
from studiorecon.rig.floor_marks import floor_marks
from studiorecon.rig.gravity import world_from_people
from studiorecon.rig.lens_knowledge import distort_marks, undistort_points
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.rig.room_turns import room_turns
from studiorecon.scene.camera import Camera, Lens

if TYPE_CHECKING:
    from jaxtyping import Num

# Largest distance between the cameras' floors, metres: by the uncertainty from people, then by the remaining one.
_FLOOR_REACH_M = (0.30, 0.12, 0.12)


def _straight_rooms(found: RigEstimate, rooms: Mapping[str, RoomPicture]) -> list[RoomPicture | None]:
    """Pictures of the room as the estimated pinholes show it."""
    straight = {
        c.name: without_distortion(rooms[c.name], radial_lens(c, k1), c) if k1 else rooms[c.name]
        for c, k1 in zip(found.cameras, found.radial)
        if c.name in rooms
    }
    return [straight.get(c.name) for c in found.cameras]


def radial_lens(camera: Camera, radial: float) -> Lens:
    """The lens of ``camera`` with k1 ``radial``, at its pose."""
    distortion = np.array([radial] + 7 * [0.0])
    return Lens(camera.name, camera.wh, camera.intrinsics, "opencv", distortion, camera.camera_from_world, np.eye(2, 3))


def with_edges(
    found: RigEstimate,
    template_m: Num[np.ndarray, "12 3"],
    edges: Mapping[str, Num[np.ndarray, "N 4"]],
) -> RigEstimate:
    """The estimate with the room's edges, where these have three directions and people agree, else unchanged."""
    own = {v: edges[c.name] for v, c in enumerate(found.cameras) if c.name in edges}
    spread = float(np.median(camera_intervals(found.solution).focal))
    tried = []
    # People may leave focal lengths uncertain, and at a wrong one the edges have no three directions.
    for factor in np.exp(spread * np.array([0.0, -1.0, 1.0])):
        cameras = [replace(c, intrinsics=c.intrinsics * _focal_scaling(factor)) for c in found.cameras]
        ends = {
            v: undistort_points(e.reshape(-1, 2), cameras[v], found.radial[v]).reshape(-1, 4) for v, e in own.items()
        }
        tried.append(room_turns(dict(enumerate(cameras)), {v: e[np.isfinite(e).all(1)] for v, e in ends.items()}))
    turns = max(tried, key=lambda found: sum(turn.along for turn in found.values()))
    if not turns:
        return found
    after, allowed = add_room_evidence(found, template_m, RoomEvidence(turns, own))
    if not allowed:
        say(f"the room's edges are not used, because people contradict them ({_cost_increase(found, after)})")
    return after if allowed else found


def _focal_scaling(factor: float) -> np.ndarray:
    return np.where(np.diag([True, True, False]), factor, 1.0)


def with_floor(
    found: RigEstimate, template_m: Num[np.ndarray, "12 3"], rooms: Mapping[str, RoomPicture]
) -> RigEstimate:
    """The estimate with the floor's marks, where people agree; else unchanged. Better cameras match the marks again."""
    best = found
    for reach_m in _FLOOR_REACH_M:
        seen = best.rig.seen
        upright = world_from_people(best.points_m, seen.group, seen.frame, seen.keypoint, best.room_directions)
        if upright is None:
            return best
        rig_from_world = np.linalg.inv(upright[0])
        cameras = [replace(c, camera_from_world=c.camera_from_world @ rig_from_world) for c in best.cameras]
        marks = floor_marks(cameras, _straight_rooms(best, rooms), np.zeros(2), 0.0, reach_m)
        if marks is None:
            return best
        marks = distort_marks(marks, best.cameras, best.radial)
        after, allowed = add_room_evidence(found, template_m, replace(found.room, marks=marks))
        if not allowed:
            say(f"the floor is not used, because people contradict it ({_cost_increase(found, after)})")
            return found
        best = after
    return best


def _cost_increase(found: RigEstimate, after: RigEstimate) -> str:
    return f"the cost of their keypoints rises by {after.people_cost - found.people_cost:.0f}"
