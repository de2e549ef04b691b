# SPDX-License-Identifier: Apache-2.0
"""What people and the room changed of the given cameras, for the report and the log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from studiorecon.progress import say, warn
from studiorecon.rig.calibrated import CalibratedEstimate, pose_changes
from studiorecon.rig.room_evidence import edge_contradiction, edge_rotations
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera


def estimate_report(
    found: CalibratedEstimate, given: Sequence[Camera], rooms: Sequence[RoomPicture | None]
) -> dict[str, Any]:
    """The entries of ``refinement.json`` about an estimate of the ``given`` cameras that see people."""
    known, room = found.intervals, found.found.room
    degrees, metres = pose_changes(found.cameras, given)
    names = [c.name for c in given]
    report: dict[str, Any] = {
        "freedom": found.freedom,
        "refined": found.freedom != "given",
        "costs": {name: one.solution.cost for name, one in found.by_people.items()},
        "between_deg": known.between_deg,
        "open_deg": found.open_deg(given)[1],
        "sigma_deg": dict(zip(names, known.turn_deg.tolist())),
        "sigma_m": dict(zip(names, known.place_m.tolist())),
        "moved_cameras": found.freedom == "moved",
        "room": {"places": 0 if room.marks is None else int(room.marks.pixels.shape[1])},
        "changes": [
            {
                "camera": old.name,
                "turned_deg": float(turned),
                "moved_m": float(moved),
                "focal_longer": new.focal_px[0] / old.focal_px[0] - 1,
                "radial_k1": float(k1),
            }
            for old, new, turned, moved, k1 in zip(given, found.cameras, degrees, metres, found.radial, strict=True)
        ],
    }
    before = edge_contradiction(given, edge_rotations(given, rooms)) if len(rooms) else None
    if before is not None:
        after = edge_contradiction(found.cameras, edge_rotations(found.cameras, rooms))
        report["edges"] = {
            "cameras": before.cameras,
            "off_deg": before.off_deg,
            "off_sigmas": before.sigmas,
            "off_after_deg": before.off_deg if after is None else after.off_deg,
            "between_deg": known.between_deg,
            "believed": bool(room.turns) and found.freedom != "given",
        }
    return report


def log_changes(report: dict[str, Any]) -> None:
    """Log what ``estimate_report`` holds."""
    if not report["refined"]:
        say(
            "the cameras stay unchanged: people and the room do not require others than given; by people alone, "
            f"rotations between cameras would be uncertain by ±{report['open_deg']:.1f}° (95 %)"
        )
        return
    changes, edges = report["changes"], report.get("edges", {})
    by = ["people's keypoints"]
    by += ["the room's straight edges"] if edges.get("believed") else []
    by += [f"{report['room']['places']} matches on the floor"] if report["room"]["places"] else []
    moves = ", ".join(f"{c['camera']} by {c['turned_deg']:.2f}° and {1000 * c['moved_m']:.0f} mm" for c in changes)
    how = f"{moves}; rotations between cameras are uncertain by ±{report['between_deg']:.1f}° (95 %)"
    if report["moved_cameras"]:
        worst_m = max(report["sigma_m"].values())
        warn(
            f"cameras have moved since calibration, by {', '.join(by)}: {how}, positions by ±{100 * worst_m:.0f} cm "
            "(one standard deviation); calibrate again if that is not enough"
        )
    else:
        say(
            f"the cameras were refined on {', '.join(by)}: {how} if the calibration was right within its error, "
            f"±{report['open_deg']:.1f}° by people alone"
        )
    if report["freedom"] in ("focal", "radial"):
        say(
            "keypoints show other focal lengths: "
            + ", ".join(f"{c['camera']} {c['focal_longer']:+.1%}" for c in changes)
        )
    if report["freedom"] == "radial":
        found = ", ".join(f"{c['camera']}: {c['radial_k1']:.3f}" for c in changes)
        say(
            f"keypoints show another lens distortion than the calibration: set calibration.radial: {{{found}}} and "
            "run again"
        )
