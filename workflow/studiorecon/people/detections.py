# SPDX-License-Identifier: Apache-2.0
"""``people.detections``: recorded 2D keypoints of one camera → undistorted working pixels, followed through time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.geometry.lens import working_from_calibration, working_from_video
from studiorecon.people.layout_choice import choose_layout
from studiorecon.people.readers import Entry, read_keypoints
from studiorecon.people.tracking import TrackingLimits, tracks, without_duplicates
from studiorecon.progress import say
from studiorecon.scene.camera import Lens
from studiorecon.scene.capture import Footage, read_footage
from studiorecon.scene.clocks import read_clocks
from studiorecon.scene.found import Found, is_found, read_found
from studiorecon.scene.lenses import lens_of
from studiorecon.scene.people import Detections, write_detections
from studiorecon.scene.retiming import at_the_scene_s_moments, part_used


@dataclass(frozen=True)
class Settings:
    """How recorded keypoints are read.

    Attributes:
        keypoint_pixels: the picture that keypoint coordinates refer to: that of the video file or that of the calibration;
            "auto" = calibration where the footage has a pixel map, else video.
        keypoint_centres: coordinate of the first pixel's centre in the keypoint files; detectors count from 0.
        detection_confidence: keypoints below it are dropped.
        detection_keypoints: detections with fewer keypoints left are dropped.
        tracking: when two detections are the same person.
    """

    keypoint_pixels: Literal["auto", "video", "calibration"]
    keypoint_centres: float
    detection_confidence: float
    detection_keypoints: int
    tracking: TrackingLimits


def to_arrays(entries: list[Entry], footage: Footage, first_frame: int) -> tuple[np.ndarray, np.ndarray]:
    """(D,) working frames and (D, K, 3) recorded keypoints of the detections that fall into the working frames."""
    offset = first_frame + footage.first_source_frame
    inside = [e for e in entries if 0 <= e.frame - offset < footage.frames]
    inside.sort(key=lambda e: e.frame)
    count = len(entries[0].keypoints) if entries else 0
    frames = np.array([e.frame - offset for e in inside], dtype=np.int64)
    return frames, np.array([e.keypoints for e in inside], dtype=np.float64).reshape(len(inside), count, 3)


def to_working_pixels(keypoints: np.ndarray, lens: Lens, footage: Footage, settings: Settings) -> np.ndarray:
    """(D, K, 3) undistorted working pixels of recorded keypoints; NaN with confidence 0 where missing.

    Missing are keypoints at exactly (0, 0), of low or no confidence, and those beyond the lens's fold. Scores above 1 (some
    detectors give up to 6) are clipped.
    """
    recorded = keypoints[..., :2]
    confidence = np.clip(np.where(np.isfinite(keypoints[..., 2]), keypoints[..., 2], 0.0), 0.0, 1.0)
    present = (confidence >= settings.detection_confidence) & (confidence > 0) & np.isfinite(recorded).all(-1) & (recorded != 0).any(-1)
    pixels = np.where(present[..., None], recorded, 1.0) + (0.5 - settings.keypoint_centres)
    mapped = not np.array_equal(lens.calibration_from_video, np.eye(2, 3))
    if settings.keypoint_pixels == "calibration" or (settings.keypoint_pixels == "auto" and mapped):
        working, valid = working_from_calibration(pixels, lens, np.array(footage.intrinsics))
    else:
        working, valid = working_from_video(pixels, lens, footage.source_wh, np.array(footage.intrinsics))
    present &= valid
    return np.concatenate([np.where(present[..., None], working, np.nan), np.where(present, confidence, 0.0)[..., None]], axis=-1)


def unusable(keypoints: np.ndarray) -> int:
    """How many of the recorded keypoints (D, K, 3) claim to be there and are no numbers."""
    broken = ~np.isfinite(keypoints[..., :2]).all(-1) & ~(keypoints[..., 2] <= 0)
    return int((broken | ~np.isfinite(keypoints[..., 2])).sum())


def detections_of(entries: list[Entry], layout: str, lens: Lens, footage: Footage, first_frame: int, settings: Settings) -> Detections:
    """Detections of one camera with track ids; ``first_frame``: number in the keypoint files of the video's first frame."""
    frame, recorded = to_arrays(entries, footage, first_frame)
    keypoints = to_working_pixels(recorded, lens, footage, settings)
    if broken := unusable(recorded):
        say(f"camera {footage.camera}: {broken} of {recorded[..., 0].size} keypoints are not finite, and were left out")
    return followed(Detections(footage.camera, layout, frame, np.zeros_like(frame), keypoints), settings, footage.fps)


