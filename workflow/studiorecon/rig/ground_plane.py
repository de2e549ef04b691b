# SPDX-License-Identifier: Apache-2.0
"""Aligns a rig from people to the one floor that all of its cameras see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.bundle import BundleResult, LensPrior
from studiorecon.progress import say
from studiorecon.rig.bundle import AgreementLimits
from studiorecon.rig.floor_marks import FloorMarks, floor_marks
from studiorecon.rig.from_tracks import Rig, Sightings, adjust_rig, refine_rig
from studiorecon.rig.gravity import world_from_people
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.rig.room_turns import RoomTurn

if TYPE_CHECKING:
    from jaxtyping import Num

# Largest distance between the cameras' floors, metres: by the uncertainty from people, then by the remaining one.
_REACH_M = (0.30, 0.12, 0.12)
# Least share of people's support to keep, largest factor on their error, and largest error of the floor in its own
# sigmas.
_KEPT_SUPPORT, _FLOOR_COSTS, _MAX_SIGMAS = 0.85, 1.35, 3.0


def align_to_ground_plane(
    rig: Rig,
    result: BundleResult,
    seen: Sightings,
    template_m: Num[np.ndarray, "12 3"],
    lens: LensPrior,
    known_px: Mapping[int, float],
    rooms: Sequence[RoomPicture | None],
    agreement: AgreementLimits,
    turns: Mapping[int, RoomTurn],
) -> tuple[Rig, BundleResult, FloorMarks | None]:
    """The rig refined on the floor too, with the floor's points; unchanged without a floor, or where people contradict
    it."""
    held, after, marks = rig, result, None
    for reach_m in _REACH_M:
        found = _marks(held, after, rooms, reach_m)
        if found is None:
            break
        cameras = dict(enumerate(after.cameras))
        for _ in range(2):
            again = refine_rig(seen, cameras, template_m, agreement.gate_m, agreement.limits, turns=turns, marks=found)
            if again is None:
                return rig, result, None
            held, (after, _) = again, adjust_rig(again, lens, agreement.limits, known_px, turns, found)
            cameras = dict(enumerate(after.cameras))
        marks = found
    if marks is None:
        return rig, result, None
    people, floor = after.error_units / result.error_units, marks.off_sigmas(after.cameras, agreement.limits)
    if held.support < _KEPT_SUPPORT * rig.support or people > _FLOOR_COSTS or floor > _MAX_SIGMAS:
        say(
            f"the floor was left out: with it people agree less ({held.support} keypoints instead of {rig.support}, "
            f"{people - 1:+.0%} error), or it contradicts itself ({floor:.1f} standard deviations)"
        )
        return rig, result, None
    return held, after, marks


def _marks(rig: Rig, result: BundleResult, rooms: Sequence[RoomPicture | None], reach_m: float) -> FloorMarks | None:
    """The floor's points in the cameras, made upright by the people on it."""
    used = rig.points.verified if len(result.cameras) > 2 else rig.points.valid
    points_m = np.full_like(rig.points.points_m, np.nan)
    points_m[used] = result.points_m
    upright = world_from_people(points_m, rig.seen.group, rig.seen.frame, rig.seen.keypoint)
    if upright is None:
        return None
    rig_from_world = np.linalg.inv(upright[0])
    cameras = [replace(c, camera_from_world=c.camera_from_world @ rig_from_world) for c in result.cameras]
    return floor_marks(cameras, rooms, np.zeros(2), 0.0, reach_m)
