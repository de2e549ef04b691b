# SPDX-License-Identifier: Apache-2.0
"""MoveNet MultiPose: everybody in a picture, in one pass.

Network: "MoveNet.MultiPose Lightning" (Google, Apache-2.0), a CenterNet (Zhou et al., "Objects as Points", 2019) over a
feature pyramid; resources/detector describes its six maps. They are read here as the original graph reads them, except
that the graph stops at six people.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.errors import UserError
from studiorecon.machine.onnx_network import open_network

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

_POINTS = 17
_MAPS = {"centre", "box_size", "box_middle", "guess", "heat", "offset"}
# The network's input is a multiple of this, pixels; a cell of its maps has so many.
_STEP_PX, _CELL_PX = 32, 4
# A person's middle is the largest value of so many cells by so many.
_PEAK_CELLS = 5
# Variance of a point about its guess, in cells, per cell of the picture's shorter side.
_SPREAD = 0.300048828125
# Points below this score do not count in the person's.
_MIN_POINT = 0.126953125


@dataclass(frozen=True)
class Sighting:
    """A person that MoveNet found.

    Attributes:
        score: confidence, 0 to 1.
        keypoints: x, y, score of COCO's points; pixels, centres at +0.5.
    """

    score: float
    keypoints: Float[np.ndarray, "17 3"]


class MoveNet:
    """The network, on one core: the same picture gives the same numbers."""

    def __init__(self, network: Path) -> None:
        """Raises UserError when the file is missing or another network."""
        self._session = open_network(network, "take it from a fresh copy of resources/detector")
        if {out.name for out in self._session.get_outputs()} != _MAPS:
            raise UserError(f"{network} is not MoveNet; restore it from a fresh copy of resources/detector")

    def find(self, picture: Integer[np.ndarray, "H W 3"], longer_px: int, least: float) -> list[Sighting]:
        """The people above the score ``least`` in a picture (RGB) that is shrunk to ``longer_px``."""
        small = shrink_to(picture, longer_px)
        padding = [(0, -side % _STEP_PX) for side in small.shape[:2]]
        found = decode_people(self.maps(np.pad(small, [*padding, (0, 0)])), least)
        from_shown = np.array([picture.shape[1] / small.shape[1], picture.shape[0] / small.shape[0], 1.0])
        return [Sighting(one.score, one.keypoints * from_shown) for one in found]

    def maps(self, shown: Integer[np.ndarray, "H W 3"]) -> dict[str, Float[np.ndarray, "h w C"]]:
        """The maps of a picture whose sides are multiples of 32, by name."""
        answer = self._session.run(None, {self._session.get_inputs()[0].name: shown[None].astype(np.float32)})
        return {out.name: map_[0].astype(np.float64) for out, map_ in zip(self._session.get_outputs(), answer)}


def shrink_to(picture: Integer[np.ndarray, "H W 3"], longer_px: int) -> Integer[np.ndarray, "h w 3"]:
    """The picture with a longer side of at most ``longer_px``."""
    height, width = picture.shape[:2]
    scale = min(1.0, longer_px / max(height, width))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


def decode_people(maps: dict[str, Num[np.ndarray, "h w C"]], least: float) -> list[Sighting]:
    """The people above the score ``least`` in the network's maps, most confident first, in pixels of its input."""
    middle = _sigmoid(maps["centre"][..., 0])
    # A person's score is the product of that of the middle and of the points, which is at most 1.
    highest = cv2.dilate(middle, np.ones((_PEAK_CELLS, _PEAK_CELLS)))
    cells = np.argwhere((middle == highest) & (middle >= least))
    heat = _sigmoid(maps["heat"])
    found = [_person(maps, heat, cell, float(middle[tuple(cell)])) for cell in cells]
    return sorted((one for one in found if one.score >= least), key=lambda one: -one.score)


def _person(
    maps: dict[str, np.ndarray], heat: Float[np.ndarray, "h w 17"], cell: Integer[np.ndarray, " 2"], middle: float
) -> Sighting:
    """The person with its middle in ``cell`` (row, column): each point is the highest score in the person's box, near
    the middle's prediction."""
    at, (rows, columns) = tuple(cell), heat.shape[:2]
    half = np.maximum(maps["box_size"][at], 0) / 2
    centre = cell + maps["box_middle"][at]
    low, high = (np.clip(edge, 0, [rows, columns]) for edge in (centre - half, centre + half))
    guess = cell + maps["guess"][at].reshape(_POINTS, 2)
    first, last = np.ceil(low).astype(int), np.ceil(high).astype(int)
    keypoints = np.zeros((_POINTS, 3))
    if (last > first).all():
        row, column = np.arange(first[0], last[0]), np.arange(first[1], last[1])
        gaps = (row[:, None, None] - guess[:, 0]) ** 2 + (column[None, :, None] - guess[:, 1]) ** 2
        near = heat[first[0] : last[0], first[1] : last[1]] * np.exp(-gaps / (_SPREAD * min(rows, columns)))
        best = near.reshape(-1, _POINTS).argmax(0)
        r, c = first[0] + best // len(column), first[1] + best % len(column)
        offset = maps["offset"].reshape(rows, columns, _POINTS, 2)[r, c, np.arange(_POINTS)]
        keypoints[:, :2] = _CELL_PX * (np.column_stack([c, r]) + offset[:, ::-1])
        keypoints[:, 2] = near.reshape(-1, _POINTS).max(0)
    sure = keypoints[keypoints[:, 2] > _MIN_POINT, 2]
    score = middle * float(sure.mean()) if len(sure) else 0.0
    return Sighting(score, keypoints)


def _sigmoid(logits: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-logits))
