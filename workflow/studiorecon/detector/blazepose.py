# SPDX-License-Identifier: Apache-2.0
"""BlazePose: people in a square window of a picture, and 33 landmarks, a mask and a metric guess of somebody in a
region of it.

Networks: Bazarevsky et al., "BlazePose: On-device Real-time Body Pose tracking" (2020) and the model card "BlazePose
GHUM 3D" (Google, Apache-2.0), as ONNX files under resources/detector. What goes in and comes out is described there and
was checked against the original.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import onnxruntime

from studiorecon.arrays import require
from studiorecon.errors import UserError
from studiorecon.machine import starved

if TYPE_CHECKING:
    from jaxtyping import Num

LAYOUT = "blazepose33"
LANDMARKS = 33
_WINDOW_PX, _CROP_PX, _HEAT_PX = 224, 256, 64
MASK_PX = 128
"""Edge of the masks that are kept: the network's own 256 hold no more than that."""
# Cells across the window and anchors per cell, in the order of the detector's 2,254 rows.
_CELLS = ((28, 2), (14, 2), (7, 6))
# A region's side, in diameters of the circle around the body that the networks find.
_REGION_SCALE = 1.25
# Two points beside the 33 say where the body is: the middle of the hips, and a point on the circle around it.
_HIPS, _CIRCLE = 33, 34
_HEAT_REACH = 3
_HEAT_SURE = 0.5


@dataclass(frozen=True)
class Region:
    """A turned square of the picture that holds somebody.

    Attributes:
        centre: (2,) middle of the hips, pixels.
        side: edge, pixels.
        turn_rad: how far the body's up is turned clockwise from the picture's.
    """

    centre: Num[np.ndarray, " 2"]
    side: float
    turn_rad: float

    @staticmethod
    def around(hips: np.ndarray, circle: np.ndarray) -> Region:
        """The region of a body from the middle of its hips (2,) and the point (2,) of the circle around it that is
        upwards."""
        towards = circle - hips
        return Region(
            hips, 2 * _REGION_SCALE * float(np.linalg.norm(towards)), float(np.arctan2(towards[0], -towards[1]))
        )

    def crop_from_picture(self, edge: int) -> Num[np.ndarray, "2 3"]:
        """(2, 3) affine map of picture pixels to those of an upright crop of ``edge`` pixels, centres at +0.5 on both
        sides."""
        scale, c, s = edge / self.side, np.cos(self.turn_rad), np.sin(self.turn_rad)
        linear = scale * np.array([[c, s], [-s, c]])
        return np.column_stack([linear, edge / 2 - linear @ self.centre])


@dataclass(frozen=True)
class Landmarks:
    """Somebody in a region of a picture.

    Attributes:
        keypoints: (33, 3) x, y in pixels of the picture (centres at +0.5) and visibility 0..1 as the network gives it.
        presence: probability that somebody is there at all.
        points_m: (33, 3) the network's guess, metres about the middle of the hips, axes of the camera (x right, y down,
            z forward).
        mask: (MASK_PX, MASK_PX) uint8, 255 = surely this person, over the upright crop of ``region``.
        region: what was looked at.
        next_region: where to look in the next picture.
    """

    keypoints: Num[np.ndarray, "33 3"]
    presence: float
    points_m: Num[np.ndarray, "33 3"]
    mask: np.ndarray
    region: Region
    next_region: Region


