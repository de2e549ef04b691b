# SPDX-License-Identifier: Apache-2.0
"""The imported calibration, or the one estimated from people: ``calibration/calibration.json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from studiorecon.scene.camera import LENS, Lens
from studiorecon.scene.schema import Anything, ListOf, MappingOf, OptionalField, flag, record, text
from studiorecon.scene.step_files import expect, read, require

_CALIBRATION = {
    "lenses": ListOf(LENS),
    "source": OptionalField(text()),
    "format": OptionalField(text()),
    "floor_known": OptionalField(flag()),
    "notes": OptionalField(ListOf(text())),
    "doubts": OptionalField(ListOf(text())),
    "people_rig": OptionalField(MappingOf(Anything())),
}


@dataclass(frozen=True)
class Calibration:
    """All lenses of a scene by the name of their camera, in the file's order, and facts about them.

    Attributes:
        floor_known: whether z = 0 is the floor.
        about: source, format, notes and doubts, for people to read.
        left_out: camera → the reason why people could not calibrate it; only in a calibration from people.
    """

    lenses: Mapping[str, Lens]
    floor_known: bool = True
    about: Mapping[str, Any] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)


def read_calibration(path: Path) -> Calibration:
    """The calibration; raises UserError as ``step_files.read`` does."""
    return read(path, _CALIBRATION, _calibration)


def _calibration(value: Mapping[str, Any]) -> Calibration:
    lenses = {lens.name: lens for lens in (record(Lens, one) for one in value["lenses"])}
    expect(len(lenses) == len(value["lenses"]), "two lenses share a name")
    about = {name: value.get(name) for name in ("source", "format", "notes", "doubts")}
    left_out = (value.get("people_rig") or {}).get("left_out", {})
    return Calibration(lenses, value.get("floor_known") is not False, about, left_out)


def read_lenses(calibration: Path) -> Mapping[str, Lens]:
    """All lenses by the name of their camera, in the file's order."""
    return read_calibration(calibration).lenses


def find_lens(calibration: Path, camera: str) -> Lens:
    """The lens of one camera; raises UserError for an unknown camera."""
    lenses = read_lenses(calibration)
    require(calibration, camera in lenses, f"it has no camera {camera}, but {', '.join(lenses)}")
    return lenses[camera]
