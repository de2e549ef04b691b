# SPDX-License-Identifier: Apache-2.0
"""Regions of a picture that differ from the clean plate and that no body explains: candidates for objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.footage.video import to_float
from studiorecon.images.difference import plate_difference

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# States of a pixel: the room as on the plate, loose (an object), or unknown (a person, or no plate).
ROOM, LOOSE, UNKNOWN = 0, 1, 2
# Width of the neighbourhood that measures the difference just inside an outline: two pixels each way.
_EDGE_PX = 5
_EDGE_SHARE = 0.3


@dataclass(frozen=True)
class LooseSettings:
    """Thresholds for a pixel to show an object. Differences are in CIELAB units (1 = just visible).

    Attributes:
        difference: a pixel that differs more from the plate is foreground.
        chroma_weight: colour differences count this much more than lightness.
        shadow: darkest shadow, as a share of the unshadowed light; a darkening down to it is no object.
        margin_m: people are this much thicker than their bodies: clothes, hair and the fit's error.
        min_share: regions below this share of the picture are noise.
    """

    difference: float = 10.0
    chroma_weight: float = 1.5
    shadow: float = 0.5
    margin_m: float = 0.05
    min_share: float = 0.0004


@dataclass(frozen=True)
class ResidualRegion:
    """One connected loose region of one picture.

    Attributes:
        view: index of the camera.
        centre_px, area_px: its middle and its pixels.
        outline_px: points between its pixels and neighbouring room pixels: its true outline, where not occluded.
        free: whether room surrounds it: no person next to it, and all of it in the picture.
        corner: column and row of the first pixel of the crop around it, ``rgb``.
        state: of the crop's pixels, with other regions as UNKNOWN.
    """

    view: int
    centre_px: Float[np.ndarray, " 2"]
    area_px: float
    outline_px: Float[np.ndarray, "K 2"]
    free: bool
    corner: tuple[int, int]
    rgb: Integer[np.ndarray, "h w 3"]
    state: Integer[np.ndarray, "h w"]


def shadow_free_difference(
    rgb: Integer[np.ndarray, "H W 3"], plate: Float[np.ndarray, "H W 3"], settings: LooseSettings
) -> Float[np.ndarray, "H W"]:
    """Float32 difference of a picture from the plate in [0, 1], CIELAB units.

    A shadow, one factor of all channels, is removed first.
    """
    picture, empty = cv2.GaussianBlur(to_float(rgb), (3, 3), 0), cv2.GaussianBlur(plate, (3, 3), 0)
    return np.sqrt(plate_difference(picture, empty, chroma_weight=settings.chroma_weight, shadow=settings.shadow)[0])


def typical_difference(
    differences: Sequence[Float[np.ndarray, "H W"]], explained: Sequence[Bool[np.ndarray, "H W"]]
) -> Float[np.ndarray, "H W"]:
    """Float32 difference that a pixel has in most pictures without people; 0 where people always cover it.

    Compression of fine patterns and errors of the plate cause it.
    """
    found = np.sort(np.where(np.stack(explained), np.inf, np.stack(differences)), axis=0)
    middle = np.maximum(np.isfinite(found).sum(axis=0) - 1, 0) // 2
    usual = np.take_along_axis(found, middle[None], axis=0)[0]
    return np.where(np.isfinite(usual), usual, 0).astype(np.float32)


def pixel_states(
    differing: Float[np.ndarray, "H W"],
    usual: Float[np.ndarray, "H W"],
    measured: Bool[np.ndarray, "H W"],
    explained: Bool[np.ndarray, "H W"],
    settings: LooseSettings,
) -> Integer[np.ndarray, "H W"]:
    """State of every pixel of a picture, from its ``shadow_free_difference``.

    ``usual`` is its ``typical_difference``, used up to twice the threshold: more is an object that never moved. The
    plate is ``measured``; ``explained`` is where people are.
    """
    quiet = differing - np.minimum(usual, 2 * settings.difference)
    plain = cv2.medianBlur((quiet > settings.difference).astype(np.uint8), 3)
    # Blur spreads an object's colour a pixel beyond it: its outline is where the difference is half of that just
    # inside.
    square = np.ones((_EDGE_PX, _EDGE_PX), np.uint8)
    loose = (plain & (quiet > _EDGE_SHARE * cv2.dilate(quiet, square))) | cv2.erode(plain, square)
    return np.where(explained | ~measured, np.uint8(UNKNOWN), loose)


def loose_regions(
    rgb: Integer[np.ndarray, "H W 3"], state: Integer[np.ndarray, "H W"], view: int, min_share: float
) -> list[ResidualRegion]:
    """Loose regions of a picture, largest first."""
    loose = cv2.morphologyEx((state == LOOSE).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    _, labels, statistics, centres = cv2.connectedComponentsWithStats(loose, connectivity=8)
    height, width = state.shape
    found = []
    for k in np.argsort(-statistics[1:, cv2.CC_STAT_AREA], kind="stable") + 1:
        left, top, wide, high, area = statistics[k]
        if area < max(min_share * state.size, 9):
            break
        reach = 4 + max(wide, high) // 3
        box = (
            slice(max(top - reach, 0), min(top + high + reach, height)),
            slice(max(left - reach, 0), min(left + wide + reach, width)),
        )
        own = labels[box] == k
        around = np.where(own, np.uint8(LOOSE), np.where(state[box] == LOOSE, np.uint8(UNKNOWN), state[box]))
        # Pixels next to this region that the opening removed are its own, not another's.
        beside = cv2.dilate(own.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        around[beside & (state[box] == LOOSE) & (labels[box] == 0)] = LOOSE
        near = cv2.dilate(own.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        # Specks that the opening removed hide nothing; people and other regions may.
        hidden = (state[box] == UNKNOWN) | ((labels[box] > 0) & ~own)
        inside = left > 1 and top > 1 and left + wide < width - 1 and top + high < height - 1
        corner = (int(box[1].start), int(box[0].start))
        found.append(
            ResidualRegion(
                view,
                centres[k] + 0.5,
                float(area),
                outline_points(around) + corner,
                bool(inside and not (near & hidden).any()),
                corner,
                rgb[box].copy(),
                around,
            )
        )
    return found


def outline_points(state: Integer[np.ndarray, "H W"]) -> Float[np.ndarray, "K 2"]:
    """Middles of the edges between loose pixels and room pixels."""
    points = []
    for axis in (0, 1):
        first = state[:-1] if axis == 0 else state[:, :-1]
        second = state[1:] if axis == 0 else state[:, 1:]
        rows, columns = np.nonzero((first != second) & (first != UNKNOWN) & (second != UNKNOWN))
        offset = (0.5, 1.0) if axis == 0 else (1.0, 0.5)
        points.append(np.stack([columns + offset[0], rows + offset[1]], axis=1))
    return np.concatenate(points)
