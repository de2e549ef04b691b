# SPDX-License-Identifier: Apache-2.0
"""Square regions of pictures that hold a person, and their upright crops."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# A region's side, in diameters of the circle around the body that the networks find.
_REGION_SCALE = 1.25
# So many joints of a known body must be inside the picture, and how far the circle around it reaches beyond them.
_MIN_JOINTS = 8
_CIRCLE = 1.15


@dataclass(frozen=True)
class Region:
    """A rotated square of the picture that holds a person.

    Attributes:
        centre: middle of the hips, pixels.
        side: edge, pixels.
        turn_rad: clockwise angle from the picture's up to the body's.
    """

    centre: Num[np.ndarray, " 2"]
    side: float
    turn_rad: float

    @staticmethod
    def around(hips: Num[np.ndarray, " 2"], circle: Num[np.ndarray, " 2"]) -> Region:
        """The region of a body from the middle of its hips and the point of the circle around it above the body."""
        towards = circle - hips
        return Region(
            hips, 2 * _REGION_SCALE * float(np.linalg.norm(towards)), float(np.arctan2(towards[0], -towards[1]))
        )

    def crop_from_picture(self, edge: int) -> Num[np.ndarray, "2 3"]:
        """Affine map of picture pixels to those of an upright crop of ``edge`` pixels, centres at +0.5 on both
        sides."""
        scale, c, s = edge / self.side, np.cos(self.turn_rad), np.sin(self.turn_rad)
        linear = scale * np.array([[c, s], [-s, c]])
        return np.column_stack([linear, edge / 2 - linear @ self.centre])

    def in_picture(self, pixels: Num[np.ndarray, "N 2"], edge: int) -> Num[np.ndarray, "N 2"]:
        """Picture pixels of pixels of an upright crop of ``edge`` pixels."""
        affine = self.crop_from_picture(edge)
        return (pixels - affine[:, 2]) @ np.linalg.inv(affine[:, :2]).T


def region_of_body(joints: Mapping[str, Num[np.ndarray, " 2"]], wh: tuple[int, int]) -> Region | None:
    """The region of a person whose ``joints`` (name → pixels, NaN unknown) are known from elsewhere; None where too few
    are inside the picture, or hips or shoulders are unknown."""
    at = {name: pixels for name, pixels in joints.items() if np.isfinite(pixels).all()}
    if not {"left_hip", "right_hip", "left_shoulder", "right_shoulder"} <= set(at):
        return None
    points = np.array(list(at.values()))
    if ((points >= 0) & (points < wh)).all(-1).sum() < _MIN_JOINTS:
        return None
    hips, shoulders = (at["left_hip"] + at["right_hip"]) / 2, (at["left_shoulder"] + at["right_shoulder"]) / 2
    up = shoulders - hips
    radius = _CIRCLE * np.linalg.norm(points - hips, axis=1).max()
    return Region.around(hips, hips + up * radius / max(np.linalg.norm(up), 1e-9))


def sample_region(picture: Num[np.ndarray, "H W 3"], region: Region, edge: int) -> Integer[np.ndarray, "edge edge 3"]:
    """Upright crop of a region, black beyond the picture; averaged where it shrinks."""
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
