# SPDX-License-Identifier: Apache-2.0
"""A hand's 21 points in a region of a picture, and the regions to look in.

Network: Zhang et al., "MediaPipe Hands: On-device Real-time Hand Tracking" (2020) and its model card (Google,
Apache-2.0), as an ONNX file under resources/detector, which describes its input and outputs. The arm shows where a hand
is, so the palm detector that usually comes before is not needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.detector.crops import Region, sample_region
from studiorecon.errors import UserError
from studiorecon.keypoints.hands import HAND_POINTS
from studiorecon.machine.onnx_network import open_network

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

MIN_PRESENCE = 0.5
"""Probability of a hand from which its points are used: more likely than not."""
MIN_GUESS = 0.2
"""The same from which the region around the points is looked at in the next picture."""
_CROP_PX = 224
# The crop where only the arm is known: its side, and its middle's distance from the wrist, in lengths of the hand. With
# them 44 of a real man's 48 hands are found, with 1.5 and 0.35 only 37.
_ARM_SIDE, _BEYOND_WRIST = 1.25, 0.25
# The crop around known points: the points without the outer two of each finger, which bend; its side in longer sides of
# their box, and how far its middle is moved towards the fingers, as the network was trained (2 and 0.1; on the made
# studio's hands 1.8 is nearer by 4 % at the worst tenth).
_PALM = (0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18)
_PALM_SIDE, _TOWARDS_FINGERS = 1.8, 0.1
_WRIST, _MIDDLE_ROOT = 0, 9


@dataclass(frozen=True)
class Hand:
    """A hand in a region of a picture.

    Attributes:
        points: x, y in pixels of the picture, centres at +0.5 (``keypoints/hands.py`` has their order).
        presence: probability that there is a hand.
        right: probability that it is a right one.
    """

    points: Num[np.ndarray, "21 2"]
    presence: float
    right: float

    @property
    def region(self) -> Region:
        """The region around its points, fingers up, to look again or in the next picture."""
        towards = self.points[_MIDDLE_ROOT] - self.points[_WRIST]
        turn_rad = float(np.arctan2(towards[0], -towards[1]))
        c, s = np.cos(turn_rad), np.sin(turn_rad)
        upright = self.points[list(_PALM)] @ np.array([[c, -s], [s, c]])
        low, high = upright.min(0), upright.max(0)
        extent = float((high - low).max())
        centre = ((low + high) / 2 - [0, _TOWARDS_FINGERS * extent]) @ np.array([[c, s], [-s, c]])
        return Region(centre, _PALM_SIDE * extent, turn_rad)


class HandLandmarks:
    """The network, on one core. Raises UserError when its file is missing or another network."""

    def __init__(self, path: Path) -> None:
        self._session = open_network(path, "take it from a fresh copy of resources/detector")
        if (given := tuple(self._session.get_inputs()[0].shape)) != (1, _CROP_PX, _CROP_PX, 3):
            raise UserError(f"{path} takes an array of {given}, so it is not the network for hands")

    def look(self, picture: Integer[np.ndarray, "H W 3"], region: Region) -> Hand:
        """The hand in ``region`` of ``picture`` (RGB)."""
        crop = sample_region(picture, region, _CROP_PX)
        given = {self._session.get_inputs()[0].name: crop[None] * np.float32(1 / 255)}
        points, presence, right, _ = self._session.run(None, given)
        places = points.reshape(HAND_POINTS, 3)[:, :2].astype(np.float64)
        return Hand(region.in_picture(places, _CROP_PX), presence.item(), right.item())


def region_of_arm(wrist: Num[np.ndarray, " 2"], towards: Num[np.ndarray, " 2"], length_px: float) -> Region:
    """The region of a hand of ``length_px`` at the end of an arm, which points ``towards`` a place beyond its
    wrist."""
    along = (towards - wrist) / max(float(np.linalg.norm(towards - wrist)), 1e-9)
    return Region(
        wrist + along * _BEYOND_WRIST * length_px, _ARM_SIDE * length_px, float(np.arctan2(along[0], -along[1]))
    )
