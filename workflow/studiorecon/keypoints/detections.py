# SPDX-License-Identifier: Apache-2.0
"""Converts keypoints, from files or the detector, to tracked detections in undistorted pixels of a camera."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.footage.source import FootageSource
from studiorecon.geometry.lens import (
    calibration_from_video_pixels,
    lens_with_pixel_map,
    working_from_calibration,
    working_from_video,
)
from studiorecon.keypoints.temporal_smoothing import smooth_keypoints
from studiorecon.keypoints.tracking import TrackingLimits, drop_duplicates, track_ids
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.capture import Footage
from studiorecon.scene.people import Detections
from studiorecon.scene.raw_detections import RawDetections
from studiorecon.scene.recorded_keypoints import RecordedKeypoints

if TYPE_CHECKING:
    from jaxtyping import Num


@dataclass(frozen=True)
class DetectionLimits:
    """Thresholds of a detection; with fewer than ``min_keypoints`` keypoints left it is dropped."""

    min_confidence: float = setting(0.1, "Keypoints below this confidence are dropped.", minimum=0, maximum=1)
    min_keypoints: int = 6


@dataclass(frozen=True)
class Settings(DetectionLimits):
    """How recorded keypoints are read, and when two detections are the same person.

    Attributes:
        keypoint_centres: coordinate of the first pixel's centre in the files; most detectors count from 0.
    """

    keypoint_pixels: Literal["auto", "video", "calibration"] = setting(
        "auto", "Picture of the keypoint coordinates; auto = the one that people fit."
    )
    keypoint_centres: float = 0.0
    tracking: TrackingLimits = TrackingLimits()


def to_working_pixels(
    keypoints: Num[np.ndarray, "D K 3"], lens: Lens, footage: Footage, settings: Settings
) -> Num[np.ndarray, "D K 3"]:
    """Undistorted working pixels of recorded keypoints; NaN with confidence 0 where missing.

    Missing are keypoints at exactly (0, 0), of low or no confidence, and those beyond the lens's fold. Scores above 1
    (some detectors give up to 6) are clipped.
    """
    recorded = keypoints[..., :2]
    confidence = np.clip(keypoints[..., 2], 0.0, 1.0)
    present = (confidence >= settings.min_confidence) & (confidence > 0) & (recorded != 0).any(-1)
    pixels = np.where(present[..., None], recorded, 1.0) + (0.5 - settings.keypoint_centres)
    mapped = not (lens.placed or np.array_equal(lens.calibration_from_video, np.eye(2, 3)))
    if settings.keypoint_pixels == "calibration" or (
        settings.keypoint_pixels == "auto" and (mapped or lens.keypoints_calibrated)
    ):
        working, valid = working_from_calibration(pixels, lens, np.array(footage.intrinsics))
    else:
        working, valid = working_from_video(pixels, lens, footage.source_wh, np.array(footage.intrinsics))
    present &= valid
    return np.concatenate(
        [np.where(present[..., None], working, np.nan), np.where(present, confidence, 0.0)[..., None]], axis=-1
    )


def detections_from_recorded(
    recorded: RecordedKeypoints, lens: Lens, footage: Footage, settings: Settings
) -> Detections:
    """Detections of one camera with track ids; ``recorded`` in its film's frames, with a layout."""
    frame = recorded.frame - footage.first_source_frame
    inside = (frame >= 0) & (frame < footage.frames)
    frame = frame[inside]
    keypoints = to_working_pixels(recorded.keypoints[inside], lens.of_keypoints, footage, settings)
    layout = recorded.layout
    return track_detections(
        Detections(footage.camera, layout, frame, np.zeros_like(frame), keypoints), settings, footage.fps
    )


def detections_from_detector(found: RawDetections, lens: Lens, footage: Footage, settings: Settings) -> Detections:
    """Detections of the detector's output ``found``, in pixels and frames of the footage, smoothed over time."""
    rows = np.flatnonzero(
        (found.frame >= footage.first_source_frame) & (found.frame < footage.first_source_frame + footage.frames)
    )
    in_video = replace(settings, keypoint_pixels="video", keypoint_centres=0.5)
    keypoints = to_working_pixels(found.keypoints[rows], lens, footage, in_video)
    frame = found.frame[rows] - footage.first_source_frame
    given = Detections(
        footage.camera, found.layout, frame, np.zeros_like(frame), keypoints, points_m=found.points_m[rows], row=rows
    )
    return smooth_keypoints(track_detections(given, settings, footage.fps), footage.fps)


def as_filmed(camera: str, filmed: FootageSource, frames: int, pixel_map: str = "[]") -> tuple[Lens, Footage]:
    """Lens and footage whose working pixels are the video's own: a pinhole of any focal length maps them to
    themselves. ``pixel_map`` (JSON): [scale, x, y] of ``Dataset.pixel_maps``, or []."""
    wh = filmed.wh
    intrinsics = np.array([[max(wh), 0, wh[0] / 2], [0, max(wh), wh[1] / 2], [0, 0, 1.0]])
    lens = Lens(camera, wh, intrinsics, "opencv", np.zeros(8), np.eye(4), np.eye(2, 3))
    return lens_with_pixel_map(lens, json.loads(pixel_map)), Footage(
        camera, False, wh, intrinsics.tolist(), filmed.fps, frames, 0, filmed.path.name, "", wh, 0, 0.0, []
    )


def track_detections(given: Detections, settings: Settings, fps: float) -> Detections:
    """``given`` with track ids, without detections that are too small or duplicates."""
    kept = given.only((given.keypoints[..., 2] > 0).sum(-1) >= settings.min_keypoints)
    kept = kept.only(drop_duplicates(kept.frame, kept.keypoints, settings.tracking))
    return replace(kept, track=track_ids(kept.frame, kept.keypoints, settings.tracking, fps))


def to_pinhole(seen: Detections, lens: Lens, wh: tuple[int, int]) -> tuple[Camera, Detections]:
    """The pinhole camera of the video's size, and the detections in its pixels, within the lens's field."""
    affine, lens = calibration_from_video_pixels(lens, wh), lens.of_keypoints
    intrinsics = np.diag([lens.intrinsics[0, 0] / affine[0, 0], lens.intrinsics[1, 1] / affine[1, 1], 1.0])
    intrinsics[:2, 2] = (lens.intrinsics[:2, 2] - affine[:, 2]) / np.diag(affine)
    present = seen.keypoints[..., 2] > 0
    given = np.where(present[..., None], seen.keypoints[..., :2], 1.0)
    if lens.keypoints_calibrated:
        pixels, valid = working_from_calibration(given, lens, intrinsics)
    else:
        pixels, valid = working_from_video(given, lens, wh, intrinsics)
    points = np.concatenate(
        [
            np.where((present & valid)[..., None], pixels, np.nan),
            np.where(present & valid, seen.keypoints[..., 2], 0.0)[..., None],
        ],
        -1,
    )
    return Camera(lens.name, wh, intrinsics, lens.camera_from_world), Detections(
        lens.name, seen.layout, seen.frame, seen.track, points
    )
