# SPDX-License-Identifier: Apache-2.0
"""Finds a user's files on disk, by their conventional names or as ``capture.yaml`` names them."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path, PurePath
from typing import Any

from studiorecon.calibration.formats import FORMATS, board
from studiorecon.calibration.formats.lenses import find_lenses
from studiorecon.errors import UserError
from studiorecon.footage.kinds import film_suffixes, is_film
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.plan.films import find_recordings
from studiorecon.plan.inventory import unused_files
from studiorecon.plan.keypoint_files import keypoint_files, keypoints_of_chapters
from studiorecon.plan.pairing import files_by_camera
from studiorecon.scene.capture_yaml import (
    ABOUT_KEYPOINTS,
    WITHOUT_CALIBRATION,
    by_camera,
    chapters,
    frames_used,
    has_people,
    measured_lengths,
    names_under,
    path_under,
    paths_under,
    read_description,
)
from studiorecon.scene.dataset import PICTURE_SUFFIXES, Dataset, colmap_files
from studiorecon.scene.names import check_name, check_path, compose_unicode, fold_name
from studiorecon.scene.user_files import file_size, not_permitted

_BYTES = 1 << 20
# Where one camera's data can be: its own folder ("") or a file with such a suffix, likelier ones first.
_PLATES = PICTURE_SUFFIXES
_MASKS = ("", *sorted(film_suffixes()))
_DEPTH = (".exr",)
_CALIBRATION_FOLDER = re.compile(r"calib|cameras?$")


def open_dataset(folder: Path, capture_yaml: Path | None = None) -> Dataset:
    """The dataset in ``folder``, described by ``capture_yaml`` (default: ``folder/capture.yaml`` if it exists).

    Its paths are relative to ``folder``. Raises UserError with the folder or key and the remedy.
    """
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise UserError(f"dataset folder {folder} {what}; pass an existing folder with --config dataset=DIR")
    try:
        return _opened(folder, read_description(folder, capture_yaml))
    except OSError as error:
        raise not_permitted(Path(error.filename or folder), error) from None


def _opened(folder: Path, description: dict[str, Any]) -> Dataset:
    named = chapters(description)
    recordings = find_recordings(check_path(folder), named)
    films = {compose_unicode(camera): parts for camera, parts in recordings.films.items()}
    if len(films) < len(recordings.films):
        several = [compose_unicode(camera) for camera in recordings.films]
        twice = next(camera for camera in several if several.count(camera) > 1)
        raise UserError(f"{recordings.place} holds two cameras named {twice!r} in different Unicode forms; rename one")
    for camera, names in named.items():
        used = films.get(camera, ())
        listed = [path for path, name in zip(used, names) if path in (folder / name, path.parent / name)]
        if not len(listed) == len(used) == len(names) > 0:
            raise UserError(
                f"capture.yaml: chapters names films of {camera} that are not in {recordings.place}; paths are "
                f"relative to {folder}"
            )
    for camera, path in films.items():
        check_name(camera, f"camera {path[0]}", "rename the file or folder")
        if camera == "manifest":
            raise UserError(f"the camera {path[0]} has the name of a table of results; rename the file or folder")
    every = {camera: parts[0] for camera, parts in films.items()}
    starts = by_camera(description, "starts", every)
    footage, held_out = _chosen_footage(folder, every, description)

    def place(noun: str) -> tuple[str, bool]:
        """The folder, and whether it must exist."""
        named = path_under(description, noun)
        return named or noun, named is not None

    first, count = frames_used(description)
    calibration = _with_films(_find_calibration(folder, description), footage)
    keypoints, choice = keypoint_files(folder, path_under(description, "keypoints"), list(footage))
    dataset = Dataset(
        folder=folder,
        footage=footage,
        held_out=held_out,
        calibration=calibration,
        lenses=() if calibration else find_lenses(folder),
        keypoints=keypoints,
        keypoint_layout=_layout(path_under(description, "keypoint_layout") or "auto"),
        keypoint_first_frame=by_camera(description, "keypoint_first_frame", footage),
        plates=files_by_camera(folder, *place("plates"), footage, _PLATES),
        masks=files_by_camera(folder, *place("masks"), footage, _MASKS),
        depth=files_by_camera(folder, *place("depth"), footage, _DEPTH),
        identities=_identities(folder, description),
        pixel_maps=by_camera(description, "pixel_maps", footage),
        focal_px=by_camera(description, "focal_px", footage),
        lengths=measured_lengths(description, footage),
        starts={camera: starts.get(camera, 0.0) for camera in footage} if starts else {},
        first_frame=first,
        frame_count=count,
        people=has_people(description),
        truth=None,
        chapters={camera: films[camera] for camera in footage if len(films[camera]) > 1},
    )
    dataset = replace(dataset, chapter_keypoints=keypoints_of_chapters(dataset))
    _check_there(dataset)
    left_out = unused_files(dataset, recordings.place, set(every) - set(footage))
    found = [*recordings.notes, *_place_of_calibration(calibration, description, folder), *choice]
    return replace(dataset, notes=(*found, *_idle_keys(description, dataset), *left_out))


def _chosen_footage(
    folder: Path, every: Mapping[str, Path], description: dict[str, Any]
) -> tuple[dict[str, Path], tuple[str, ...]]:
    """The footage in use by camera, and the held-out cameras; UserError for one film under two names, or < 2 to
    train."""
    held_out = tuple(names_under(description, "held_out", every))
    chosen = (*names_under(description, "train", every), *held_out) if "train" in description else tuple(every)
    footage = {camera: path for camera, path in every.items() if camera in chosen}
    for one, two in combinations(footage, 2):
        if _same_bytes(footage[one], footage[two]):
            raise UserError(
                f"{footage[one]} and {footage[two]} are one film under two names; bring the footage of {two}, or leave "
                "it out (train: [...] in capture.yaml)"
            )
    if len(footage) - len(held_out) < 2:
        by = " by train and held_out in capture.yaml" if held_out or "train" in description else ""
        raise UserError(
            f"dataset {folder} has {len(footage) - len(held_out)} training camera(s){by}; at least 2 videos are needed "
            "in videos/"
        )
    return footage, held_out


def _layout(name: str) -> str:
    if name in ("auto", *LAYOUTS):
        return name
    near = difflib.get_close_matches(name.lower(), LAYOUTS, 1)
    meant = f"did you mean {near[0]}?" if near else f"layouts are {', '.join(LAYOUTS)}"
    raise UserError(f"capture.yaml: keypoint_layout is {name!r}, which is none; {meant}")


def _check_there(dataset: Dataset) -> None:
    """Raises UserError for the first file that is a dangling link, not a regular file, or not readable."""
    films = [film for camera, first in dataset.footage.items() for film in dataset.chapters.get(camera, (first,))]
    nouns = (dataset.keypoints, dataset.plates, dataset.masks, dataset.depth)
    for path in (*films, *dataset.calibration, *(entry for noun in nouns for entry in noun.values())):
        if not path.is_dir() or path in dataset.calibration[:1]:
            file_size(path)
        elif not os.access(path, os.R_OK | os.X_OK):
            raise not_permitted(path)


def _idle_keys(description: dict[str, Any], dataset: Dataset) -> list[str]:
    """A sentence for every key of capture.yaml that describes something missing."""
    calibration = ", ".join(file.name for file in dataset.calibration)
    idle = [
        f"capture.yaml: {key} applies only when people's keypoints give the cameras, and {calibration} gives them "
        "unless calibration.source is people"
        for key in WITHOUT_CALIBRATION
        if calibration and description.get(key) is not None
    ]
    if not dataset.keypoints:
        idle += [
            f"capture.yaml: {key} is about recorded keypoints, and there are none"
            for key in ABOUT_KEYPOINTS
            if description.get(key) is not None
        ]
    if dataset.pixel_maps and not (calibration or dataset.lenses):
        idle.append("capture.yaml: pixel_maps belong to a calibration, and there is none")
    return idle


def _same_bytes(one: Path, two: Path) -> bool:
    """Whether two videos are one file or copies: equal length, and equal bytes at start, middle and end."""
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
        return _with_rigs(_with_partners(paths))
    return _with_rigs(find_calibration(folder) or _calibration_below(folder))


def _with_films(calibration: tuple[Path, ...], footage: Mapping[str, Path]) -> tuple[Path, ...]:
    """The calibration's files; for a board's description, with the films beside it, else with the capture's."""
    if len(calibration) != 1 or not board.recognises(list(calibration)):
        return calibration
    place = calibration[0].parent
    beside = [p for p in sorted(place.iterdir()) if (is_film(p) or (p.is_dir() and p.name in footage))]
    return (*calibration, *(beside if len(beside) > 1 else footage.values()))


