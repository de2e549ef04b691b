# SPDX-License-Identifier: Apache-2.0
"""Compares the given calibration with the people that the cameras see: finds moved cameras, refuses wrong files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.rig.bundle import (
    AgreementLimits,
    CalibrationPrior,
    LensSettings,
    choose_lens_terms,
    contradicted_share,
    fit_cameras,
)
from studiorecon.rig.correspondences import Observations, TrackGraph
from studiorecon.rig.human_size import check_units
from studiorecon.rig.hypotheses import check_conventions, refuse_swapped
from studiorecon.rig.moved_cameras import MovedCameras, relocalise
from studiorecon.rig.outlier_camera import find_outlier_camera
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

_MAX_CONTRADICTED = 0.5
# Share of the allowed error above which a swap of cameras is tested.
_SUSPICIOUS = 0.5
# How much worse other lenses at the given poses may fit than moved cameras.
_ABOUT_AS_WELL = 1.1


@dataclass(frozen=True)
class Settings(AgreementLimits, CalibrationPrior):
    """Settings of the check and refinement, on ``frames`` spread over the clip.

    Every other frame is the validation split: refined poses are kept when their median reprojection error there falls
    by the share ``min_gain``. ``lens_change`` sets when lenses may change too.
    """

    refine: bool = setting(
        True,
        "Refine camera poses on people's keypoints; kept only if frames outside the fit improve.",
        paper="none; uncalibrated cameras",
        paper_value=False,
    )
    frames: int = 96
    min_gain: float = 0.1
    lens_change: LensSettings = LensSettings()


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

    def moved_cameras(self, watched: Sequence[int], rooms: Sequence[RoomPicture | None]) -> MovedCameras | None:
        """The cameras at new poses if some were moved after calibration; None where none was, or where another lens
        explains people about as well."""
        settings = self.settings
        if not settings.refine:
            return None
        # The others still agree if one of them was knocked.
        alone = any(e is None and len(d.frame) for e, d in zip(self.per_camera_px, self.detections))
        allowed = settings.gate_m, settings.min_gain, settings.limits, settings.bundle
        before = np.nan if alone else self.median_px, _SUSPICIOUS * self.limit_px
        found = relocalise(self.given, self.detections, watched, self.frames, *allowed, *before, rooms)
        instead = found is not None and len(self.points_m) > 0 and self.lenses_explain(found.report["after_px"])
        return None if instead else found

    def lenses_explain(self, moved_px: float) -> bool:
        """Whether other lenses at nearly the given poses explain people about as well as other poses, which leave
        ``moved_px``: a zoom ring is easier to touch."""
        limits, bundle = self.settings.limits, self.settings.bundle
        fit_on, validation = split_alternate_frames(self.seen)
        trial = fit_cameras(self.given, fit_on, limits, bundle)
        if trial is None:
            return False
        about = limits, bundle, self.settings.lens_change
        found = choose_lens_terms(trial.cameras, fit_on, validation, *about)
        errors = [found[f"unseen_with_{name}_px"] for name in ("focal", "radial") if found[name]]
        return bool(errors) and min(errors) <= _ABOUT_AS_WELL * moved_px

    def refuse_conventions(self) -> list:
        """Scores of other readings of the calibration; raises UserError where one of them is right, or where
        lengths are in another unit."""
        settings, few = self.settings, self.frames[:: max(1, len(self.frames) // 6)]
        tried = check_conventions(self.given, self.detections, few, settings.gate_m)
        if len(self.given) > 2 and not len(self.points_m):
            check_units(self.given, self.detections, few, settings.gate_m, settings.limits)
        return tried

    def refuse_cameras(self, moved: MovedCameras | None) -> None:
        """UserError where cameras were exchanged, one of them contradicts the others, or three never agree; ``moved``
        ones are put right."""
        settings, gate_m = self.settings, self.settings.gate_m
        if not self.median_px < _SUSPICIOUS * self.limit_px:
            moved_px = np.inf if moved is None else moved.report["after_px"]
            about = settings.limits, self.median_px, moved_px
            refuse_swapped(self.given, self.detections, self.frames, gate_m, *about)
        doubtful = moved is not None or not len(self.points_m)
        if doubtful or any(e is None or e > self.limit_px for e in self.per_camera_px):
            odd = find_outlier_camera(self.given, self.detections, self.frames, gate_m, settings.limits)
            # A knocked camera and one with a cropped picture look the same; the former is corrected.
            if odd is not None and (moved is None or (odd.cause and not odd.turned)):
                raise UserError(odd.sentence())
        if moved is None and len(self.given) > 2 and not len(self.points_m):
            share = contradicted_share(self.given, self.seen, self.detections, settings.limits)
            if share > _MAX_CONTRADICTED:
                raise UserError(
                    "the calibration does not fit the footage: no keypoint agrees in three cameras, and in "
                    f"{share:.0%} of the cases a third camera contradicts two that agree; check that it is for "
                    "these cameras, and that the videos are synchronised"
                )


def split_alternate_frames(seen: Observations) -> tuple[Observations, Observations]:
    """The observations of every other frame, to fit on, and those of the others, for validation."""
    order = np.unique(seen.frame, return_inverse=True)[1]
    return seen.of(order % 2 == 0), seen.of(order % 2 == 1)
