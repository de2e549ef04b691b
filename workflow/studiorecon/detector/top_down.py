# SPDX-License-Identifier: Apache-2.0
"""The user's own network for one person at a time: RTMPose, ViTPose, HRNet, or another of their kind.

It runs after BlazePose, which detects, follows and crops people, and replaces the points that both know. Form, as
MMPose and its relatives export it: an upright crop, taller than wide or square, 1.25 times the box around the person;
RGB normalised by ImageNet's mean and deviation; channels before rows; and either a heat map per point (Xiao et al.,
2018; ViTPose: Xu et al., 2022) or two rows of scores, one per axis (SimCC: Li et al., 2022; RTMPose: Jiang et al.,
2023).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.detector.crops import Region, sample_region
from studiorecon.errors import UserError
from studiorecon.geometry.statistics import peak_position
from studiorecon.keypoints.layouts import BY_COUNT, LAYOUTS, USUAL

if TYPE_CHECKING:
    import onnxruntime
    from jaxtyping import Num

AUTO = "auto"
# ImageNet's, of 255.
_MEAN = np.array([123.675, 116.28, 103.53], np.float32)
_DEVIATION = np.array([58.395, 57.12, 57.375], np.float32)
# The crop, in boxes around the person; a box of landmarks ends at the ears, a person's does not.
_MARGIN, _ABOVE_EARS = 1.25, 0.08
_LARGEST_PX = 1024
_SHAPE = "one person's picture: (1, 3, height, width), height and width as numbers"


@dataclass(frozen=True)
class Crop:
    """The part of a picture that the network gets: middle (2,), and picture pixels per pixel of the crop."""

    centre: Num[np.ndarray, " 2"]
    scale: float


class TopDown:
    """The network, on one core. Raises UserError for a file that is no such network, or whose points have no name.

    Args:
        session: the opened network.
        path: its file, for messages.
        layout: name of its points (``keypoints.layouts``), or "auto" where their number determines it.
    """

    def __init__(self, session: onnxruntime.InferenceSession, path: Path, layout: str) -> None:
        self._session = session
        given = self._session.get_inputs()
        shape = tuple(given[0].shape)
        if len(given) != 1 or len(shape) != 4 or shape[1] != 3 or not all(_is_size(s) for s in shape[2:]):
            inputs = ", ".join(f"{one.name} {tuple(one.shape)}" for one in given)
            raise UserError(f"{path} takes {inputs}; detect.network must take {_SHAPE}: export it again")
        self.wh = int(shape[3]), int(shape[2])
        self._input = given[0].name
        answer = self._run(np.zeros((self.wh[1], self.wh[0], 3), np.uint8))
        points = self._points(answer)
        if points is None:
            shapes = ", ".join(str(part.shape) for part in answer)
            raise UserError(
                f"{path} returns {shapes}; detect.network must return heat maps (points, height, width) or SimCC "
                "(points, columns) and (points, rows): export it without later layers"
            )
        self.layout = network_layout(len(points), layout, path)
        self.note = path.stem

    def look(self, picture: Num[np.ndarray, "H W 3"], landmarks: Num[np.ndarray, "N 2"]) -> Num[np.ndarray, "K 3"]:
        """Points x, y in pixels of ``picture`` (RGB, centres at +0.5) and score in [0, 1] of the person with
        ``landmarks``."""
        crop = choose_crop(landmarks, self.wh)
        edge = max(self.wh)
        square = sample_region(picture, Region(crop.centre, edge * crop.scale, 0.0), edge)
        left, top = ((edge - side) // 2 for side in self.wh)
        points = self._points(self._run(square[top : top + self.wh[1], left : left + self.wh[0]]))
        assert points is not None, "the network's answer changed its shape"
        corner = crop.centre - edge / 2 * crop.scale + crop.scale * np.array([left, top])
        return np.column_stack([corner + crop.scale * points[:, :2], np.clip(points[:, 2], 0, 1)])

    def _run(self, crop: np.ndarray) -> list[np.ndarray]:
        normal = ((crop - _MEAN) / _DEVIATION).transpose(2, 0, 1)[None].astype(np.float32)
        return [out[0].astype(np.float64) for out in self._session.run(None, {self._input: normal})]

    def _points(self, answer: list[np.ndarray]) -> Num[np.ndarray, "K 3"] | None:
        """Points in pixels of the crop and their scores; None for outputs of another form."""
        if len(answer) == 1 and answer[0].ndim == 3:
            return points_from_heat_maps(answer[0], self.wh)
        if len(answer) == 2 and all(part.ndim == 2 for part in answer) and len(answer[0]) == len(answer[1]):
            return points_from_simcc(answer[0], answer[1], self.wh)
        return None


def _is_size(side: object) -> bool:
    return isinstance(side, int) and 0 < side <= _LARGEST_PX


def network_layout(points: int, layout: str, path: Path) -> str:
    """The layout of a network's points, as stated or from their number; raises UserError where the two do not fit."""
    if layout != AUTO:
        if (wanted := len(LAYOUTS[layout].keypoints)) != points:
            raise UserError(f"{path} gives {points} points; detect.network_layout {layout} has {wanted}")
        return layout
    known = (USUAL[points],) if points in USUAL else BY_COUNT.get(points, ())
    if not known:
        counts = ", ".join(map(str, BY_COUNT))
        raise UserError(f"{path} gives {points} points; use a network whose layout is known: of {counts} points")
    if len(known) > 1:
        which = " or ".join(known)
        raise UserError(f"{path} gives {points} points, which may be {which}; set detect.network_layout to one of them")
    return known[0]


