# SPDX-License-Identifier: Apache-2.0
"""Compares the given calibration with the people that the cameras see: finds moved cameras, refuses wrong files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.rig.agreement import AgreementLimits, CalibrationPrior, contradicted_share, error_medians
from studiorecon.rig.calibrated import CalibratedEstimate, estimate_calibrated
from studiorecon.rig.correspondences import Observations, TrackGraph, make_observations
from studiorecon.rig.human_size import check_units
from studiorecon.rig.hypotheses import check_conventions, refuse_swapped
from studiorecon.rig.lens_knowledge import undistort_tracks
from studiorecon.rig.outlier_camera import find_outlier_camera
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

_MAX_CONTRADICTED = 0.5
# Share of the allowed error above which a swap of cameras is tested, and that moved cameras must reach.
_SUSPICIOUS = 0.5


@dataclass(frozen=True)
class Settings(AgreementLimits, CalibrationPrior):
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
        seen, graph: observations of people, and the distances of their tracks' rays.
        median_px, per_camera_px: median reprojection errors of all and of every camera; NaN and None where
            unknown.
        points_m: (N, 3) triangulated keypoints.
        settings: limits of agreement.
    """

    given: list[Camera]
    detections: Sequence[Detections]
    frames: Integer[np.ndarray, " F"]
    seen: Observations
    graph: TrackGraph
    median_px: float
    per_camera_px: list[float | None]
    points_m: Float[np.ndarray, "N 3"]
    settings: Settings

    @property
    def limit_px(self) -> float:
        """The largest error that is allowed."""
        return self.settings.limit_px(self.given, self.points_m)

    def estimate(
        self, watched: Sequence[int], rooms: Sequence[RoomPicture | None]
    ) -> tuple[CalibratedEstimate, list[Camera], Observations] | None:
        """What people in the cameras ``watched`` and the room require, and all cameras and observations by that; None
        where they show too little, or too little agrees with moved cameras."""
        settings = self.settings
        if not settings.refine:
            return None
        allowed_px = _SUSPICIOUS * self.limit_px
        # The others still agree if one of them was knocked.
        alone = any(e is None and len(d.frame) for e, d in zip(self.per_camera_px, self.detections))
        lost = alone or not self.median_px < allowed_px
        found = estimate_calibrated(
            [self.given[v] for v in watched],
            [self.detections[v] for v in watched],
            *(self.frames, settings.gate_m, settings.limits, settings.pose_error, lost),
            [rooms[v] for v in watched] if len(rooms) else (),
        )
        if found is None:
            return None
        px = error_medians(found.cameras, found.seen, settings.limits)[0]
        if found.freedom == "moved" and not px < allowed_px:
            return None
        cameras, radial = list(self.given), np.zeros(len(self.given))
        for v, camera, k1 in zip(watched, found.cameras, found.radial, strict=True):
            cameras[v], radial[v] = camera, k1
        straight = undistort_tracks(self.detections, cameras, radial)
        return found, cameras, make_observations(straight, cameras, self.frames, settings.gate_m)[0]

    def refuse_conventions(self) -> list:
        """Scores of other readings of the calibration; raises UserError where one of them is right, or where
        lengths are in another unit."""
        settings, few = self.settings, self.frames[:: max(1, len(self.frames) // 6)]
        tried = check_conventions(self.given, self.detections, few, settings.gate_m)
        if len(self.given) > 2 and not len(self.points_m):
            check_units(self.given, self.detections, few, settings.gate_m, settings.limits)
        return tried

    def refuse_cameras(self, moved_px: float) -> None:
        """UserError where cameras were exchanged, one of them contradicts the others, or three never agree;
        ``moved_px``: error of moved cameras that are put right, inf where none were moved."""
        settings, gate_m, moved = self.settings, self.settings.gate_m, np.isfinite(moved_px)
        if not self.median_px < _SUSPICIOUS * self.limit_px:
            about = settings.limits, self.median_px, moved_px
            refuse_swapped(self.given, self.detections, self.frames, gate_m, *about)
        doubtful = moved or not len(self.points_m)
        if doubtful or any(e is None or e > self.limit_px for e in self.per_camera_px):
            odd = find_outlier_camera(self.given, self.detections, self.frames, gate_m, settings.limits)
            # A knocked camera and one with a cropped picture look the same; the former is corrected.
            if odd is not None and (not moved or (odd.cause and not odd.turned)):
                raise UserError(odd.sentence())
        if not moved and len(self.given) > 2 and not len(self.points_m):
            share = contradicted_share(self.given, self.seen, self.detections, settings.limits)
            if share > _MAX_CONTRADICTED:
                raise UserError(
                    "the calibration does not fit the footage: no keypoint agrees in three cameras, and in "
                    f"{share:.0%} of the cases a third camera contradicts two that agree; check that it is for "
                    "these cameras, and that the videos are synchronised"
                )
