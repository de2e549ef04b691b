# SPDX-License-Identifier: Apache-2.0
"""The size of a camera's film, and how its recorded keypoints fit it: ``detect/keypoints/<camera>.json``."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from studiorecon.scene.files import write_json
from studiorecon.scene.schema import ArrayProperty, ListOf, OptionalField, real, record, text, whole
from studiorecon.scene.step_files import read

_SCHEMA = {
    "camera": text(),
    "wh": whole("2", low=0, unit="px"),
    "pixel_map": OptionalField(real("N", such=ArrayProperty("a scale, x and y", lambda map: len(map) in (0, 3)))),
    "refusal": OptionalField(text()),
    "notes": OptionalField(ListOf(text())),
}


@dataclass(frozen=True)
class KeypointVerdict:
    """A film and its recorded keypoints.

    Attributes:
        wh: size of the film as shown, (0, 0) where it cannot be read.
        pixel_map: [scale, x, y] of ``Dataset.pixel_maps``, or empty.
        refusal: why its keypoints cannot be used; "" where they can.
        notes: sentences on how they are read.
    """

    camera: str
    wh: tuple[int, int]
    pixel_map: tuple[float, ...] = ()
    refusal: str = ""
    notes: tuple[str, ...] = ()


def write_keypoint_verdict(path: Path, verdict: KeypointVerdict) -> None:
    write_json(path, asdict(verdict))


def read_keypoint_verdict(path: Path) -> KeypointVerdict:
    """A film's size and how its keypoints fit it; raises UserError as ``step_files.read`` does."""
    return read(path, _SCHEMA, partial(record, KeypointVerdict))
