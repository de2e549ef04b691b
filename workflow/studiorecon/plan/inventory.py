# SPDX-License-Identifier: Apache-2.0
"""The files of a capture's folder that are not used: one sentence with the reason for each file or folder."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from studiorecon.calibration.formats.lenses import unused_reason
from studiorecon.footage.kinds import film_suffixes
from studiorecon.plan.films import is_preview
from studiorecon.plan.pairing import camera_stem
from studiorecon.scene.capture_yaml import description_path
from studiorecon.scene.dataset import PICTURE_SUFFIXES, Dataset
from studiorecon.scene.names import fold_name, is_system_file

# Texts that come with a capture and are for people.
_FOR_READERS = re.compile(r"(licen[cs]e|readme)(\.(txt|md))?", re.IGNORECASE)
_MAX_SENTENCES = 30
_MAX_COUNTED = 1000
_BY_SUFFIX: Mapping[str, str] = {
    **dict.fromkeys((".wav", ".mp3", ".m4a", ".aac", ".flac", ".ogg"), "sound comes from the films themselves"),
    **dict.fromkeys((".gz", ".zip", ".7z", ".rar", ".tar", ".bz2", ".xz"), "it is packed; unpack it"),
    **dict.fromkeys((".part", ".crdownload", ".tmp", ".download"), "an incomplete download; download it again"),
    **dict.fromkeys((".heic", ".gif", ".bmp", ".dng", ".cr2"), f"pictures must be {', '.join(PICTURE_SUFFIXES)}"),
}
_CALIBRATION_SUFFIXES = {
    *(".toml", ".yml", ".yaml", ".json", ".xml", ".npz", ".npy", ".pickle", ".pkl", ".xcp", ".mcal", ".calib", ".cal"),
    *(".sfm", ".bin"),
}
_NO_NAME = "no camera's name fits it"
# Usual names of folders of 2D keypoints.
LIKE_KEYPOINTS = re.compile(r"pose|keypoint|kpts?|json|annot|skeleton|joints|landmark|detection")
# Other files of COLMAP models and of tools that make them; cameras are read without them.
_BESIDE_MODELS = {"points3d.txt", "points3d.bin", "points3d.ply", "project.ini", "database.db"}
_WORKFLOW_FOLDERS = {"results", "logs", "timings"}


def unused_files(dataset: Dataset, place: Path, left_out: Iterable[str]) -> tuple[str, ...]:
    """A sentence for every file or folder in ``dataset.folder`` that the dataset does not use.

    ``place`` is the folder of the films; ``left_out`` are cameras that ``train`` does not list. Files of the operating
    system are skipped. A folder of which nothing is used gets one sentence.
    """
    folder, left_out = dataset.folder, set(left_out)
    used = {description_path(folder), folder / "identities.tsv", *dataset.footage.values(), *dataset.calibration}
    used.update(dataset.lenses)
    for several in (*dataset.chapters.values(), *dataset.chapter_keypoints.values()):
        used.update(several)
    for noun in (dataset.keypoints, dataset.plates, dataset.masks, dataset.depth):
        used.update(noun.values())
    parents = {parent for path in used for parent in path.parents}
    models = {path.parent for path in dataset.calibration}
    found = [
        f"not used: {path.relative_to(folder).as_posix()}{'/' * path.is_dir()}{_count(path)}: "
        f"{_reason(path, dataset, place, left_out)}"
        for path in _left(folder, used, parents)
        if not (path.parent in models and path.name.casefold() in _BESIDE_MODELS)
    ]
    more = len(found) - _MAX_SENTENCES
    return (*found[:_MAX_SENTENCES], *([f"not used: {more} more files and folders"] if more > 0 else []))


def _left(folder: Path, used: set[Path], parents: set[Path]) -> Iterator[Path]:
    for path in sorted(folder.iterdir()):
        if path in used or (is_system_file(path) and not _is_hidden_film(path)) or _FOR_READERS.fullmatch(path.name):
            continue
        if path in parents and not path.is_symlink():
            yield from _left(path, used, parents)
        elif path not in parents and not (folder.resolve() == Path.cwd() and path.name in _WORKFLOW_FOLDERS):
            yield path


def _is_hidden_film(path: Path) -> bool:
    """A film whose name begins with a dot, also as rsync names it while it copies (``.cam1.mp4.x7Qz2k``)."""
    return path.name[:2] != "._" and path.is_file() and not film_suffixes().isdisjoint(map(str.lower, path.suffixes))


def _count(path: Path) -> str:
    if not path.is_dir() or path.is_symlink():
        return ""
    number = 0
    for number, _ in zip(range(1, _MAX_COUNTED + 1), _files(path)):  # noqa: B007
        pass
    return f" ({'at least ' * (number == _MAX_COUNTED)}{number} file{'s' * (number != 1)})"


def _files(folder: Path) -> Iterator[Path]:
    for path in sorted(folder.iterdir()):
        if path.is_dir() and not path.is_symlink():
            yield from _files(path)
        elif not is_system_file(path):
            yield path


def _reason(path: Path, dataset: Dataset, place: Path, left_out: set[str]) -> str:
    if path.is_symlink() and not path.exists():
        return f"a link to {path.readlink()}, which does not exist"
    if camera_stem(path) in left_out:
        return "train in capture.yaml leaves this camera out"
    if path.is_dir():
        if (first := next(_files(path), None)) is None:
            return "it is empty"
        if LIKE_KEYPOINTS.search(fold_name(path.name)) or path.name in ("plates", "masks", "depth"):
            cameras = {fold_name(camera) for camera in dataset.footage}
            fits = any(fold_name(camera_stem(entry)) in cameras for entry in path.iterdir())
            if fits and LIKE_KEYPOINTS.search(fold_name(path.name)):
                wanted = path.relative_to(dataset.folder).as_posix()
                return f"another folder could be meant; if it is this one, write keypoints: {wanted} into capture.yaml"
            return f"{_NO_NAME} ({first.name}); cameras are {', '.join(dataset.footage)}"
        return _reason_of_name(path, dataset) or _reason(first, dataset, place, left_out)
    suffix = path.suffix.lower()
    if path.name.startswith("."):
        return "a hidden or half-copied film; copy it again, or rename it"
    if is_preview(path):
        return "a camera's own preview or raw file; bring its .mp4"
    if suffix in film_suffixes():
        return f"films are taken from {place.name}/, one per camera; put it there"
    if path.stem.casefold().partition(".")[0] == "capture" and suffix in (".yaml", ".yml", ".txt", ".json"):
        return "a description is read from capture.yaml in the capture's own folder"
    return (
        _BY_SUFFIX.get(suffix)
        or _reason_of_name(path, dataset)
        or (f"pictures are read from images/<camera>/{', not from a folder of films' * (place in path.parents)}")
        * (suffix in PICTURE_SUFFIXES)
        or unused_reason(path, dataset.calibration)
        or _reason_of_calibration(path, dataset) * (suffix in _CALIBRATION_SUFFIXES)
        or (f"no film ends in {path.suffix or 'nothing'}" if path.parent == place else "no file of a kind that is read")
    )


def _reason_of_name(path: Path, dataset: Dataset) -> str:
    """The reason why an entry is no camera's keypoints, plate, mask or depth, when other entries of its folder are."""
    nouns = {"keypoints": dataset.keypoints, "plate": dataset.plates, "masks": dataset.masks, "depth": dataset.depth}
    for noun, entries in nouns.items():
        for camera, entry in entries.items():
            if entry.parent == path.parent and fold_name(camera_stem(entry)) == fold_name(camera_stem(path)):
                return f"camera {camera} has {noun} in {entry.name} already"
        if any(entry.parent == path.parent for entry in entries.values()):
            if fold_name(camera_stem(path)) in map(fold_name, dataset.footage):
                return f"{noun} are not read from such a file"
            return f"{_NO_NAME}; cameras are {', '.join(dataset.footage)}"
    return ""


def _reason_of_calibration(path: Path, dataset: Dataset) -> str:
    named = f"write calibration: {path.relative_to(dataset.folder).as_posix()} into capture.yaml"
    if dataset.calibration:
        return f"the calibration is {', '.join(file.name for file in dataset.calibration)}; if it is this one, {named}"
    return f"no calibration goes by this name; if it is one, {named}"