def _place_of_calibration(files: Sequence[Path], description: dict[str, Any], folder: Path) -> list[str]:
    """A sentence where the calibration was found in a folder of its own."""
    places = {path.parent for path in files if path.parent.parent == folder}
    chosen = "calibration" not in description and any(_CALIBRATION_FOLDER.match(fold_name(p.name)) for p in places)
    return [f"the calibration is taken from {place.name}/" for place in places] if chosen else []


def _with_partners(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    """The calibration's files, and the others that make one calibration with a single file."""
    sets = [[PurePath(n).name for n in names] for form in FORMATS.values() for names in form.files if len(names) > 1]
    whole = [_named(paths[0].parent, names) for names in sets] if len(paths) == 1 else []
    return next((files for files in whole if paths[0] in files), paths)


def _calibration_below(folder: Path) -> tuple[Path, ...]:
    """The calibration in the only folder that is named after one and holds one."""
    places = [p for p in sorted(folder.iterdir()) if p.is_dir() and _CALIBRATION_FOLDER.match(fold_name(p.name))]
    held = [files for place in places if (files := find_calibration(place))]
    return held[0] if len(held) == 1 else ()


def _named(folder: Path, names: Sequence[str]) -> tuple[Path, ...]:
    """The files of these names in ``folder``, whatever their case, and ``.yaml`` for ``.yml``; () unless all exist."""
    own = {_folded(p.name): p for p in sorted(folder.iterdir(), reverse=True) if p.is_file()}
    found = [folder / n if (folder / n).is_file() else own.get(_folded(n)) for n in names]
    return tuple(path for path in found if path is not None) if all(found) else ()


def _folded(name: str) -> str:
    return fold_name(name).replace(".yaml", ".yml")


def find_calibration(folder: Path) -> tuple[Path, ...]:
    """The calibration's files in ``folder``, by the names that the formats declare; empty when there is none.

    Exact names take precedence over patterns. Raises UserError when a pattern matches more than one calibration.
    """
    for form in FORMATS.values():
        for names in form.files:
            if whole := _named(folder, names):
                return whole
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
    """The calibration's files, plus the rigs and frames files of a COLMAP model in the same folder."""
    images = [path for path in paths if path.name in ("images.txt", "images.bin")]
    return tuple(dict.fromkeys([*paths, *(path for file in images for path in colmap_files(file) if path.is_file())]))


def _identities(folder: Path, description: dict[str, Any]) -> Path | None:
    path = folder / (path_under(description, "identities") or "identities.tsv")
    if description.get("identities") is None and not path.exists() and not path.is_symlink():
        return None
    file_size(path)
    return path
