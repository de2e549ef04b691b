# SPDX-License-Identifier: Apache-2.0
"""Readout time of each camera, estimated from people: ``people/who/readouts.json``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from studiorecon.scene.files import write_json
from studiorecon.scene.schema import MappingOf, seconds
from studiorecon.scene.step_files import read

# Digits of a readout in seconds: a smaller change moves no keypoint by a tenth of a pixel.
_DIGITS = 4
_READOUTS = MappingOf(seconds(low=-1, high=1))


@dataclass(frozen=True)
class Readout:
    """The readout estimate of one camera.

    Attributes:
        readout_s, sigma_s: seconds from the first row to the last, and their standard error; None where undetermined.
        used_s: the readout for correcting keypoints: ``readout_s``, or 0 with a ``reason``.
    """

    camera: str
    readout_s: float | None
    sigma_s: float | None
    used_s: float
    reason: str


def write_readouts(path: Path, readouts: Sequence[Readout]) -> None:
    """Write the used readout of all cameras in their order only: any change of the file refits the bodies."""
    write_json(path, {one.camera: round(one.used_s, _DIGITS) for one in readouts})


def read_readouts(path: Path, cameras: Sequence[str] = ()) -> dict[str, float]:
    """Camera → readout in seconds, of ``cameras`` at least; raises UserError as ``step_files.read`` does."""

    def made(value: dict[str, float]) -> dict[str, float]:
        if missing := [camera for camera in cameras if camera not in value]:
            raise KeyError(missing[0])
        return {camera: float(used_s) for camera, used_s in value.items()}

    return read(path, _READOUTS, made)
