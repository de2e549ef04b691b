# SPDX-License-Identifier: Apache-2.0
"""The detector's files, as a step gets them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from studiorecon.detector.blazepose import BlazePose
from studiorecon.detector.frame_detection import Detector
from studiorecon.detector.movenet import MoveNet
from studiorecon.detector.second_network import second_network
from studiorecon.scene.files import read_json


@dataclass(frozen=True)
class DetectorFiles:
    """Files of the detector.

    Attributes:
        networks: MoveNet, which finds people; BlazePose, which places them; the confidence of its landmarks.
        second: the user's own network, or none.
        layout: of that network's points, or "auto".
    """

    networks: list[Path]
    second: list[Path] = field(default_factory=list)
    layout: str = "auto"

    def detector(self) -> Detector:
        """Both networks; raises UserError when a file is missing or wrong."""
        return Detector(MoveNet(self.networks[0]), self.placer())

    def placer(self) -> BlazePose:
        """BlazePose, with the user's network, for people whose region is known."""
        return BlazePose(self.networks[1], second_network(self.second, self.layout))

    def worth(self) -> dict[str, list[float]]:
        """Confidence of landmarks by their visibility."""
        return read_json(self.networks[2])
