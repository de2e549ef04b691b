# SPDX-License-Identifier: Apache-2.0
"""Where in a picture people are looked for: overlapping squares of several sizes, and squares about what is not usually
there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.detector.crops import Region
from studiorecon.images.channels import channel_max

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# Edges of the windows as shares of the picture's longer side, and how far each moves, as a share of its own edge.
_SCALES = ((1.0, 1.0), (0.6, 0.5), (0.35, 0.5))
# Larger pictures show smaller people: one more scale, as long as its windows are larger than this, pixels.
_FINER, _FINER_PX = (0.2, 0.5), 600
# What differs from the usual picture: size it is compared at, grey levels, least and most of the picture, how many
# places.
GLANCE_PX = 320
_DIFFERENCE = 24
_MIN_SHARE = 0.0015
_PLACES = 6
_MARGIN = 1.5
# So many joints of a known body must be inside the picture, and how far the circle around it reaches beyond them.
_MIN_JOINTS = 8
_CIRCLE = 1.15


def grid(wh: tuple[int, int]) -> list[tuple[Num[np.ndarray, " 2"], float]]:
    """(corner, side) of windows that cover a picture, largest first; a window may reach beyond the shorter side."""
    longer = max(wh)
    scales = [*_SCALES, _FINER] if _FINER[0] * longer >= _FINER_PX else _SCALES
    windows = []
    for share, step in scales:
        side = share * longer
        windows += [(np.array([x, y]), side) for y in _places(wh[1], side, step) for x in _places(wh[0], side, step)]
    return windows


def _places(length: float, side: float, step: float) -> np.ndarray:
    """Where windows of one size begin along an axis; one in the middle when it is the longer one."""
    if side >= length:
        return np.array([(length - side) / 2])
    return np.linspace(0.0, length - side, int(np.ceil((length - side) / (side * step))) + 1)


def small(picture: Integer[np.ndarray, "H W 3"]) -> Integer[np.ndarray, "h w 3"]:
    """The picture at ``GLANCE_PX`` along its longer side, blurred so that noise and edges that tremble do not
    differ."""
    height, width = picture.shape[:2]
    shrink = min(1.0, GLANCE_PX / max(height, width))
    size = max(1, round(width * shrink)), max(1, round(height * shrink))
    return cv2.GaussianBlur(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), (0, 0), 1.0)


def usual(pictures: list[Integer[np.ndarray, "h w 3"]]) -> Integer[np.ndarray, "h w 3"]:
    """What a camera mostly sees: the median of its ``small`` pictures over time."""
    return np.median(np.stack(pictures), axis=0).astype(np.uint8)


def changed(
    picture: Integer[np.ndarray, "H W 3"], background: Integer[np.ndarray, "h w 3"]
) -> list[tuple[Num[np.ndarray, " 2"], float]]:
    """(corner, side) in pixels of ``picture`` of squares about the largest places where it differs from ``background``
    (``usual``)."""
    glance = small(picture)
    scale = picture.shape[1] / glance.shape[1]
    differs = (channel_max(np.abs(glance.astype(np.int16) - background)) > _DIFFERENCE).astype(np.uint8)
    closed = cv2.morphologyEx(differs, cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    _, _, boxes, _ = cv2.connectedComponentsWithStats(closed)
    large = [box for box in boxes[1:] if box[cv2.CC_STAT_AREA] >= _MIN_SHARE * closed.size]
    windows = []
    for x, y, w, h, _ in sorted(large, key=lambda box: -box[cv2.CC_STAT_AREA])[:_PLACES]:
        side = max(_MARGIN * max(w, h), 0.1 * GLANCE_PX) * scale
        windows.append((np.array([x + w / 2, y + h / 2]) * scale - side / 2, side))
    return windows


def region_of_body(joints: Mapping[str, Num[np.ndarray, " 2"]], wh: tuple[int, int]) -> Region | None:
    """Where to look for somebody whose ``joints`` (name → (2,) pixels, NaN unknown) are known from elsewhere; None
    where too few are inside the picture, or hips or shoulders are unknown."""
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
