# SPDX-License-Identifier: Apache-2.0
"""Compares the given calibration with the people that the cameras see: finds moved cameras, refuses wrong files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.rig.active_cameras import shared_frames
from studiorecon.rig.agreement import RefinementLimits, contradicted_share
from studiorecon.rig.correspondences import Observations
from studiorecon.rig.outlier_camera import find_outlier_camera
from studiorecon.rig.refined_cameras import RefinedCameras, refine_cameras
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.rig.starts import FRAMES, Comparison, Start, calibration_starts, compare
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

_MAX_CONTRADICTED = 0.5
# Share of the allowed error that moved cameras must reach.
_SUSPICIOUS = 0.5


@dataclass(frozen=True)
class Settings(RefinementLimits):
    """Settings of the check and refinement, on ``frames`` spread over the clip."""

    refine: bool = setting(
        True,
        "Refine cameras on people's keypoints and the room; kept only if these require it.",
        paper="none; uncalibrated cameras",
        paper_value=False,
    )
    frames: int = 96


@dataclass(frozen=True)
class Check:
    """The given training cameras, and how well people fit them.

    Attributes:
        given, detections: of every training camera.
        frames: frames of the check.
        seen: observations of people.
        median_px, per_camera_px: median reprojection errors of all and of every camera; NaN and None where
            unknown.
        points_m: (N, 3) triangulated keypoints.
        settings: limits of agreement.
    """

    given: list[Camera]
    detections: Sequence[Detections]
    frames: Integer[np.ndarray, " F"]
    seen: Observations
    median_px: float
    per_camera_px: list[float | None]
    points_m: Float[np.ndarray, "N 3"]
    settings: Settings

    @property
    def limit_px(self) -> float:
        """The largest error that is allowed."""
        return self.settings.limit_px(self.given, self.points_m)

    def refined(self, watched: Sequence[int], rooms: Sequence[RoomPicture | None]) -> RefinedCameras | None:
        """What people in the cameras ``watched`` and the room require; None where they show too little."""
        s = self.settings
        if not s.refine:
            return None
        px, allowed_px = (self.median_px, self.per_camera_px), _SUSPICIOUS * self.limit_px
        return refine_cameras(self.given, self.detections, watched, self.frames, px, allowed_px, s, rooms)

    def refuse_other_starts(self, found: RefinedCameras | None) -> Comparison:
        """The scores of other readings of the calibration; UserError where people require one, or where one camera
        contradicts the others; ``found``: the cameras that will be used."""
        gate_m, moved = self.settings.gate_m, found is not None and found.has_moved
        frames = shared_frames(self.detections, FRAMES)
        used = None if found is None else Start("as used", "", found.cameras, found.detections)
        compared = compare(calibration_starts(self.given, self.detections), frames, gate_m, used)
        compared.refuse_others(frames, gate_m)
        doubtful = moved or not len(self.points_m)
        if doubtful or any(e is None or e > self.limit_px for e in self.per_camera_px):
            odd = find_outlier_camera(self.given, self.detections, self.frames, gate_m, self.settings.limits)
            # A knocked camera and one with a cropped picture look the same; the former is corrected.
            if odd is not None and (not moved or (odd.cause and not odd.turned)):
                raise UserError(odd.sentence())
        if not moved and len(self.given) > 2 and len(self.seen.frame) and not len(self.points_m):
            share = contradicted_share(self.given, self.seen, self.detections, self.settings.limits)
            if share > _MAX_CONTRADICTED:
                raise UserError(
                    "the calibration does not fit the footage: no keypoint agrees in three cameras, and in "
                    f"{share:.0%} of the cases a third camera contradicts two that agree; check that it is for "
                    "these cameras, and that the videos are synchronised"
                )
        return compared