def choose_crop(landmarks: Num[np.ndarray, "N 2"], wh: tuple[int, int]) -> Crop:
    """The part of the picture around a person's landmarks that fills a crop of ``wh`` pixels."""
    low, high = landmarks.min(0), landmarks.max(0)
    low = low - [0.0, _ABOVE_EARS * (high - low).max()]
    scale = float(((high - low) * _MARGIN / wh).max())
    return Crop((low + high) / 2, max(scale, 1e-3))


def points_from_heat_maps(heat: Num[np.ndarray, "K H W"], wh: tuple[int, int]) -> Num[np.ndarray, "K 3"]:
    """Crop pixels and scores of heat maps' peaks, each to a fraction of a cell by the parabola through the logarithms
    around it: exact for the Gaussians that such networks are trained on.

    The outermost cells' centres lie on those of the crop's outermost pixels (Huang et al., "The Devil is in the
    Details", 2020), as in ViTPose.
    """
    count, rows, columns = heat.shape
    flat = heat.reshape(count, -1).argmax(1)
    place = np.column_stack([flat % columns, flat // columns]).astype(np.float64)
    score = heat.reshape(count, -1).max(1)
    with np.errstate(divide="ignore"):
        logs = np.log(np.maximum(heat, 1e-10))
    for k, (x, y) in enumerate(place.astype(int)):
        if 0 < x < columns - 1:
            place[k, 0] += peak_position(logs[k, y, x - 1 : x + 2])
        if 0 < y < rows - 1:
            place[k, 1] += peak_position(logs[k, y - 1 : y + 2, x])
    cells = np.array([columns, rows])
    return np.column_stack([place * (np.array(wh) - 1) / np.maximum(cells - 1, 1) + 0.5, score])


def points_from_simcc(
    columns: Num[np.ndarray, "K X"], rows: Num[np.ndarray, "K Y"], wh: tuple[int, int]
) -> Num[np.ndarray, "K 3"]:
    """Crop pixels and scores of SimCC's two rows of scores, whose bins split every pixel alike."""
    place = np.column_stack([columns.argmax(1) * (wh[0] / columns.shape[1]), rows.argmax(1) * (wh[1] / rows.shape[1])])
    return np.column_stack([place + 0.5, np.minimum(columns.max(1), rows.max(1))])
