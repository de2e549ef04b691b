# SPDX-License-Identifier: Apache-2.0
"""Motion in a film: where pictures differ from their usual state; small, fast, blind to people who do not move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.frames import spread_frames
from studiorecon.footage.source import FootageSource
from studiorecon.geometry.statistics import SIGMA_OF_MAD
from studiorecon.progress import warn

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

SMALL_PX = 320
"""Longer side of the pictures that are compared: a wrist of somebody who fills half the picture has 4 pixels."""
# A pixel differs by at least so many noise deviations, and so many of 255 levels (compression noise).
_SIGMAS, _MIN_LEVELS = 6.0, 12.0
# Number of pictures compared with keypoints: a few dozen show where people move.
_PICTURES = 64
# Distance in pixels at which a keypoint no longer counts as on motion; nearer ones count in part. Detectors err by a
# percent.
_REACH_PX = 4.0


@dataclass(frozen=True)
class Motion:
    """Pixels of a film of size ``wh`` that differ from usual in some frames.

    ``near`` is 1 where a picture differs, falling to 0 within a few pixels.
    """

    frame: Integer[np.ndarray, " S"]
    near: Float[np.ndarray, "S h w"]
    wh: tuple[int, int]

    def at(self, sample: Integer[np.ndarray, " N"], pixels: Num[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 2"]:
        """Motion at ``pixels`` of the film (centres at +0.5) in frame ``frame[sample]``, and its mean over all frames.

        Outside of the picture it is 0.
        """
        rows, columns = self.near.shape[1:]
        place = np.floor(pixels * [columns / self.wh[0], rows / self.wh[1]])
        inside = ((place >= 0) & (place < [columns, rows])).all(-1)
        column, row = np.where(inside[:, None], place, 0).astype(np.int64).T
        usual = self.near.mean(0)
        return np.where(inside[:, None], np.column_stack([self.near[sample, row, column], usual[row, column]]), 0.0)

    @property
    def busy(self) -> bool:
        """Whether something about as large as a person differs in half of the frames or more."""
        return bool(np.median((self.near == 1).mean(axis=(1, 2))) > _MIN_BUSY)


# Share of a picture that a person covers whose height is a tenth of the picture's.
_MIN_BUSY = 0.001


def shrink_picture(picture: Integer[np.ndarray, "H W 3"]) -> Integer[np.ndarray, "h w 3"]:
    """A picture with a longer side of at most ``SMALL_PX``."""
    scale = SMALL_PX / max(picture.shape[:2])
    size = max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale))
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA) if scale < 1 else picture


def measure_motion(
    frame: Sequence[int], pictures: Sequence[Integer[np.ndarray, "h w 3"]], wh: tuple[int, int]
) -> Motion:
    """Motion in ``pictures`` (``shrink_picture``) of the frames ``frame`` of a film of size ``wh``."""
    apart, noise = differences_from_usual(pictures)
    differs = (apart > max(_SIGMAS * noise, _MIN_LEVELS)).astype(np.uint8)
    near = [
        np.clip(1 - cv2.distanceTransform(1 - cv2.medianBlur(one, 3), cv2.DIST_L2, 3) / _REACH_PX, 0, 1)
        if one.any()
        else np.zeros(one.shape)
        for one in differs
    ]
    return Motion(np.asarray(frame, dtype=np.int64), np.stack(near), wh)


def differences_from_usual(
    pictures: Sequence[Integer[np.ndarray, "h w 3"]],
) -> tuple[Float[np.ndarray, "S h w"], float]:
    """By how many grey levels each pixel differs from the median of ``pictures``, without exposure that follows the
    scene, and the noise's deviation."""
    levels = np.stack([cv2.GaussianBlur(p, (3, 3), 0) for p in pictures]).astype(np.float32)
    apart = levels - np.median(levels, axis=0)
    apart -= np.median(apart, axis=(1, 2), keepdims=True)
    apart = np.abs(apart).max(-1)
    return apart, SIGMA_OF_MAD * float(np.median(apart))


def film_motion(source: FootageSource, first: int, last: int) -> Motion | None:
    """Motion in sampled frames from ``first`` to ``last``; None, with a warning, if the film cannot be read."""
    first, last = min(max(first, 0), source.frames - 1), min(max(last, 0), source.frames - 1)
    wanted = np.unique(np.linspace(first, max(last, first), _PICTURES).round().astype(int)).tolist()
    try:
        pictures = [shrink_picture(picture) for picture in spread_frames(source, wanted)]
    except UserError as refusal:
        warn(f"{refusal}; its keypoints are not compared with it")
        return None
    return measure_motion(wanted[: len(pictures)], pictures, source.wh) if len(pictures) > 2 else None
