# SPDX-License-Identifier: Apache-2.0
"""Refines cameras on the room's floor, if they are about where they were calibrated, and keeps the floor level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from studiorecon.cameras.changes import changes_since_refinement
from studiorecon.geometry.bundle import BundleSettings
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.progress import say
from studiorecon.rig.correspondences import Observations
from studiorecon.rig.floor_alignment import align_to_floor, fit_floor
from studiorecon.rig.floor_marks import floor_marks
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.rig.room_refinement import CALLED_SIGMAS, refine_on_room, standing_area
from studiorecon.scene.camera import Camera

# Largest difference of a slightly wrong floor between cameras, metres: at first, and after its use.
_ROOM_REACH_M = (0.15, 0.08)
# How much worse people may fit where the floor moves cameras that were about right. On a real take they fitted 12 %
# worse, and an omitted camera's view was drawn 0.2 dB worse.
_PEOPLE_COST = 1.05


def apply_floor_refinement(
    given: list[Camera],
    adjusted: list[Camera],
    seen: Observations,
    rooms: Sequence[RoomPicture | None],
    report: dict[str, Any],
    limits: Limits,
    bundle: BundleSettings,
) -> tuple[list[Camera], dict[str, Any]]:
    """The cameras, refined on the room's floor too, if the floor is consistent and people fit as well."""
    # Nearly always the cameras are right, and one comparison of the floor shows it.
    marks = floor_marks(adjusted, rooms, *standing_area(adjusted, seen, limits), _ROOM_REACH_M[0])
    if marks is None:
        return adjusted, report
    if (error_sigmas := marks.error_sigmas(adjusted, limits)) < CALLED_SIGMAS:
        places = int(marks.pixels.shape[1])
        say(
            f"the floor's pattern agrees with the cameras: {places} matches are {error_sigmas:.1f} standard "
            "deviations off"
        )
        return adjusted, {**report, "room": {"places": places, "off_sigmas_before": error_sigmas, "believed": False}}
    about = [replace(g, intrinsics=a.intrinsics) for g, a in zip(given, adjusted)]
    found = refine_on_room(adjusted, about, seen, rooms, limits, bundle, _ROOM_REACH_M, _PEOPLE_COST)
    if found is None:
        return adjusted, report
    report = {**report, "room": found.report}
    pairs = f"{found.report['places']} matches on the floor"
    before, after = found.report["off_sigmas_before"], found.report["off_sigmas_after"]
    if not found.is_required:
        say(
            f"{pairs} do not refine the cameras: they are {before:.1f} standard deviations off, {after:.1f} after, "
            f"and people's keypoints {found.report['people_px_before']:.2f} px before, "
            f"{found.report['people_px_after']:.2f} px after"
        )
        return adjusted, report
    changes = changes_since_refinement(given, found.cameras, report)
    say(
        f"the cameras were refined on {pairs}, {before:.1f} of their own standard deviations off before, {after:.1f} "
        "after: "
        + ", ".join(f"{c['camera']} by {c['turned_deg']:.2f}° and {1000 * c['moved_m']:.0f} mm" for c in changes)
    )
    return found.cameras, {**report, "refined": True, "reason": "the room's floor requires it", "changes": changes}


def keep_floor_level(
    given: list[Camera], adjusted: list[Camera], seen: Observations, report: dict[str, Any], limits: Limits
) -> tuple[list[Camera], dict[str, Any]]:
    """The refined cameras, moved together so that the floor under people keeps its tilt and height."""
    if not report["refined"] or not len(seen.frame):
        return adjusted, report
    before, after = (triangulate(seen.pixels, seen.confidence, c, limits) for c in (given, adjusted))
    both = before.verified & after.verified if len(given) > 2 else before.valid & after.valid
    risen = fit_floor(before.points_m[both], after.points_m[both, 2] - before.points_m[both, 2])
    if risen is None:
        return adjusted, report
    level, tilt_deg, lift_m = align_to_floor(adjusted, risen, np.median(before.points_m[both, :2], axis=0))
    if tilt_deg or lift_m:
        say(f"refinement tilted the floor by {tilt_deg:.2f}° and lifted it by {1000 * lift_m:.0f} mm, which is undone")
    return level, {**report, "levelled": {"tilt_deg": tilt_deg, "lift_m": lift_m}}
