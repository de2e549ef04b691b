# SPDX-License-Identifier: Apache-2.0
"""Reads folders of pictures or videos of any method, one video or one folder of pictures per camera."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.container import is_lossless
from studiorecon.footage.kinds import film_suffixes
from studiorecon.footage.stills import read_image
from studiorecon.footage.video import read_frames
from studiorecon.progress import say
from studiorecon.scene.numbered_files import pictures_in

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer

# The camera's name for a single film or a folder that holds pictures directly.
ONLY = "camera"


def cameras_in(place: Path) -> dict[str, Path]:
    """camera → its video or folder of pictures, or a single camera; raises UserError when there is none."""
    if place.is_file() and place.suffix.lower() in film_suffixes():
        return {ONLY: place}
    if not place.is_dir():
        raise UserError(f"{place} is not a folder; give one with a video or a folder of pictures per camera")
    versions: dict[str, list[Path]] = {}
    for entry in sorted(place.iterdir()):
        name = entry.name if entry.is_dir() else entry.stem
        is_film = entry.suffix.lower() in film_suffixes() and "." not in entry.stem
        if pictures_in(entry) if entry.is_dir() else is_film:
            versions.setdefault(name, []).append(entry)
    found = {name: paths[0] if len(paths) == 1 else _lossless(name, paths) for name, paths in versions.items()}
    if not found and pictures_in(place):
        return {ONLY: place}
    if not found:
        raise UserError(
            f"{place} holds neither videos nor folders of pictures; put <camera>.mkv or <camera>/*.png there"
        )
    return found


def read_folder_frames(source: Path) -> Iterator[Integer[np.ndarray, "H W 3"]]:
    """Frames of a video or a folder of pictures, in name order."""
    for frame in _read_stored(source):
        yield np.repeat(frame[..., None], 3, axis=-1) if frame.ndim == 2 else frame


def read_masks(source: Path) -> Iterator[Bool[np.ndarray, "H W"]]:
    """Masks: True where a mask video or picture is not black."""
    for frame in _read_stored(source):
        yield frame > 0 if frame.ndim == 2 else (frame[..., 0] | frame[..., 1] | frame[..., 2]) > 0


def _lossless(name: str, versions: Sequence[Path]) -> Path:
    """The only lossless one of several versions of one film; raises UserError when there are none or several."""
    chosen = [path for path in versions if path.is_dir() or is_lossless(path)]
    if len(chosen) == 1:
        say(f"{name}: the lossless {chosen[0].name} is scored; {_name_list(set(versions) - set(chosen))} is not read")
        return chosen[0]
    raise UserError(
        f"camera {name} of {versions[0].parent} has several versions ({_name_list(versions)}), of which {len(chosen)} "
        f"are lossless; give one film, such as {versions[0]}, instead of the folder"
    )


def _name_list(paths: Iterable[Path]) -> str:
    return " and ".join(sorted(path.name for path in paths))


def _read_stored(source: Path) -> Iterator[np.ndarray]:
    if source.is_file():
        yield from read_frames(source)
        return
    for path in pictures_in(source):
        yield np.ascontiguousarray(read_image(path, cv2.IMREAD_COLOR)[..., ::-1])


def digest(source: Path) -> str:
    """SHA-256 of a file, or of a folder's pictures with their names, in name order."""
    hashed = hashlib.sha256()
    for path in [source] if source.is_file() else pictures_in(source):
        hashed.update(path.name.encode())
        with open(path, "rb") as file:
            while part := file.read(1 << 20):
                hashed.update(part)
    return hashed.hexdigest()