def detections_of_found(found: Found, lens: Lens, footage: Footage, settings: Settings) -> Detections:
    """The same of what the detector found, whose pixels and frames are always those of the footage."""
    rows = np.flatnonzero((found.frame >= footage.first_source_frame) & (found.frame < footage.first_source_frame + footage.frames))
    in_video = replace(settings, keypoint_pixels="video", keypoint_centres=0.5)
    keypoints = to_working_pixels(found.keypoints[rows], lens, footage, in_video)
    frame = found.frame[rows] - footage.first_source_frame
    given = Detections(footage.camera, found.layout, frame, np.zeros_like(frame), keypoints, points_m=found.points_m[rows], row=rows)
    return followed(given, settings, footage.fps)


def followed(given: Detections, settings: Settings, fps: float) -> Detections:
    """``given`` without what is too little or found twice, and with track ids."""
    kept = given.only((given.keypoints[..., 2] > 0).sum(-1) >= settings.detection_keypoints)
    kept = kept.only(without_duplicates(kept.frame, kept.keypoints, settings.tracking))
    return replace(kept, track=tracks(kept.frame, kept.keypoints, settings.tracking, fps))


def run(
    settings: Settings,
    camera: str,
    keypoints: Path,
    layout: str,
    first_frame: int,
    footage: Path,
    calibration: Path,
    detections: Path,
    clocks: Path | None = None,
) -> None:
    """Read the ``keypoints`` of ``camera``, recorded (numbered from ``first_frame`` on) or the detector's; write ``detections`` (npz).

    ``clocks`` say which picture shows which of the scene's moments; without them one after the other, as the footage was used.
    """
    used = read_footage(footage)
    common = read_clocks(clocks) if clocks else None
    found = part_used(used, common)
    lens = lens_of(calibration, camera)
    if is_found(keypoints):
        whole = read_found(keypoints)
        result = at_the_scene_s_moments(detections_of_found(whole, lens, found, settings), used, common)
        _tell(result, whole.note, used)
        write_detections(detections, result)
        return
    entries, kind = read_keypoints(keypoints)
    if not entries:
        say(f"{keypoints} ({kind}) holds no person: camera {camera} sees nobody")
        chosen = "body_25" if layout == "auto" else layout
    else:
        chosen, note = choose_layout(np.stack([e.keypoints for e in entries]), layout, str(keypoints))
        if note:
            say(note)
    result = at_the_scene_s_moments(detections_of(entries, chosen, lens, found, first_frame, settings), used, common)
    if entries and not len(result.frame):
        numbers = sorted({e.frame for e in entries})
        raise Refusal(
            f"{keypoints}: no detection falls into the {found.frames} working frames of camera {camera} (files are numbered "
            f"{numbers[0]} to {numbers[-1]}); write the number of the video's first frame into capture.yaml as "
            "keypoint_first_frame"
        )
    _tell(result, kind, used)
    write_detections(detections, result)


def _tell(result: Detections, kind: str, footage: Footage) -> None:
    seen = len(np.unique(result.frame))
    say(
        f"camera {footage.camera}: {len(result.frame)} detections ({kind}, {result.layout}) in {seen} of {footage.frames} frames, "
        f"{len(np.unique(result.track))} tracks"
    )
