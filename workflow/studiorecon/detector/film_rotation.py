# SPDX-License-Identifier: Apache-2.0
"""How a film's pictures are upright, where a camera hangs sideways or upside down.

The networks are trained on upright people. They get turned pictures, and their results are turned back:
films, calibrations and all other steps keep the pixels as they are stored.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.detector.blazepose import Landmarks
from studiorecon.detector.frame_detection import Detector, landmark_confidence

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# Half a quarter turn: a body nearer to upright than to lying.
_UPRIGHT_RAD = np.pi / 4
# Trust per picture with which nothing else is tried: a real man and a seated woman have 0.7 to 0.9 upright, and at most
# 0.3 in pictures turned otherwise. Furniture of an empty room, turned, had up to 0.65: trust alone cannot exclude it.
_TRUSTED = 0.5
# Size at which pictures of one film are compared.
_GLANCE_WH = 160, 160
# Another turn must show people so many times as clearly: somebody who bends or lies down turns no picture.
_CLEARER = 2.0


def quarter_turns(
    detector: Detector, pictures: Sequence[Integer[np.ndarray, "H W 3"]]
) -> tuple[int, list[list[Landmarks]]]:
    """(counter-clockwise quarter turns, 0 to 3, with which ``detector`` sees people upright in ``pictures``, who is in
    the first pictures turned so); 0 where no other number is clearly better."""
    seen: list[list[list[Landmarks]]] = [[]]
    for picture in pictures:
        seen[0].append(detector.detect_new_people(picture))
        if _upright(seen[0]) >= _TRUSTED * len(pictures):
            return 0, seen[0]
    shown = [_upright(seen[0])]
    for turns in (1, 2, 3):
        seen.append([detector.detect_new_people(rotate_picture(picture, turns)) for picture in pictures])
        shown.append(_upright(seen[turns]))
    best = int(np.argmax(shown))
    best = best if shown[best] > _CLEARER * shown[0] else 0
    return best, seen[best]


def most_changed_frames(pictures: Iterable[Integer[np.ndarray, "H W 3"]], count: int) -> list[int]:
    """Which ``count`` of a film's pictures differ most from the usual one, their median, in order: they show people."""
    small = np.stack([cv2.resize(p, _GLANCE_WH, interpolation=cv2.INTER_AREA).astype(float) for p in pictures])
    differ = np.abs(small - np.median(small, axis=0)).mean((1, 2, 3))
    return sorted(np.argsort(-differ, kind="stable")[:count].tolist())


def rotate_picture(picture: Integer[np.ndarray, "H W 3"], turns: int) -> Integer[np.ndarray, "h w 3"]:
    """The picture turned counter-clockwise by so many quarters."""
    return np.ascontiguousarray(np.rot90(picture, turns)) if turns else picture


def film_from_turned(wh: tuple[int, int], turns: int) -> Float[np.ndarray, "2 3"]:
    """(2, 3) map of pixels of a ``rotate_picture`` picture to those of the film of ``wh``, centres at +0.5 on both
    sides."""
    angle = turns * np.pi / 2
    c, s = round(np.cos(angle)), round(np.sin(angle))
    linear = np.array([[c, -s], [s, c]], dtype=np.float64)
    middle = np.array(wh, dtype=np.float64) / 2
    return np.column_stack([linear, middle - linear @ (middle[::-1] if turns % 2 else middle)])


def _upright(seen: Sequence[Sequence[Landmarks]]) -> float:
    """How clearly people are seen upright in all pictures, summed."""
    people = [one for picture in seen for one in picture]
    return sum(landmark_confidence(one) for one in people if abs(one.next_region.turn_rad) < _UPRIGHT_RAD)
