# SPDX-License-Identifier: Apache-2.0
"""Predicts how people and the room would refine the cameras, before anything expensive and without moving any."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from studiorecon.geometry.camera_motion import PoseError
from studiorecon.geometry.triangulation import Limits
from studiorecon.rig.active_cameras import shared_frames
from studiorecon.rig.agreement import error_medians
from studiorecon.rig.calibrated import CalibratedEstimate, estimate_calibrated, pose_changes
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

# The same number as in ``cameras.refine``.
_FRAMES = 96


@dataclass(frozen=True)
class RefinedCameras:
    """Cameras as refinement would use them.

    Attributes:
        cameras: all of them; ``px``: their median error.
        estimate: of those that see people.
        disagreement_deg, between_deg: degrees by which people alone would turn two cameras (0 where they are moved),
            and half of the 95 % interval of such rotations.
    """

    cameras: list[Camera]
    px: float
    estimate: CalibratedEstimate
    disagreement_deg: float
    between_deg: float

    @property
    def has_moved(self) -> bool:
        """Whether the cameras are clearly at other poses than given."""
        return self.estimate.freedom == "moved"

    def as_json(self, given: Sequence[Camera]) -> dict[str, Any]:
        """The numbers, with the moves of cameras that see people from their given poses."""
        degrees, metres = pose_changes(self.cameras, given)
        own = {c.name for c in self.estimate.cameras}
        return {
            "px": self.px,
            "elsewhere": self.has_moved,
            "better": self.estimate.freedom != "given",
            "moves": {
                c.name: {"turned_deg": d, "moved_m": m}
                for c, d, m in zip(given, degrees.tolist(), metres.tolist(), strict=True)
                if c.name in own
            },
            "disagreement_deg": self.disagreement_deg,
            "between_deg": self.between_deg,
        }


def refine_on_people(
    cameras: Sequence[Camera],
    detections: Sequence[Detections],
    watched: Sequence[int],
    median_px: float | None,
    allowed_px: float,
    gate_m: float,
    limits: Limits,
    error: PoseError,
    rooms: Sequence[RoomPicture | None] = (),
) -> RefinedCameras | None:
    """The refinement of ``cameras``; None where people show too little.

    ``watched`` are the indices of the cameras that see them. ``median_px``: their median error at the given poses, None
    where no three cameras agree; ``allowed_px``: the limit once moved cameras are corrected. ``rooms``: pictures of the
    room, where there are any.
    """
    if len(watched) < 2:
        return None
    given = [cameras[v] for v in watched]
    found = estimate_calibrated(
        given,
        [detections[v] for v in watched],
        shared_frames(detections, _FRAMES),
        *(gate_m, limits, error, median_px is None or not median_px < allowed_px),
        [rooms[v] for v in watched] if len(rooms) else (),
    )
    if found is None:
        return None
    px = error_medians(found.cameras, found.seen, limits)[0]
    if found.freedom == "moved" and not px < allowed_px:
        return None
    everywhere = list(cameras)
    for v, camera in zip(watched, found.cameras, strict=True):
        everywhere[v] = camera
    disagreement_deg, between_deg = found.open_deg(given)
    if found.freedom == "moved":
        disagreement_deg, between_deg = 0.0, found.intervals.between_deg
    return RefinedCameras(everywhere, px if np.isfinite(px) else 0.0, found, disagreement_deg, between_deg)
