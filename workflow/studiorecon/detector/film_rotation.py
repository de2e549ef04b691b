# SPDX-License-Identifier: Apache-2.0
"""How a film's pictures are upright, where a camera hangs sideways or upside down.

The networks are trained on upright people. They get turned pictures, and their results are turned back:
films, calibrations and all other steps keep the pixels as they are stored.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.detector.blazepose import Landmarks
from studiorecon.detector.frame_detection import Detector, landmark_confidence

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# Deviation of people's bodies from upright: a man who balances leans by 0.85.
_LEAN_RAD = 0.4
# One camera of twenty hangs otherwise than upright: log odds.
_TURNED_NATS = -3.0
# Mean and deviation of the networks' trust in real people, walking or seated (0.4 to 0.95), and in an empty room's
# furniture (0.2 to 0.65).
_PERSON_TRUST, _FURNITURE_TRUST, _TRUST_SIGMA = 0.75, 0.45, 0.15
# Logarithm of how many times the noise a picture differs from the usual one at landmarks, mean and deviation: of people
# who move, seated ones included (8 to 35 times), and of what does not move (0.3 to 1.1).
_MOVING, _STILL = (2.5, 1.0), (0.0, 0.4)
# One person of ten keeps still in the pictures that are compared; something else moves behind furniture in 3 of 100.
_STILL_PEOPLE, _PASSED_FURNITURE = 0.1, 0.03
# Coding changes pixels by a grey level even where a film has no noise.
_MIN_NOISE_LEVELS = 1.0


def quarter_turns(
    detector: Detector,
    pictures: Sequence[Integer[np.ndarray, "H W 3"]],
    apart: Sequence[Float[np.ndarray, "h w"]],
    noise: float,
) -> tuple[int, list[list[Landmarks]]]:
    """(counter-clockwise quarter turns, 0 to 3, with which ``detector`` most likely sees people upright in
    ``pictures``, who is in the first pictures turned so).

    Turns in which the finder is less sure of anybody than in the pictures as they are cannot be right: it is trained on
    upright people. ``apart``: differences of the pictures from the film's usual one, smaller or not, and the ``noise``
    of these differences; where these are NaN, motion says nothing.
    """
    surest = np.sum([detector.surest(picture) for picture in pictures], axis=0)
    likely = [turns for turns in range(4) if surest[turns] >= surest[0]]
    if likely == [0]:
        return 0, []
    nats = {turns: _TURNED_NATS if turns else 0.0 for turns in likely}
    seen: dict[int, list[list[Landmarks]]] = {turns: [] for turns in likely}
    for turns in likely:
        for picture, differs in zip((rotate_picture(picture, turns) for picture in pictures), apart):
            people = detector.detect_new_people(picture)
            seen[turns].append(people)
            moved = np.rot90(differs, turns) / max(noise, _MIN_NOISE_LEVELS)
            nats[turns] += sum(_upright_nats(one, moved, picture.shape[:2]) for one in people)
    best = max(likely, key=lambda turns: nats[turns])
    return best, seen[best]


def _upright_nats(seen: Landmarks, moved: Float[np.ndarray, "h w"], hw: tuple[int, ...]) -> float:
    """Log evidence of an upright person, at least 0: nobody says nothing about how a camera hangs. ``moved``: multiples
    of the noise by which a picture of height and width ``hw`` differs from the usual one, NaN unknown."""
    trust = (landmark_confidence(seen) - np.array([_PERSON_TRUST, _FURNITURE_TRUST])) / _TRUST_SIGMA
    lean = np.angle(np.exp(1j * seen.next_region.turn_rad)) / _LEAN_RAD
    nats = float(trust[1] ** 2 - trust[0] ** 2 - lean**2) / 2
    size = np.array(moved.shape[::-1])
    place = np.floor(seen.keypoints[:, :2] * size / hw[::-1]).astype(int)
    place = place[((place >= 0) & (place < size)).all(1)]
    multiple = float(moved[place[:, 1], place[:, 0]].mean()) if len(place) else 0.0
    if np.isfinite(multiple):
        times = np.log(max(multiple, 1.0))
        moving, still = (np.exp(-(((times - mean) / sigma) ** 2) / 2) / sigma for mean, sigma in (_MOVING, _STILL))
        person = (1 - _STILL_PEOPLE) * moving + _STILL_PEOPLE * still
        nats += float(np.log(person / (_PASSED_FURNITURE * moving + (1 - _PASSED_FURNITURE) * still)))
    return float(np.logaddexp(nats, 0.0))


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
