# SPDX-License-Identifier: Apache-2.0
"""Calibrated cameras refined on the room itself: points on the floor, and directions of its edges.

A detector's error of a joint is always the same, so people leave cameras uncertain by tenths of a degree, or by degrees
if they stay in one place. The empty room does not depend on joints. Cameras that are a quarter turn apart share its
floor (``floor_marks``) and its directions (``room_turns``). Both are combined with people in one bundle adjustment, and
accepted where they are consistent and people fit almost as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.geometry.bundle import BundleResult, BundleSettings, move_camera
from studiorecon.geometry.camera_path import scene_centre
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.rig.bundle import AgreeingObservations, agreeing_observations, error_medians
from studiorecon.rig.correspondences import Observations
from studiorecon.rig.floor_marks import FloorMarks, floor_marks
from studiorecon.rig.gravity import ANKLE_HEIGHT_M, lower_feet
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.rig.room_turns import RoomTurn, room_turns
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Num

# Largest distance between the cameras' floors, metres: at first, and after the first refinement.
REACH_M = (0.25, 0.12)
# Bodies whose feet show the height of the floor.
_MIN_FEET = 10
# The floor is consistent within so many of its own sigmas. It requires a change above so many, if they exceed those
# afterwards by this factor; people's error may grow by the last factor.
_MAX_SIGMAS, CALLED_SIGMAS, _CLEARLY, PEOPLE_COST = 3.0, 2.0, 1.3, 1.15
# Least visible share of the room for using a picture's edges (one with 59 to 62 %, in specks, was 2.5° off).
_MIN_KNOWN = 0.7
# Edges determine rotations better than a prior of this sigma.
_WIDE_DEG = 1.0
# Sigmas of errors that points on a floor which agree to a hundredth of a degree do not show: lenses, and a floor that
# is not a plane. Edges alone agree with a laboratory's calibration to 0.3 to 0.7 degrees.
_UNSAID_DEG, _UNSAID_BY_EDGES_DEG, _UNSAID_M = 0.1, 0.5, 0.01


@dataclass(frozen=True)
class RoomRefinement:
    """Cameras refined on people and the room together.

    Attributes:
        cameras: with their poses.
        marks: shared points of the floor; None where only edges or people were used.
        adjusted: with their sigmas.
        report: numbers to report.
        fits_people: whether the room is consistent with them, and people fit almost as well.
        is_required: whether the room clearly requires them; otherwise the cameras before may stay.
    """

    cameras: list[Camera]
    marks: FloorMarks | None
    adjusted: BundleResult
    report: dict[str, Any]
    fits_people: bool
    is_required: bool

    def marks_m(self, limits: Limits) -> Num[np.ndarray, "N 3"]:
        """The points on the floor by these cameras."""
        if self.marks is None:
            return np.zeros((0, 3))
        seen = np.isfinite(self.marks.pixels).all(-1).astype(float)
        found = triangulate(self.marks.pixels, seen, self.cameras, limits)
        return found.points_m[found.valid]


def refine_on_room(
    cameras: Sequence[Camera],
    given: Sequence[Camera],
    seen: Observations,
    rooms: Sequence[RoomPicture | None],
    limits: Limits,
    bundle: BundleSettings,
    reach_m: Sequence[float] = REACH_M,
    people_cost: float = PEOPLE_COST,
) -> RoomRefinement | None:
    """``cameras`` refined on people and the room with ``given`` as prior; None where the room shows nothing.

    ``seen`` are people's joints, ``rooms`` the pictures of the room, None where there is none. The room is rejected
    where people fit ``people_cost`` times worse with it.
    """
    middle_m, floor_m = standing_area(cameras, seen, limits)
    turns = edge_rotations(cameras, rooms) if np.min(bundle.prior_deg) > _WIDE_DEG else {}
    held_deg = np.broadcast_to(bundle.prior_deg, len(cameras)).astype(float).copy()
    about = list(given)
    for v, turn in turns.items():
        held_deg[v] = turn.sigma_deg
        about[v] = move_camera(given[v], turn.rotation_camera_from_world, given[v].centre_m)
    prior = replace(bundle, prior_deg=held_deg)
    current, marks, result = list(cameras), None, None
    for reach in reach_m:
        found = floor_marks(current, rooms, middle_m, floor_m, reach)
        if found is None:
            break
        marks = found
        for _ in range(2):
            result = _fit(current, about, seen, marks, limits, prior)
            current = result.cameras
    if result is None and turns:
        result = _fit(current, about, seen, None, limits, prior)
        current = result.cameras
    if result is None:
        return None
    people_px = [error_medians(c, seen, limits)[0] if len(seen.frame) else np.nan for c in (cameras, current)]
    floor = [marks.error_sigmas(c, limits) if marks is not None else np.nan for c in (cameras, current)]
    pairs = {} if marks is None else marks.seen_by
    report = {
        "places": 0 if marks is None else int(marks.pixels.shape[1]),
        "pairs": {f"{cameras[a].name} {cameras[b].name}": n for (a, b), n in pairs.items()},
        "along_edges": {cameras[v].name: turn.along for v, turn in turns.items()},
        "off_sigmas_before": floor[0],
        "off_sigmas_after": floor[1],
        "people_px_before": people_px[0],
        "people_px_after": people_px[1],
    }
    fits_people = not people_px[1] > people_cost * people_px[0] and not floor[1] > _MAX_SIGMAS
    called = marks is None or (floor[0] >= CALLED_SIGMAS and floor[0] >= _CLEARLY * floor[1])
    is_required = bool(fits_people and called)
    unsaid = np.zeros(result.sigma.shape[1])
    unsaid[:3], unsaid[3:6] = np.radians(_UNSAID_BY_EDGES_DEG if marks is None else _UNSAID_DEG), _UNSAID_M
    result = replace(result, sigma=np.hypot(result.sigma, unsaid))
    report |= {"explained": bool(fits_people), "believed": is_required}
    return RoomRefinement(current, marks, result, report, bool(fits_people), is_required)


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


def _fit(
    current: Sequence[Camera],
    about: Sequence[Camera],
    seen: Observations,
    marks: FloorMarks | None,
    limits: Limits,
    prior: BundleSettings,
) -> BundleResult:
    """People, all frames of a joint as one observation, and the floor, adjusted with other cameras as prior."""
    people = agreeing_observations(seen, current, limits) or _nothing(len(current))
    count = len(people.points_m)
    if marks is not None:
        joined = marks.joined(people.pixels, people.weights, people.points_m, current, limits)
        people = AgreeingObservations(*joined, people.used)
    result = people.adjust(current, about, limits, prior)
    return replace(result, points_m=result.points_m[:count])


def _nothing(views: int) -> AgreeingObservations:
    return AgreeingObservations(np.zeros((views, 0, 2)), np.zeros((views, 0)), np.zeros((0, 3)), np.zeros(0, bool))