class BlazePose:
    """The two networks, on one core: cameras are looked at side by side, and the same picture gives the same
    numbers."""

    def __init__(self, detection: Path, landmarks: Path) -> None:
        """Raises UserError when a file is missing or not what it should be."""
        self._detection = open_network(detection, (1, _WINDOW_PX, _WINDOW_PX, 3))
        self._landmarks = open_network(landmarks, (1, _CROP_PX, _CROP_PX, 3))
        self._anchors = anchors()

    def detect(
        self, picture: np.ndarray, corner: Num[np.ndarray, " 2"], side: float, least: float
    ) -> list[tuple[float, Region]]:
        """(score, region) of whoever is in the window of ``picture`` (H, W, 3 uint8 RGB) at ``corner`` (2,), above
        ``least``."""
        window = sampled(picture, Region(corner + side / 2, side, 0.0), _WINDOW_PX)
        rows, logits = run(self._detection, window / np.float32(127.5) - np.float32(1))
        scores = _sigmoid(logits[:, 0].astype(np.float64))
        found = []
        for k in np.flatnonzero(scores > least):
            hips, circle = (self._anchors[k] + rows[k, 4:].reshape(4, 2)[:2] / _WINDOW_PX) * side + corner
            if np.linalg.norm(circle - hips) > 0:
                found.append((float(scores[k]), Region.around(hips, circle)))
        return found

    def look(self, picture: np.ndarray, region: Region) -> Landmarks:
        """Landmarks of whoever is in ``region`` of ``picture`` (H, W, 3 uint8 RGB); ``presence`` says whether somebody
        is."""
        crop = sampled(picture, region, _CROP_PX)
        points, presence, mask, heat, guess = run(self._landmarks, crop * np.float32(1 / 255))
        points = points.reshape(39, 5).astype(np.float64)
        inward = np.linalg.inv(np.vstack([region.crop_from_picture(_CROP_PX), [0, 0, 1]]))[:2]
        pixels = refined(points[:, :2], heat) @ inward[:, :2].T + inward[:, 2]
        c, s = np.cos(region.turn_rad), np.sin(region.turn_rad)
        upright = guess.reshape(39, 3)[:LANDMARKS].astype(np.float64)
        turned = upright @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        small = cv2.resize(_sigmoid(mask[..., 0]), (MASK_PX, MASK_PX), interpolation=cv2.INTER_AREA)
        return Landmarks(
            np.column_stack([pixels[:LANDMARKS], _sigmoid(points[:LANDMARKS, 3])]),
            float(presence[0]),
            turned,
            np.rint(small * 255).astype(np.uint8),
            region,
            Region.around(pixels[_HIPS], pixels[_CIRCLE]),
        )


def open_network(path: Path, shape: tuple[int, ...]) -> onnxruntime.InferenceSession:
    """A network that takes one array of ``shape``; raises UserError naming the file when it is missing or another
    one."""
    if not path.is_file():
        raise UserError(f"network {path} is missing; take it from a fresh copy of resources/detector")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    try:
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises a dozen types of its own, without a common base
        if starved(error):
            raise
        raise UserError(f"{path} cannot be read as an ONNX network ({error}); copy it again") from None
    if (given := tuple(session.get_inputs()[0].shape)) != shape:
        raise UserError(f"{path} takes an array of {given} where BlazePose takes {shape}; it is another network")
    return session


def run(session: onnxruntime.InferenceSession, picture: np.ndarray) -> list[np.ndarray]:
    """What the network says to one picture, without the batch's axis."""
    return [out[0] for out in session.run(None, {session.get_inputs()[0].name: picture[None].astype(np.float32)})]


def anchors() -> Num[np.ndarray, "2254 2"]:
    """(2254, 2) middles of the detector's cells, in shares of the window."""
    found = []
    for across, per_cell in _CELLS:
        rows, columns = np.mgrid[0:across, 0:across]
        middles = np.stack([(columns + 0.5) / across, (rows + 0.5) / across], axis=-1).reshape(-1, 2)
        found.append(np.repeat(middles, per_cell, axis=0))
    return np.concatenate(found)


def sampled(picture: Num[np.ndarray, "H W 3"], region: Region, edge: int) -> np.ndarray:
    """(edge, edge, 3) uint8 upright crop of a region, black beyond the picture; averaged where it shrinks."""
    require("picture", picture, ("H", "W", 3))
    affine = region.crop_from_picture(edge)
    # Whole-number shrinking by averages first, of the region's own surroundings only: the picture may be 4K.
    shrink = max(1, int(region.side / edge))
    if shrink > 1:
        height, width = picture.shape[:2]
        reach = region.side * 0.75 + shrink
        low = np.maximum(np.floor(region.centre - reach), 0).astype(int) // shrink * shrink
        high = np.minimum(np.ceil(region.centre + reach), [width, height]).astype(int)
        if (high - low < shrink).any():
            return np.zeros((edge, edge, 3), np.uint8)
        count = (high - low) // shrink
        part = picture[low[1] : low[1] + count[1] * shrink, low[0] : low[0] + count[0] * shrink]
        picture = cv2.resize(part, (int(count[0]), int(count[1])), interpolation=cv2.INTER_AREA)
        affine = np.column_stack([affine[:, :2] * shrink, affine[:, :2] @ low + affine[:, 2]])
    # OpenCV counts pixels from the first one's centre.
    centred = affine.copy()
    centred[:, 2] += affine[:, :2].sum(1) / 2 - 0.5
    return cv2.warpAffine(picture, centred, (edge, edge), flags=cv2.INTER_LINEAR)


def refined(points: np.ndarray, heat: np.ndarray) -> Num[np.ndarray, "K 2"]:
    """(K, 2) crop pixels of landmarks, moved to the middle of their heat (64, 64, K) where that is sure within three
    cells."""
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
