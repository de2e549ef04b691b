# SPDX-License-Identifier: Apache-2.0
"""A dataset directory: the files of a user's capture, as ``plan.discovery`` lists them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff")


@dataclass(frozen=True)
class Dataset:
    """Paths of all parts of one capture. They exist, unless the studio is still to make them.

    Attributes:
        footage: camera → video file, or folder of pictures; of a recording in chapters the first file.
        chapters: camera → all files of its recording in order, for cameras whose recording is in several.
        held_out: cameras that only ``report`` may read.
        calibration: the calibration's file(s); empty when there is none.
        keypoints: camera → folder of JSON files, or one file. Cameras without recorded keypoints are absent.
        chapter_keypoints: camera → one such entry per chapter, where they were recorded chapter by chapter.
        keypoint_layout: name of the layout, or ``"auto"``.
        keypoint_first_frame: camera → the number in its keypoint files of its video's first frame, if given.
        plates, masks, depth: camera → the user's file or folder.
        identities: a corrected ``identities.tsv`` (camera, track, person), or None.
        pixel_maps: camera → (scale, x, y) with p_video = scale · p_calibration + (x, y), pixel centres at +0.5, for
            footage that was resized or padded after the calibration.
        focal_px: camera → focal length in pixels of its footage, where given; only used without a calibration.
        lengths: for cameras that are calibrated from people: ``height_m``, person → metres ("" = of all persons), or
            ``between`` two cameras and ``distance_m``; empty without them.
        starts: camera → the frame of its footage, possibly fractional, that shows one common moment; or empty.
        first_frame: the first used moment, counted among those that all cameras have.
        frame_count: number of moments used; 0 = to the end.
        people: False when ``capture.yaml`` says ``people: 0``: the room is known to be empty.
        lenses: files with lenses and no poses, where there is no calibration: the poses then come from people.
        truth: folder of exact truth (synthetic studio only), else None.
        notes: sentences: every choice among several files, and every unused file of the folder with the reason.
    """

    folder: Path
    footage: Mapping[str, Path]
    held_out: tuple[str, ...]
    calibration: tuple[Path, ...]
    keypoints: Mapping[str, Path]
    keypoint_layout: str
    keypoint_first_frame: Mapping[str, int]
    plates: Mapping[str, Path]
    masks: Mapping[str, Path]
    depth: Mapping[str, Path]
    identities: Path | None
    pixel_maps: Mapping[str, tuple[float, float, float]]
    focal_px: Mapping[str, float]
    lengths: Mapping[str, Any]
    starts: Mapping[str, float]
    first_frame: int
    frame_count: int
    people: bool
    truth: Path | None
    chapters: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)
    chapter_keypoints: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    lenses: tuple[Path, ...] = ()

    @property
    def cameras(self) -> tuple[str, ...]:
        return tuple(self.footage)

    @property
    def training(self) -> tuple[str, ...]:
        return tuple(c for c in self.footage if c not in self.held_out)


def colmap_files(images: Path) -> tuple[Path, ...]:
    """The files with the poses of the COLMAP model of an ``images`` file, with ``rigs`` and ``frames`` if they
    exist."""
    beside = [images.with_name(f"{part}{images.suffix}") for part in ("rigs", "frames")]
    return (images.with_name(f"cameras{images.suffix}"), images, *(path for path in beside if path.is_file()))
