# SPDX-License-Identifier: Apache-2.0
"""Finds what a user has on disk: by its conventional names, or named in ``capture.yaml``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import combinations
from pathlib import Path
from typing import Any

from studiorecon.calibration.formats import FORMATS
from studiorecon.errors import UserError
from studiorecon.scene.capture_yaml import (
    anybody,
    focal_lengths,
    frames_used,
    measured_lengths,
    names_under,
    path_under,
    paths_under,
    pixel_maps,
    read_description,
    starts_of,
    whole_number,
)
from studiorecon.scene.dataset import PICTURE_SUFFIXES, VIDEO_SUFFIXES, Dataset, colmap_files
from studiorecon.scene.names import checked_name, checked_place

# Where the footage lies in the captures that people have; the first that holds any counts.
_VIDEO_FOLDERS = ("videos", "frame_aligned_videos")
_BYTES = 1 << 20
_PICTURE_FOLDERS = (("images", ""), ("ims", ""), ("exo", "images"))


def open_dataset(folder: Path, capture_yaml: Path | None = None) -> Dataset:
    """The dataset in ``folder``, described by ``capture_yaml`` (default: ``folder/capture.yaml`` if it is there).

    Paths inside ``capture.yaml`` are relative to ``folder``. Raises UserError, naming the folder or key and the remedy.
    """
    if not folder.is_dir():
        raise UserError(f"dataset folder {folder} does not exist; pass an existing one with --config dataset=DIR")
    description = read_description(folder, capture_yaml)
    footage = _find_footage(checked_place(folder))
    for camera, path in footage.items():
        checked_name(camera, f"camera {path}", "rename the file or folder")
    starts = starts_of(description, footage)
    chosen = names_under(description, "train", footage) + names_under(description, "held_out", footage)
    held_out = tuple(names_under(description, "held_out", footage))
    if "train" in description:
        footage = {c: footage[c] for c in footage if c in chosen}
    for one, two in combinations(footage, 2):
        if _same_bytes(footage[one], footage[two]):
            raise UserError(
                f"{footage[one]} and {footage[two]} are one film under two names; bring the footage of {two}, or leave "
                "it out (train: [...] in capture.yaml)"
            )
    if len(footage) - len(held_out) < 2:
        raise UserError(
            f"dataset {folder} has {len(footage) - len(held_out)} training camera(s); "
            "at least 2 videos are needed in videos/"
        )
    first, count = frames_used(description, folder)
    keypoints = _per_camera(
        folder, path_under(description, "keypoints"), ("keypoints", "pose", "openpose", "annots"), footage
    )
    return Dataset(
        folder=folder,
        footage=footage,
        held_out=held_out,
        calibration=_find_calibration(folder, description),
        keypoints=keypoints,
        keypoint_layout=path_under(description, "keypoint_layout") or "auto",
        keypoint_first_frame=whole_number(description, "keypoint_first_frame", folder),
        plates=_per_camera(folder, path_under(description, "plates"), ("plates",), footage),
        masks=_per_camera(folder, path_under(description, "masks"), ("masks",), footage),
        depth=_per_camera(folder, path_under(description, "depth"), ("depth",), footage),
        identities=_identities(folder, description),
        pixel_maps=pixel_maps(description, footage),
        focal_px=focal_lengths(description, footage),
        lengths=measured_lengths(description, footage),
        starts={camera: starts[camera] for camera in footage} if starts else {},
        first_frame=first,
        frame_count=count,
        people=anybody(description),
        truth=None,
    )


def _find_footage(folder: Path) -> dict[str, Path]:
    videos = _first_non_empty(
        [
            p
            for p in sorted((folder / name).glob("*"))
            if p.suffix.lower() in VIDEO_SUFFIXES and not p.name.startswith(".")
        ]
        for name in _VIDEO_FOLDERS
    )
    found = {} if videos else _picture_folders(folder)
    if not videos and not found:
        videos = [
            p for p in sorted(folder.glob("*")) if p.suffix.lower() in VIDEO_SUFFIXES and not p.name.startswith(".")
        ]
    stems = [p.stem for p in videos]
    for stem in stems:
        if stems.count(stem) > 1:
            raise UserError(f"{videos[0].parent} holds more than one video named {stem!r}; keep one per camera")
    if videos:
        return {p.stem: p for p in videos}
    if not found:
        raise UserError(
            f"dataset {folder} has neither videos/*.mp4 (or mov, mkv) nor images/<camera>/*.png "
            "(or jpg): put one video per camera there"
        )
    return found


def _same_bytes(one: Path, two: Path) -> bool:
    """Whether two videos are copies of, or links to, one file: of equal length, and equal at beginning, middle and
    end."""
    if one.is_dir() or two.is_dir():
        return one.resolve() == two.resolve()
    size = one.stat().st_size
    if size != two.stat().st_size or not size:
        return False
    with open(one, "rb") as first, open(two, "rb") as second:
        for place in (0, size // 2, max(size - _BYTES, 0)):
            first.seek(place)
            second.seek(place)
            if first.read(_BYTES) != second.read(_BYTES):
                return False
    return True


def _first_non_empty(lists: Iterable[list[Path]]) -> list[Path]:
    return next((found for found in lists if found), [])


def _picture_folders(folder: Path) -> dict[str, Path]:
    """camera → its folder of pictures: ``images/<camera>``, ``ims/<camera>`` or ``exo/<camera>/images``."""
    for outer, inner in _PICTURE_FOLDERS:
        places = {p.name: p / inner for p in sorted((folder / outer).glob("*")) if (p / inner).is_dir()}
        found = {
            name: p for name, p in places.items() if any(q.suffix.lower() in PICTURE_SUFFIXES for q in p.iterdir())
        }
        if found:
            return found
    return {}


def _find_calibration(folder: Path, description: dict[str, Any]) -> tuple[Path, ...]:
    named = paths_under(description, "calibration")
    if named is not None:
        paths = tuple(folder / p for p in named)
        for path in paths:
            if not path.exists():
                raise UserError(f"capture.yaml names the calibration {path}, which does not exist")
        return _with_rigs(paths)
    return _with_rigs(find_calibration(folder))


def find_calibration(folder: Path) -> tuple[Path, ...]:
    """The calibration's files in ``folder``, by the names that the formats declare; empty when there is none.

    Whole names count before patterns. Raises UserError when a pattern finds more than one calibration.
    """
    for form in FORMATS.values():
        for names in form.files:
            if all((folder / n).is_file() for n in names):
                return tuple(folder / n for n in names)
    patterns = [
        (p, form.holds_cameras, form.file_per_camera)
        for form in FORMATS.values()
        for names in form.files
        for p in names
        if "*" in p
    ]
    for pattern, holds_cameras, file_per_camera in dict.fromkeys(patterns):
        found = [path for path in sorted(folder.glob(pattern)) if holds_cameras(path)]
        if len(found) == 1 or (found and file_per_camera):
            return tuple(found)
        if len(found) > 1:
            listed = ", ".join(p.name for p in found)
            raise UserError(
                f"{folder} holds {len(found)} calibrations ({listed}); name one in capture.yaml: calibration: FILE"
            )
    return ()


def _with_rigs(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    """The calibration's files, with rigs and frames of a COLMAP model that stand beside those named."""
    images = [path for path in paths if path.name in ("images.txt", "images.bin")]
    return tuple(dict.fromkeys([*paths, *(path for file in images for path in colmap_files(file) if path.is_file())]))


def _per_camera(
    folder: Path, named: str | None, defaults: tuple[str, ...], footage: Mapping[str, Path]
) -> dict[str, Path]:
    """camera → path inside the named (or first existing default) folder: ``<camera>``, ``<camera>_json``,
    ``<camera>.*``, or DeepLabCut's ``<camera>DLC_<network>.csv``."""
    base = folder / named if named is not None else next((folder / d for d in defaults if (folder / d).is_dir()), None)
    if base is None:
        return {}
    if not base.is_dir():
        raise UserError(f"capture.yaml names {base}, which is not a folder")
    entries = sorted(base.iterdir())
    found = {}
    for camera in footage:
        for entry in entries:
            stem = entry.name if entry.is_dir() else entry.name.split(".")[0]
            if stem in (camera, f"{camera}_json", f"{camera}_ext") or stem.startswith(f"{camera}DLC_"):
                found[camera] = entry
                break
    return found


def _identities(folder: Path, description: dict[str, Any]) -> Path | None:
    path = folder / (path_under(description, "identities") or "identities.tsv")
    if description.get("identities") is not None and not path.is_file():
        raise UserError(f"capture.yaml names identities: {path}, which does not exist")
    return path if path.is_file() else None
