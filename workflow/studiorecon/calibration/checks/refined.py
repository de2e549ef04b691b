# SPDX-License-Identifier: Apache-2.0
"""Predicts how people would refine the cameras, before anything expensive and without moving any."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from studiorecon.geometry.bundle import BundleSettings
from studiorecon.geometry.triangulation import Limits
from studiorecon.rig.active_cameras import shared_frames
from studiorecon.rig.bundle import error_medians, fit_cameras
from studiorecon.rig.correspondences import Observations, make_observations
from studiorecon.rig.moved_cameras import pose_changes, relocalise
from studiorecon.rig.pose_uncertainty import moved_rotation_interval_deg, rotation_observability
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

# The same number as in ``cameras.refine``.
_FRAMES = 96
# People must fit better by this share before they move a camera.
_WORTH_REFINING = 0.1


@dataclass(frozen=True)
class RefinedCameras:
    """Cameras after refinement on people.

    Attributes:
        cameras: with the refined poses.
        seen: the observations of people.
        px, has_moved: their median error, and whether the cameras are clearly at other poses than given.
        fits_better: whether people fit clearly better with them, so that refinement keeps them.
        disagreement_deg, between_deg: uncertainty of the cameras' relative rotation (``rotation_observability``); None
            with too few data.
    """

    cameras: list[Camera]
    seen: Observations
    px: float
    has_moved: bool
    fits_better: bool
    disagreement_deg: float | None
    between_deg: float | None

    def as_json(self, given: Sequence[Camera]) -> dict[str, Any]:
        """The numbers, with every camera's move from its given pose."""
        return {
            "px": self.px,
            "elsewhere": self.has_moved,
            "better": self.fits_better,
            "moves": move_by_camera(self.cameras, given),
            "disagreement_deg": self.disagreement_deg,
            "between_deg": self.between_deg,
        }


def move_by_camera(cameras: Sequence[Camera], given: Sequence[Camera]) -> dict[str, dict[str, float]]:
    """camera → degrees and metres by which it was turned and moved from its given pose."""
    degrees, metres = pose_changes(cameras, given)
    return {
        c.name: {"turned_deg": float(d), "moved_m": float(m)} for c, d, m in zip(given, degrees, metres, strict=True)
    }


def refine_on_people(
    cameras: Sequence[Camera],
    detections: Sequence[Detections],
    watched: Sequence[int],
    median_px: float | None,
    allowed_px: float,
    gate_m: float,
    limits: Limits,
    bundle: BundleSettings,
    rooms: Sequence[RoomPicture | None] = (),
) -> RefinedCameras | None:
    """The refinement of ``cameras`` on people; None where it would change nothing.

    ``watched`` are the indices of the cameras that see them. ``median_px``: their median error at the given poses, None
    where no three cameras agree; ``allowed_px``: the limit once moved cameras are corrected. ``rooms``: pictures of the
    room, where there are any.
    """
    if len(cameras) < 3 or len(watched) < 2:
        return None
    chosen = shared_frames(detections, _FRAMES)
    before_px = np.nan if median_px is None else median_px
    anew = relocalise(cameras, detections, watched, chosen, gate_m, 0.0, limits, bundle, before_px, allowed_px, rooms)
    seen = make_observations(detections, cameras, chosen, gate_m)[0] if anew is None else anew.seen
    held = anew if anew is not None or not len(seen.frame) else fit_cameras(cameras, seen, limits, bundle)
    if held is None:
        return None
    px = error_medians(held.cameras, seen, limits)[0]
    described = (
        rotation_observability(cameras, seen, limits)
        if anew is None
        else (0.0, moved_rotation_interval_deg(anew, limits))
    )
    disagreement_deg, between_deg = (None, None) if described is None else described
    better = median_px is None or px < (1 - _WORTH_REFINING) * median_px
    return RefinedCameras(held.cameras, seen, px, anew is not None, better, disagreement_deg, between_deg)
