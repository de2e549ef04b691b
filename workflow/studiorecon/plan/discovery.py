# SPDX-License-Identifier: Apache-2.0
"""Finds what a user has on disk: by its conventional names, or named in ``capture.yaml``."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

from studiorecon.calibration.formats import FORMATS
from studiorecon.errors import UserError
from studiorecon.plan.films import find_recordings
from studiorecon.plan.inventory import LIKE_KEYPOINTS, unused
from studiorecon.plan.pairing import folded, paired
from studiorecon.scene.capture_yaml import (
    anybody,
    chapters,
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
from studiorecon.scene.names import checked_name, checked_place, of_the_system

_BYTES = 1 << 20
# What may hold something of one camera: its own folder ("") or a file with such a suffix, likelier ones first.
_KEYPOINTS = ("", ".json", ".csv", ".npz", ".h5")
_PLATES = PICTURE_SUFFIXES
_MASKS = ("", *VIDEO_SUFFIXES)
_DEPTH = (".exr",)
# Folders of 2D keypoints in the order in which they count; other names of such folders count if there is only one.
_KEYPOINT_FOLDERS = ("keypoints", "pose", "openpose", "annots")
_NOT_LIKE_KEYPOINTS = re.compile(r"3d|calib")


def open_dataset(folder: Path, capture_yaml: Path | None = None) -> Dataset:
    """The dataset in ``folder``, described by ``capture_yaml`` (default: ``folder/capture.yaml`` if it is there).

    Paths inside ``capture.yaml`` are relative to ``folder``. Raises UserError, naming the folder or key and the remedy.
    """
    if not folder.is_dir():
        raise UserError(f"dataset folder {folder} does not exist; pass an existing one with --config dataset=DIR")
    try:
        return _opened(folder, read_description(folder, capture_yaml))
    except OSError as error:
        raise UserError(
            f"{error.filename or folder} cannot be looked at ({error.strerror or error}); see who may read it"
        ) from None


def _opened(folder: Path, description: dict[str, Any]) -> Dataset:
    recordings = find_recordings(checked_place(folder), chapters(description))
    films = recordings.films
    for camera, path in films.items():
        checked_name(camera, f"camera {path[0]}", "rename the file or folder")
    footage = {camera: parts[0] for camera, parts in films.items()}
    every = dict(footage)
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

    def place(noun: str) -> tuple[str, bool]:
        """The folder, and whether it must be there."""
        named = path_under(description, noun)
        return named or noun, named is not None

    first, count = frames_used(description, folder)
    keypoints, choice = _keypoints(folder, path_under(description, "keypoints"), list(footage))
    dataset = Dataset(
        folder=folder,
        footage=footage,
        held_out=held_out,
        calibration=_find_calibration(folder, description),
        keypoints=keypoints,
        keypoint_layout=path_under(description, "keypoint_layout") or "auto",
        keypoint_first_frame=whole_number(description, "keypoint_first_frame", folder),
        plates=_per_camera(folder, *place("plates"), footage, _PLATES),
        masks=_per_camera(folder, *place("masks"), footage, _MASKS),
        depth=_per_camera(folder, *place("depth"), footage, _DEPTH),
        identities=_identities(folder, description),
        pixel_maps=pixel_maps(description, footage),
        focal_px=focal_lengths(description, footage),
        lengths=measured_lengths(description, footage),
        starts={camera: starts[camera] for camera in footage} if starts else {},
        first_frame=first,
        frame_count=count,
        people=anybody(description),
        truth=None,
        chapters={camera: films[camera] for camera in footage if len(films[camera]) > 1},
    )
    dataset = replace(dataset, chapter_keypoints=_chapter_keypoints(dataset))
    left_out = set(every) - set(footage)
    return replace(dataset, notes=(*recordings.notes, *choice, *unused(dataset, recordings.place, left_out)))


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
    folder: Path, name: str, required: bool, cameras: Iterable[str], suffixes: Sequence[str]
) -> dict[str, Path]:
    """camera → its entry in the folder ``name``, of a kind in ``suffixes``; empty where there is no such folder."""
    base = folder / name
    if not base.is_dir():
        if required:
            raise UserError(f"capture.yaml names {base}, which is not a folder")
        return {}
    kinds = {path: "" if path.is_dir() else path.suffix.lower() for path in sorted(base.iterdir())}
    entries = [path for path, kind in kinds.items() if kind in suffixes and not of_the_system(path)]
    return paired(list(cameras), sorted(entries, key=lambda path: suffixes.index(kinds[path])))


def _keypoints(folder: Path, named: str | None, cameras: Sequence[str]) -> tuple[dict[str, Path], list[str]]:
    """camera → its recorded keypoints, and sentences about the choice among folders that may hold them.

    The folder ``named`` in capture.yaml counts; else the first of the usual ones; else the only one whose name speaks
    of poses or keypoints and whose entries bear the cameras' names.
    """
    if named is not None:
        return _per_camera(folder, named, True, cameras, _KEYPOINTS), []
    usual = next((name for name in _KEYPOINT_FOLDERS if (folder / name).is_dir()), None)
    if usual is not None:
        return _per_camera(folder, usual, False, cameras, _KEYPOINTS), []
    held = {
        path.relative_to(folder).as_posix(): entries
        for path in sorted([*folder.glob("*"), *folder.glob("*/*")])
        if path.is_dir()
        and LIKE_KEYPOINTS.search(folded(path.name))
        and not _NOT_LIKE_KEYPOINTS.search(folded(path.relative_to(folder).as_posix()))
        and (entries := _per_camera(folder, path.relative_to(folder).as_posix(), False, cameras, _KEYPOINTS))
    }
    if len(held) == 1:
        name, entries = next(iter(held.items()))
        return entries, [f"keypoints are taken from {name}/"]
    if held:
        return {}, [
            f"{' and '.join(f'{name}/' for name in held)} may each hold keypoints, and none is used; choose one in "
            f"capture.yaml: keypoints: {next(iter(held))}"
        ]
    return {}, []


def _chapter_keypoints(dataset: Dataset) -> dict[str, tuple[Path, ...]]:
    """camera → its keypoints chapter by chapter, where every chapter has its own; raises UserError where only some
    have."""
    found = {}
    for camera, parts in dataset.chapters.items():
        if camera not in dataset.keypoints:
            continue
        place = dataset.keypoints[camera].parent.relative_to(dataset.folder).as_posix()
        entries = _per_camera(dataset.folder, place, True, [part.stem for part in parts], _KEYPOINTS)
        if len(entries) == len(parts):
            found[camera] = tuple(entries[part.stem] for part in parts)
        elif len(entries) > 1:
            lacking = next(part.stem for part in parts if part.stem not in entries)
            raise UserError(
                f"{dataset.folder / place} has keypoints of {len(entries)} of the {len(parts)} chapters of camera "
                f"{camera}, and none of {lacking}; bring those too, or one file of the whole recording"
            )
    return found


def _identities(folder: Path, description: dict[str, Any]) -> Path | None:
    path = folder / (path_under(description, "identities") or "identities.tsv")
    if description.get("identities") is not None and not path.is_file():
        raise UserError(f"capture.yaml names identities: {path}, which does not exist")
    return path if path.is_file() else None
