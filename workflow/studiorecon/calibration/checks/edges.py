# SPDX-License-Identifier: Apache-2.0
"""Checks a calibration that fits people against the room's straight edges, before refinement and after."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from studiorecon.calibration.checks.refined import RefinedCameras, move_by_camera
from studiorecon.geometry.bundle import BundleSettings
from studiorecon.geometry.triangulation import Limits
from studiorecon.rig.correspondences import Observations
from studiorecon.rig.edge_refinement import edge_contradiction, refine_on_edges
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.rig.room_refinement import edge_rotations
from studiorecon.scene.camera import Camera

# With a larger error a camera is 20 cm off at three metres: films would show it, whether edges or people are right.
_FAR_DEG = 4.0


def compare_edges(
    given: Sequence[Camera],
    people: RefinedCameras | None,
    seen: Observations,
    rooms: Sequence[RoomPicture | None],
    limits: Limits,
    bundle: BundleSettings,
) -> dict[str, Any] | None:
    """The edges' contradiction to the ``given`` cameras, and to them after refinement on people and edges.

    None without a picture of the room. ``people``: the cameras refined on people, ``seen`` their observations where
    that is None. ``clear``: the edges contradict the given cameras by more than their noise; ``mended``: no longer
    after refinement.
    """
    if all(room is None for room in rooms):
        return None
    seen = seen if people is None else people.seen
    # The other cameras are unknown: the pictures of held-out ones are not used.
    known = [v for v, room in enumerate(rooms) if room is not None or (seen.confidence[v] > 0).any()]
    given, rooms, seen = [given[v] for v in known], [rooms[v] for v in known], seen.by(known)
    before = edge_contradiction(given, edge_rotations(given, rooms))
    if before is None:
        return {"comparable": False, "clear": False}
    moved = people is not None and (people.has_moved or people.fits_better)
    cameras = [people.cameras[v] for v in known] if people is not None and moved else given
    after = edge_contradiction(cameras, edge_rotations(cameras, rooms)) if moved else before
    mended, after_deg, between_deg, worse = False, None, None, None
    if after is not None:
        mended, after_deg = before.clear and not after.clear, after.off_deg
        # For cameras that were moved since, the edges were already used together with people.
        if after.clear and len(seen.frame) and not (people is not None and people.has_moved):
            right = refine_on_edges(given, cameras, after, seen, rooms, limits, bundle)
            if right is not None:
                worse = right.people_px[1] / right.people_px[0] - 1
            if right is not None and right.is_required:
                cameras, mended, after_deg, between_deg = right.cameras, True, right.off_deg, right.between_deg
    return {
        "comparable": True,
        "clear": before.clear,
        "cameras": before.cameras,
        "off_deg": before.off_deg,
        "sigma_deg": before.off_deg / before.sigmas,
        "mended": mended,
        "after_deg": after_deg,
        "between_deg": between_deg,
        "people_worse": worse,
        "moves": move_by_camera(cameras, given),
    }


def is_beyond_refinement(edges: dict[str, Any] | None) -> bool:
    """Whether the edges contradict the calibration by much, and refinement would not correct it."""
    return edges is not None and edges["clear"] and not edges["mended"] and edges["off_deg"] > _FAR_DEG


def edge_sentence(edges: dict[str, Any]) -> str:
    """The result of ``compare_edges`` in a sentence."""
    if not edges["comparable"]:
        return (
            "the room's straight edges do not constrain the calibration: they run along its "
            "three directions in fewer than two cameras"
        )
    pair, off, sigma = " and ".join(edges["cameras"]), edges["off_deg"], edges["sigma_deg"]
    if not edges["clear"]:
        return (
            "the room's straight edges agree with the calibration: the rotation between two cameras differs by "
            f"{off:.1f}° at most ({pair}; standard deviation {sigma:.1f}°)"
        )
    said = (
        f"the room's straight edges contradict the rotation between cameras {pair} by {off:.1f}° (standard "
        f"deviation {sigma:.1f}°)"
    )
    if not edges["mended"]:
        worse = edges["people_worse"]
        why = "" if worse is None else f": people would fit {100 * worse:.0f} % worse"
        return (
            f"{said}, and refinement does not correct that{why}; check that the lines in these "
            "pictures are square to the room; if they are, calibrate again, or let a person walk "
            "through the whole room while all cameras film"
        )
    turned = ", ".join(
        f"{c} by {m['turned_deg']:.1f}° and {100 * m['moved_m']:.0f} cm" for c, m in edges["moves"].items()
    )
    known = f", ±{edges['between_deg']:.1f}° (95 %)" if edges["between_deg"] is not None else ""
    return (
        f"{said}, and by {edges['after_deg']:.1f}° once refinement has moved the cameras ({turned}){known}; usable, "
        "with cameras.refine on; calibrate again if that is not enough"
    )
