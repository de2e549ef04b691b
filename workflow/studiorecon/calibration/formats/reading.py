# SPDX-License-Identifier: Apache-2.0
"""The interface of a calibration format; merges many pictures of a static camera into one entry."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element

import numpy as np

from studiorecon.camera_files.raw_camera import RawCamera
from studiorecon.errors import UserError
from studiorecon.scene.files import write_json
from studiorecon.scene.schema import RIGID, ListOf, flag, real, record, text, whole
from studiorecon.scene.step_files import read
from studiorecon.scene.user_values import short_text

if TYPE_CHECKING:
    from jaxtyping import Float

# A static camera's poses of several pictures differ by what bundle adjustment leaves: less than this share of the
# spread of all cameras, and this angle.
_STILL, _STILL_DEG = 0.01, 1.0


_CAMERA = {
    "name": text(),
    "wh": whole("2", low=0, unit="pixels"),
    "intrinsics": real("3 3"),
    "model": text("opencv", "fisheye"),
    "distortion": real("C"),
    "camera_from_world": real("4 4", such=RIGID),
    "scale": real(above=0),
}
_READING = {
    "source": text(),
    "format": text(),
    "cameras": ListOf(_CAMERA),
    "unit": text("m", "mm", "unknown"),
    "notes": ListOf(text()),
    "named": flag(),
    "has_floor": flag(),
}


@dataclass(frozen=True)
class Reading:
    """The cameras of one calibration.

    Attributes:
        format: the format's name.
        cameras: in the file's order.
        unit: of length, "m", "mm" or "unknown".
        notes: sentences about changes.
        named: False where the format has no names and the cameras are in the order of the sorted videos.
        has_floor: whether z = 0 is the floor where z is up.
    """

    format: str
    cameras: tuple[RawCamera, ...]
    unit: str
    notes: tuple[str, ...]
    named: bool = True
    has_floor: bool = True


def write_reading(path: Path, reading: Reading, source: str) -> None:
    """Write what was read of the calibration in the file ``source``, as JSON."""
    cameras = [vars(camera) for camera in reading.cameras]
    write_json(path, {"source": source, **vars(reading), "cameras": cameras})


def read_reading(path: Path) -> tuple[Reading, str]:
    """What was read of a calibration, and the name of its file; raises UserError as ``step_files.read`` does."""

    def made(value: dict[str, Any]) -> tuple[Reading, str]:
        cameras = [record(RawCamera, camera) for camera in value["cameras"]]
        return record(Reading, {**value, "cameras": cameras}), value["source"]

    return read(path, _READING, made)


def _always(path: Path) -> bool:
    return True


@dataclass(frozen=True)
class CalibrationFormat:
    """One file format of calibrated cameras.

    Attributes:
        name: as in the setting ``calibration.format``.
        made_by: the programs and data sets that write it.
        files_in_words: its files in the dataset's folder, in Markdown.
        files: alternatives to search there, in order: names relative to the folder that must all exist, or one pattern.
        file_per_camera: whether every file that a pattern matches is one camera of the same calibration.
        recognises: whether files are of this format, by their names or content.
        read: the cameras; raises UserError for a file that is not of this format.
        holds_cameras: whether a file that a pattern matches is a calibration at all.
    """

    name: str
    made_by: str
    files_in_words: str
    files: tuple[tuple[str, ...], ...]
    recognises: Callable[[list[Path]], bool]
    read: Callable[[list[Path]], Reading]
    holds_cameras: Callable[[Path], bool] = _always
    file_per_camera: bool = False


def one_file(*patterns: str) -> Callable[[list[Path]], bool]:
    """Recognises a single file whose name in lower case fits one of the patterns."""
    return lambda files: len(files) == 1 and any(fnmatch(files[0].name.lower(), one) for one in patterns)


def attribute(element: Element, key: str, where: str) -> str:
    """An attribute of a calibration's XML; raises UserError where it is missing."""
    if (value := element.get(key)) is None:
        raise UserError(f"{where}: {key} of {element.tag} is missing; save the calibration again in its program")
    return value


def number_attributes(
    element: Element, keys: Iterable[str], where: str, default: str | None = None
) -> Float[np.ndarray, " N"]:
    """All numbers of some attributes, of each one or several; raises UserError for missing ones and other words."""
    found: list[float] = []
    for key in keys:
        text = attribute(element, key, where) if default is None else element.get(key, default)
        try:
            found += [float(word) for word in text.split()]
        except ValueError:
            raise UserError(f"{where}: {key} is {short_text(text)}; it must hold numbers") from None
    return np.array(found)


def merged_static(cameras: Sequence[RawCamera], notes: list[str]) -> tuple[RawCamera, ...]:
    """One entry per name where a file has one per frame; a camera that moves is left out with a sentence in ``notes``.

    Raises UserError when all of them move.
    """
    centres = np.array([-c.camera_from_world[:3, :3].T @ c.camera_from_world[:3, 3] for c in cameras])
    still = _STILL * max(float(np.ptp(centres, axis=0).max()) if len(centres) else 0.0, 1e-9)
    kept: dict[str, tuple[RawCamera, np.ndarray]] = {}
    moving: dict[str, float] = {}
    for camera, centre in zip(cameras, centres):
        first, first_centre = kept.setdefault(camera.name, (camera, centre))
        turned = first.camera_from_world[:3, :3] @ camera.camera_from_world[:3, :3].T
        skew = np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
        angle_deg = float(np.degrees(np.arctan2(np.linalg.norm(skew) / 2, (np.trace(turned) - 1) / 2)))
        if np.linalg.norm(centre - first_centre) > still or angle_deg > _STILL_DEG:
            moving[camera.name] = max(moving.get(camera.name, 0.0), angle_deg)
    notes += [
        f"camera {name} moves (by {angle:.1f}° within its pictures) and was left out: only static cameras are supported"
        for name, angle in moving.items()
    ]
    if moving and len(moving) == len(kept):
        raise UserError(
            f"all cameras of the calibration move, by up to {max(moving.values()):.1f}°; only static ones can be used"
        )
    return tuple(camera for camera, _ in kept.values() if camera.name not in moving)
