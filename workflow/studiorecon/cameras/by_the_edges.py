# SPDX-License-Identifier: Apache-2.0
"""What the room's straight edges say of a calibration that people accept, and cameras put right by them.

One person on one spot accepts calibrations that are degrees off. The room's edges do not hang on people: those of a
real room and a motion-capture system's calibration of it differ by less than a degree between any two cameras, and a
hand-picked calibration of the same cameras, 3.4° off that system's, by 2.4°, nearly five standard deviations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from studiorecon.cameras.by_the_floor import changes_of
from studiorecon.geometry.bundle import BundleSettings, without_drift
from studiorecon.geometry.rotations import angle
from studiorecon.geometry.triangulation import Limits
from studiorecon.progress import say, warn
from studiorecon.rig.by_the_room import by_the_room, turns_of
from studiorecon.rig.certainty import ABOUT_ALL_AXES, between_deg
from studiorecon.rig.correspondences import Observations
from studiorecon.rig.floor_marks import RoomPicture
from studiorecon.rig.room_turns import RoomTurn
from studiorecon.rig.stale import FREE_DEG, FREE_M
from studiorecon.scene.camera import Camera

# Edges that two cameras share contradict how these are turned past so many of their standard deviations, and degrees.
_CALLED_SIGMAS, _CALLED_DEG = 3.5, 1.5
# How much worse people may fit where the edges move cameras.
_PEOPLE_COST = 1.05


@dataclass(frozen=True)
class Contradiction:
    """The two cameras whose edges contradict most how they are turned to one another: by how many degrees, and how many
    of the edges' own standard deviations that is."""

    cameras: tuple[str, str]
    off_deg: float
    sigmas: float


def contradiction(cameras: Sequence[Camera], turns: Mapping[int, RoomTurn]) -> Contradiction | None:
    """Where the edges contradict ``cameras`` most; None where fewer than two cameras' edges tell."""
    found = []
    for a, b in combinations(sorted(turns), 2):
        by_edges = turns[a].rotation_camera_from_world @ turns[b].rotation_camera_from_world.T
        given = cameras[a].camera_from_world[:3, :3] @ cameras[b].camera_from_world[:3, :3].T
        off = float(np.degrees(angle(by_edges, given)))
        sigmas = off / float(np.hypot(turns[a].sigma_deg, turns[b].sigma_deg))
        found.append(Contradiction((cameras[a].name, cameras[b].name), off, sigmas))
    return max(found, key=lambda one: one.sigmas, default=None)


def by_the_edges(
    given: list[Camera],
    adjusted: list[Camera],
    seen: Observations,
    rooms: Sequence[RoomPicture | None],
    report: dict[str, Any],
    limits: Limits,
    bundle: BundleSettings,
) -> tuple[list[Camera], dict[str, Any]]:
    """The cameras where the room's straight edges clearly call for others, if people are hardly the worse for it."""
    before = contradiction(adjusted, turns_of(adjusted, rooms))
    if before is None or not len(seen.frame):
        return adjusted, report
    told: dict[str, Any] = {"cameras": before.cameras, "off_deg": before.off_deg, "off_sigmas": before.sigmas}
    report = {**report, "edges": {**told, "believed": False}}
    if before.sigmas < _CALLED_SIGMAS or before.off_deg < _CALLED_DEG:
        return adjusted, report
    free = replace(bundle, prior_deg=FREE_DEG, prior_m=FREE_M)
    found = by_the_room(adjusted, given, seen, rooms, limits, free, people_cost=_PEOPLE_COST)
    if found is None:
        return adjusted, report
    cameras = without_drift(found.cameras, given)[0]
    px = [found.report[f"people_px_{when}"] for when in ("before", "after")]
    off = f"{before.off_deg:.1f}° ({before.sigmas:.1f} standard deviations) off between {' and '.join(before.cameras)}"
    if not found.explained:
        say(
            f"the room's straight edges are {off}, and move no camera: people's keypoints would be {px[1]:.2f} px off, "
            f"{px[0]:.2f} px as they stand"
        )
        return adjusted, report
    after = contradiction(cameras, turns_of(cameras, rooms))
    known_deg = ABOUT_ALL_AXES * between_deg(np.degrees(found.adjusted.sigma[:, :3]).max(1))
    changes = changes_of(given, cameras, np.array([c["radial_k1"] for c in report.get("changes", [])] or 0.0))
    warn(
        "the room's straight edges call for cameras that stand elsewhere than the calibration says, which people alone "
        f"do not tell: they are {off}, {0.0 if after is None else after.off_deg:.1f}° after, and people's keypoints "
        f"{px[0]:.2f} px, {px[1]:.2f} px after; "
        + ", ".join(
            f"{c['camera']} turned by {c['turned_deg']:.1f}° and moved by {100 * c['moved_m']:.0f} cm" for c in changes
        )
        + f"; relative to one another they are known to ±{known_deg:.1f}° (95 %), where walls and furniture are square"
    )
    told |= {"believed": True, "between_deg": known_deg, "people_px_before": px[0], "people_px_after": px[1]}
    reason = "the room's straight edges call for it"
    return cameras, {**report, "refined": True, "reason": reason, "changes": changes, "edges": told}
