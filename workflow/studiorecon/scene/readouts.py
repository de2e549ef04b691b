# SPDX-License-Identifier: Apache-2.0
"""How long each camera takes from its first row to its last, as people told: ``people/who/readouts.json``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from studiorecon.scene.files import write_json
from studiorecon.scene.intermediate import read
from studiorecon.scene.schema import Named, seconds

# Seconds, to which a readout is written: what is less moves no keypoint by a tenth of a pixel.
_DIGITS = 4
_READOUTS = Named(seconds(low=-1, high=1))


@dataclass(frozen=True)
class Readout:
    """What is known of one camera's readout.

    Attributes:
        camera: its name.
        readout_s, sigma_s: seconds from the first row to the last, and their standard error; None where nothing tells.
        used_s: what keypoints are moved by: ``readout_s``, or 0 with a ``reason``.
    """

    camera: str
    readout_s: float | None
    sigma_s: float | None
    used_s: float
    reason: str


def write_readouts(path: Path, readouts: Sequence[Readout]) -> None:
    """What is used of all cameras' readouts, in their order, and no more: bodies are fitted again when it changes."""
    write_json(path, {one.camera: round(one.used_s, _DIGITS) for one in readouts})


def read_readouts(path: Path, cameras: Sequence[str] = ()) -> dict[str, float]:
    """Camera → seconds by which its rows are moved, of ``cameras`` at least; raises UserError as ``intermediate.read``
    does."""

    def made(value: dict[str, float]) -> dict[str, float]:
        if missing := [camera for camera in cameras if camera not in value]:
            raise KeyError(missing[0])
        return {camera: float(used_s) for camera, used_s in value.items()}

    return read(path, _READOUTS, made)
