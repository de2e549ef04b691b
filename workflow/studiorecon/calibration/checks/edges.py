# SPDX-License-Identifier: Apache-2.0
"""Checks a calibration that fits people against the room's straight edges, before refinement and after."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from studiorecon.rig.refined_cameras import RefinedCameras
from studiorecon.rig.room_evidence import edge_contradiction, edge_rotations
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera

# With a larger error a camera is 20 cm off at three metres: films would show it, whether edges or people are right.
_FAR_DEG = 4.0


def compare_edges(
    given: Sequence[Camera], refined: RefinedCameras | None, rooms: Sequence[RoomPicture | None]
) -> dict[str, Any] | None:
    """The edges' contradiction to the ``given`` cameras, and to them after refinement on people and the room.

    None without a picture of the room. ``clear``: the edges contradict the given cameras by more than their noise;
    ``mended``: no longer after refinement.
    """
    if all(room is None for room in rooms):
        return None
    before = edge_contradiction(given, edge_rotations(given, rooms))
    if before is None:
        return {"comparable": False, "clear": False}
    after = before if refined is None else edge_contradiction(refined.cameras, edge_rotations(refined.cameras, rooms))
    return {
        "comparable": True,
        "clear": before.clear,
        "cameras": before.cameras,
        "off_deg": before.off_deg,
        "sigma_deg": before.off_deg / before.sigmas,
        "mended": before.clear and after is not None and not after.clear,
        "after_deg": None if after is None else after.off_deg,
        "between_deg": None if refined is None else refined.estimate.intervals.between_deg,
        "moves": {} if refined is None else refined.as_json(given)["moves"],
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
        return (
            f"{said}, and refinement does not correct that; check that the lines in these "
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
