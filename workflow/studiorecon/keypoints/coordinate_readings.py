# SPDX-License-Identifier: Apache-2.0
"""Possible meanings of a recorded keypoint's numbers: pixels or shares of the film or another picture, mirrored,
turned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Num

# Usual heights of pictures from cameras and programs, and sides of networks' square inputs.
_HEIGHTS = (90, 120, 144, 180, 216, 240, 270, 288, 320, 360, 432, 480, 540, 576, 640, 720, 768, 800, 900, 960, 1024,
            1080, 1200, 1440, 1536, 1600, 1920, 2160, 2880, 4320)  # fmt: skip
# Usual factors between a film and the copy of it that a detector was given.
_FACTORS = (1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 4, 4 / 3, 3 / 2, 2, 3, 4)
_SQUARES = (192, 224, 256, 288, 320, 368, 384, 416, 480, 512, 608, 640, 736, 768, 960, 1024, 1280)
# Sizes within this factor of the film's are a detector's rounding to whole blocks, or letterboxes of a few rows.
_SAME_SIZE = 1.1


@dataclass(frozen=True)
class Reading:
    """One meaning of recorded coordinates.

    Attributes:
        words: what the keypoints are, after "the keypoints of camera X are …".
        film_from_recorded: affine map to pixels of the film, centres at +0.5.
        lossless: whether this reading leaves no doubt about left and right.
        unit: whether it is about the unit or size of the picture.
    """

    words: str
    film_from_recorded: Float[np.ndarray, "2 3"]
    lossless: bool
    unit: bool = False


def affine(scale_x: float, scale_y: float, x: float = 0.0, y: float = 0.0) -> Float[np.ndarray, "2 3"]:
    """Map (scale_x · x + x, scale_y · y + y)."""
    return np.array([[scale_x, 0, x], [0, scale_y, y]], dtype=np.float64)


def share_readings(wh: tuple[int, int], centre: float) -> list[Reading]:
    """Readings as shares of the picture's sides; ``centre`` is added to pixels to reach centres at +0.5."""
    w, h = wh
    longer = max(wh)
    return [
        Reading("shares of the picture, 0 to 1", affine(w, h, centre, centre), True, True),
        Reading("shares of the picture, -1 to 1", affine(w / 2, h / 2, w / 2 + centre, h / 2 + centre), True, True),
        Reading("shares of the picture's longer side", affine(longer, longer, centre, centre), True, True),
    ]


def size_readings(wh: tuple[int, int], centre: float, stored_wh: tuple[int, int] | None = None) -> list[Reading]:
    """Readings in pixels of the same picture at other sizes, stretched or letterboxed, or of ``stored_wh``.

    ``centre`` is added to reach pixel centres at +0.5.
    """
    w, h = wh
    found = []
    if stored_wh not in (None, wh):
        assert stored_wh is not None
        sx, sy = w / stored_wh[0], h / stored_wh[1]
        words = f"in pixels of the picture as it is stored, {stored_wh[0]}×{stored_wh[1]}, which are not square"
        found.append(Reading(words, affine(sx, sy, sx * centre, sy * centre), True, True))
    for height in sorted({*_HEIGHTS, *(round(h * factor) for factor in _FACTORS)}):
        scale = h / height
        if max(scale, 1 / scale) > _SAME_SIZE:
            words = f"in pixels of a {round(w / scale)}×{height} picture"
            found.append(Reading(words, affine(scale, scale, scale * centre, scale * centre), True, True))
    for side in _SQUARES:
        fit = max(w, h) / side
        sx, sy = w / side, h / side
        stretched = affine(sx, sy, sx * centre, sy * centre)
        found.append(Reading(f"in pixels of a picture stretched to {side}×{side}", stretched, True, True))
        x, y = w / 2 + fit * (centre - side / 2), h / 2 + fit * (centre - side / 2)
        found.append(
            Reading(f"in pixels of a picture letterboxed to {side}×{side}", affine(fit, fit, x, y), True, True)
        )
    return found


def turned_readings(
    wh: tuple[int, int], unit: Float[np.ndarray, "2 3"], exchanged: Float[np.ndarray, "2 3"]
) -> list[Reading]:
    """Readings of the picture mirrored, turned or with exchanged coordinates.

    ``unit`` maps recorded numbers to pixels of the film, ``exchanged`` to those of the film turned by 90°.
    """
    w, h = wh
    after = {
        "mirrored, left for right": [[-1, 0, w], [0, 1, 0]],
        "upside down, counted from the bottom": [[1, 0, 0], [0, -1, h]],
        "of the picture turned by 180°": [[-1, 0, w], [0, -1, h]],
    }
    on_its_side = {
        "of the picture turned by 90° to the right": [[0, 1, 0], [-1, 0, h]],
        "of the picture turned by 90° to the left": [[0, -1, w], [1, 0, 0]],
    }
    swapped = unit @ np.array([[0, 1, 0], [1, 0, 0], [0, 0, 1.0]])
    found = [Reading(words, _then(unit, np.array(change, float)), False) for words, change in after.items()]
    found.append(Reading("in the order y, x", swapped, False))
    found += [Reading(words, _then(exchanged, np.array(change, float)), False) for words, change in on_its_side.items()]
    return found


def apply_reading(reading: Num[np.ndarray, "2 3"], points: Num[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2"]:
    """``points`` mapped to pixels of the film."""
    return points @ reading[:, :2].T + reading[:, 2]


def _then(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return second @ np.vstack([first, [0, 0, 1.0]])


def convert_keypoints(
    keypoints: Num[np.ndarray, "D K 3"], reading: Reading, usual: Reading
) -> Num[np.ndarray, "D K 3"]:
    """The keypoints as they should have been written, for ``usual`` to give the pixels that ``reading`` gives."""
    if reading is usual:
        return keypoints
    inverse = np.linalg.inv(np.vstack([usual.film_from_recorded, [0, 0, 1.0]]))[:2]
    missing = (keypoints[..., :2] == 0).all(-1) | ~(keypoints[..., 2] > 0)
    points = apply_reading(inverse, apply_reading(reading.film_from_recorded, keypoints[..., :2]))
    points = np.where(missing[..., None], keypoints[..., :2], points)
    return np.concatenate([points, keypoints[..., 2:]], axis=-1)
