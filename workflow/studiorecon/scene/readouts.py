# SPDX-License-Identifier: Apache-2.0
"""How long each camera takes from its first row to its last, as people told: ``people/shutter.json``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from studiorecon.scene.files import write_json
from studiorecon.scene.intermediate import as_written, read_content


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
    """The readouts of all cameras, in their order."""
    write_json(path, {"cameras": [asdict(one) for one in readouts]})


def read_readouts(path: Path) -> dict[str, float]:
    """Camera → seconds by which its rows are moved; UserError where the file is not as it was written."""
    value = read_content(path)
    with as_written(path):
        return {str(one["camera"]): float(one["used_s"]) for one in value["cameras"]}
