# SPDX-License-Identifier: Apache-2.0
"""The detector as the files that a step takes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from studiorecon.detector.blazepose import BlazePose
from studiorecon.detector.second_network import second_network
from studiorecon.scene.files import read_json


@dataclass(frozen=True)
class DetectorFiles:
    """``networks`` are the finder's, BlazePose's and its table of confidence, ``second`` is the user's own network, if
    any, with ``layout`` for its points."""

    networks: list[Path]
    second: list[Path]
    layout: str

    def open(self) -> BlazePose:
        """BlazePose, with the user's network: places people whose region is known."""
        return BlazePose(self.networks[1], second_network(self.second, self.layout))

    def worth(self) -> dict[str, list[float]]:
        """Confidence of landmarks by their visibility."""
        return read_json(self.networks[2])
