# SPDX-License-Identifier: Apache-2.0
"""The size of a camera's film, and how its recorded keypoints fit it: ``detect/keypoints/<camera>.json``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from studiorecon.scene.files import write_json
from studiorecon.scene.schema import ListOf, OptionalField, real, text, whole
from studiorecon.scene.step_files import expect, read

_SCHEMA = {
    "camera": text(),
    "wh": whole("2", low=0, unit="px"),
    "pixel_map": OptionalField(real("N")),
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
    pixel_map: Sequence[float] = ()
    refusal: str = ""
    notes: Sequence[str] = ()


def write_keypoint_verdict(path: Path, verdict: KeypointVerdict) -> None:
    write_json(path, asdict(verdict))


def read_keypoint_verdict(path: Path) -> KeypointVerdict:
    """A film's size and how its keypoints fit it; raises UserError as ``step_files.read`` does."""
    return read(path, _SCHEMA, _verdict)


def _verdict(value: dict[str, Any]) -> KeypointVerdict:
    pixel_map = tuple(map(float, value.get("pixel_map") or ()))
    expect(len(pixel_map) in (0, 3), f"pixel_map has {len(pixel_map)} numbers, expected a scale, x and y")
    width, height = value["wh"]
    sentences = value.get("refusal") or "", tuple(value.get("notes") or ())
    return KeypointVerdict(value["camera"], (width, height), pixel_map, *sentences)
