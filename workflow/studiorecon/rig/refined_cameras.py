# SPDX-License-Identifier: Apache-2.0
"""All cameras of a calibration as people and the room require them of those that see people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.rig.agreement import RefinementLimits, error_medians
from studiorecon.rig.calibrated import CalibratedEstimate, estimate_calibrated, pose_changes
from studiorecon.rig.lens_knowledge import undistort_tracks
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Integer


@dataclass(frozen=True)
class RefinedCameras:
    """Cameras as refinement uses them.

    Attributes:
        cameras: all of them; ``detections``: without the distortion that the calibration left.
        px: their median error.
        estimate: of those that see people.
        disagreement_deg, between_deg: degrees by which people alone would turn two cameras (0 where they are moved),
            and half of the 95 % interval of such rotations.
    """

    cameras: list[Camera]
    detections: Sequence[Detections]
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


def refine_cameras(
    cameras: Sequence[Camera],
    detections: Sequence[Detections],
    watched: Sequence[int],
    frames: Integer[np.ndarray, " F"],
    px: tuple[float | None, Sequence[float | None]],
    allowed_px: float,
    limits: RefinementLimits,
    rooms: Sequence[RoomPicture | None] = (),
) -> RefinedCameras | None:
    """The refinement of ``cameras``; None where people show too little, or too few agree with moved cameras.

    ``watched`` are the indices of the cameras that see them. ``px``: their median error at the given poses, None where
    no three cameras agree, and that of each camera; ``allowed_px``: the limit once moved cameras are corrected.
    ``rooms``: pictures of the room, where there are any.
    """
    if len(watched) < 2:
        return None
    given = [cameras[v] for v in watched]
    # The others still agree if one of them was knocked.
    alone = any(e is None and len(d.frame) for e, d in zip(px[1], detections, strict=True))
    lost = alone or px[0] is None or not px[0] < allowed_px
    seen = [detections[v] for v in watched]
    found = estimate_calibrated(
        *(given, seen, frames, limits.gate_m, limits.limits, limits.pose_error, lost),
        [rooms[v] for v in watched] if len(rooms) else (),
    )
    if found is None:
        return None
    after_px = error_medians(found.cameras, found.seen, limits.limits)[0]
    if found.freedom == "moved" and not after_px < allowed_px:
        return None
    everywhere, radial = list(cameras), np.zeros(len(cameras))
    for v, camera, k1 in zip(watched, found.cameras, found.radial, strict=True):
        everywhere[v], radial[v] = camera, k1
    disagreement_deg, between_deg = found.open_deg(given)
    if found.freedom == "moved":
        disagreement_deg, between_deg = 0.0, found.intervals.between_deg
    straight = undistort_tracks(detections, everywhere, radial)
    after_px = after_px if np.isfinite(after_px) else 0.0
    return RefinedCameras(everywhere, straight, after_px, found, disagreement_deg, between_deg)
