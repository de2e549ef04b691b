# SPDX-License-Identifier: Apache-2.0
"""Corrects cameras that fit people but contradict the room's straight edges, by both (``rig.edge_refinement``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from studiorecon.cameras.changes import changes_since_refinement
from studiorecon.geometry.bundle import BundleSettings
from studiorecon.geometry.triangulation import Limits
from studiorecon.progress import say, warn
from studiorecon.rig.correspondences import Observations
from studiorecon.rig.edge_refinement import edge_contradiction, refine_on_edges
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.rig.room_refinement import edge_rotations
from studiorecon.scene.camera import Camera


def apply_edge_refinement(
    given: list[Camera],
    adjusted: list[Camera],
    seen: Observations,
    rooms: Sequence[RoomPicture | None],
    report: dict[str, Any],
    limits: Limits,
    bundle: BundleSettings,
) -> tuple[list[Camera], dict[str, Any]]:
    """The cameras, refined where the room's straight edges clearly require it and people fit almost as well."""
    before = edge_contradiction(adjusted, edge_rotations(adjusted, rooms))
    if before is None or not len(seen.frame):
        return adjusted, report
    edges: dict[str, Any] = {"cameras": before.cameras, "off_deg": before.off_deg, "off_sigmas": before.sigmas}
    report = {**report, "edges": {**edges, "believed": False}}
    if not before.clear:
        return adjusted, report
    found = refine_on_edges(given, adjusted, before, seen, rooms, limits, bundle)
    if found is None:
        return adjusted, report
    px = found.people_px
    off = f"{before.off_deg:.1f}° ({before.sigmas:.1f} standard deviations) off between {' and '.join(before.cameras)}"
    if not found.is_required:
        say(
            f"the room's straight edges are {off}, and are not used: with other cameras they would be "
            f"{found.off_deg:.1f}° off, and people's keypoints {px[1]:.2f} px, now {px[0]:.2f} px"
        )
        return adjusted, report
    changes = changes_since_refinement(given, found.cameras, report)
    warn(
        "the room's straight edges show that cameras have moved since calibration, which people "
        f"alone do not show: they are {off}, {found.off_deg:.1f}° after, and people's keypoints "
        f"{px[0]:.2f} px, {px[1]:.2f} px after; "
        + ", ".join(
            f"{c['camera']} turned by {c['turned_deg']:.1f}° and moved by {100 * c['moved_m']:.0f} cm" for c in changes
        )
        + f"; rotations between cameras are uncertain by ±{found.between_deg:.1f}° (95 %), if walls and furniture "
        "are square"
    )
    edges |= {
        "believed": True,
        "off_after_deg": found.off_deg,
        "between_deg": found.between_deg,
        "people_px_before": px[0],
        "people_px_after": px[1],
    }
    reason = "the room's straight edges require it"
    return found.cameras, {**report, "refined": True, "reason": reason, "changes": changes, "edges": edges}
