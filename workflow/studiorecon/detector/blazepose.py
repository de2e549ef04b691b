# SPDX-License-Identifier: Apache-2.0
"""BlazePose: 33 landmarks, a mask and a metric guess of a person in a region of a picture.

Networks: Bazarevsky et al., "BlazePose: On-device Real-time Body Pose tracking" (2020) and the model card "BlazePose
GHUM 3D" (Google, Apache-2.0), as ONNX files under resources/detector, which describes their inputs and outputs.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.detector.crops import Region, sample_region
from studiorecon.detector.second_network import SecondNetwork
from studiorecon.errors import UserError
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.machine.onnx_network import open_network

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

LAYOUT = "blazepose33"
LANDMARKS = 33
_CROP_PX, _HEAT_PX = 256, 64
PRESENT = 0.5
"""How sure the landmark network must be that somebody is in a region."""
MASK_PX = 128
"""Edge of the masks that are kept: the network's own 256 hold no more than that."""
# Two points beside the 33 say where the body is: the middle of the hips, and a point on the circle around it.
_HIPS, _CIRCLE = 33, 34
_HEAT_REACH = 3
_HEAT_SURE = 0.5


@dataclass(frozen=True)
class Landmarks:
    """A person's landmarks in a region of a picture.

    Attributes:
        keypoints: x, y in pixels of the picture (centres at +0.5) and visibility 0..1 as the network gives it.
        presence: probability that somebody is there at all.
        points_m: the network's guess, metres about the middle of the hips, axes of the camera (x right, y down,
            z forward).
        mask: (MASK_PX, MASK_PX) uint8, 255 = surely this person, over the upright crop of ``region``.
        region: the part of the picture that was given to the network.
        next_region: the region to use in the next picture.
        better: points and scores of the user's own network, NaN where it has no such point; None without one.
    """

    keypoints: Num[np.ndarray, "33 3"]
    presence: float
    points_m: Num[np.ndarray, "33 3"]
    mask: Integer[np.ndarray, "S S"]
    region: Region
    next_region: Region
    better: Num[np.ndarray, "33 3"] | None = None


class BlazePose:
    """The landmark network, on one core: cameras run in parallel, and the same picture gives the same numbers."""

    def __init__(self, landmarks: Path, second: SecondNetwork | None = None) -> None:
        """``second`` replaces the points that it also knows. Raises UserError when a file is missing or wrong."""
        self._landmarks = open_network(landmarks, "take it from a fresh copy of resources/detector")
        if (given := tuple(self._landmarks.get_inputs()[0].shape)) != (1, _CROP_PX, _CROP_PX, 3):
            raise UserError(f"{landmarks} takes an array of {given}, so it is not BlazePose")
        self._second = second
        self.title = f"{landmarks.stem} and {second.note} ({second.layout})" if second else landmarks.stem
        own = LAYOUTS[LAYOUT].keypoints
        theirs = LAYOUTS[second.layout].keypoints if second else ()
        self._shared = [(own.index(name), theirs.index(name)) for name in theirs if name in own]
        if second and not self._shared:
            raise UserError(
                f"detect.network has the layout {second.layout}, which shares no keypoint with "
                "BlazePose; choose another network"
            )

    def look(self, picture: Integer[np.ndarray, "H W 3"], region: Region) -> Landmarks:
        """Landmarks of the person in ``region`` of ``picture`` (RGB); ``presence`` is the probability of a person."""
        crop = sample_region(picture, region, _CROP_PX)
        given = {self._landmarks.get_inputs()[0].name: crop[None] * np.float32(1 / 255)}
        points, presence, mask, heat, guess = (out[0] for out in self._landmarks.run(None, given))
        points = points.reshape(39, 5).astype(np.float64)
        pixels = region.in_picture(refine_landmarks(points[:, :2], heat), _CROP_PX)
        c, s = np.cos(region.turn_rad), np.sin(region.turn_rad)
        upright = guess.reshape(39, 3)[:LANDMARKS].astype(np.float64)
        turned = upright @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        small = cv2.resize(_sigmoid(mask[..., 0]), (MASK_PX, MASK_PX), interpolation=cv2.INTER_AREA)
        better = self._better(picture, pixels[:LANDMARKS]) if presence[0] >= PRESENT else None
        return Landmarks(
            np.column_stack([pixels[:LANDMARKS], _sigmoid(points[:LANDMARKS, 3])]),
            float(presence[0]),
            turned,
            np.rint(small * 255).astype(np.uint8),
            region,
            Region.around(pixels[_HIPS], pixels[_CIRCLE]),
            better,
        )

    def _better(self, picture: np.ndarray, pixels: np.ndarray) -> np.ndarray | None:
        """(33, 3) the second network's points and scores for the person with landmarks at ``pixels``."""
        if self._second is None:
            return None
        refined = self._second.look(picture, pixels)
        out = np.full((LANDMARKS, 3), np.nan)
        for own, theirs in self._shared:
            out[own] = refined[theirs]
        return out


def refine_landmarks(points: Num[np.ndarray, "K 2"], heat: Num[np.ndarray, "64 64 K"]) -> Num[np.ndarray, "K 2"]:
    """Crop pixels of landmarks, moved to the centre of their heat map's peak where that is clear within three cells."""
    out = points.copy()
    for k, (x, y) in enumerate(points * (_HEAT_PX / _CROP_PX)):
        if not (0 <= x < _HEAT_PX and 0 <= y < _HEAT_PX):
            continue
        left, top = max(0, int(x) - _HEAT_REACH), max(0, int(y) - _HEAT_REACH)
        cells = _sigmoid(heat[top : int(y) + _HEAT_REACH + 1, left : int(x) + _HEAT_REACH + 1, k].astype(np.float64))
        if cells.max() < _HEAT_SURE:
            continue
        rows, columns = np.mgrid[0 : cells.shape[0], 0 : cells.shape[1]]
        middle = (
            np.array([(cells * columns).sum() + left * cells.sum(), (cells * rows).sum() + top * cells.sum()])
            / cells.sum()
        )
        out[k] = middle * (_CROP_PX / _HEAT_PX)
    return out


def _sigmoid(logits: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-np.clip(logits, -60, 60)))
