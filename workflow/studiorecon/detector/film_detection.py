# SPDX-License-Identifier: Apache-2.0
"""People in stretches of one film, in the film's pixels, however its camera hung."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.detector.blazepose import MASK_PX, Landmarks
from studiorecon.detector.film_rotation import film_from_turned, quarter_turns, rotate_picture
from studiorecon.detector.frame_detection import Detector
from studiorecon.detector.tracking import detect_people, keypoints_with_confidence
from studiorecon.footage.frames import seek_frames, spread_frames
from studiorecon.footage.source import FootageSource
from studiorecon.keypoints.motion import differences_from_usual, shrink_picture

if TYPE_CHECKING:
    from jaxtyping import Integer

# Pictures of a film that are compared, and those of them, where most moves, that show which way is up.
_COMPARED, _SHOW_UP = 25, 3


@dataclass(frozen=True)
class FilmDetector:
    """The networks for one film.

    Attributes:
        worth: maps visibility to confidence.
        turns: counter-clockwise quarter turns with which people are upright.
        seen: frame → the people in it, who are not looked for again.
    """

    network: Detector
    worth: dict[str, list[float]]
    footage: FootageSource
    turns: int
    seen: Mapping[int, list[Landmarks]] = field(default_factory=dict)

    def turned(self, looked: Sequence[tuple[int, int]]) -> FilmDetector:
        """The same, with the turns of people in the stretches ``looked`` (first frame, count) at."""
        frames = sorted({frame for first, count in looked for frame in range(first, first + count)})
        footage = self.footage
        moments = sorted({frames[round(k * (len(frames) - 1) / (_COMPARED - 1))] for k in range(_COMPARED)})
        apart, noise = differences_from_usual([shrink_picture(p) for p in spread_frames(footage, moments)])
        most = sorted(np.argsort(-apart.mean((1, 2)), kind="stable")[:_SHOW_UP].tolist())
        shown, compared = [moments[k] for k in most], apart[most] if len(moments) > 2 else np.full_like(apart, np.nan)
        turns, seen = quarter_turns(self.network, seek_frames(footage, shown), list(compared), noise)
        return replace(self, turns=turns, seen=dict(zip(shown, seen)))

    def rows(self, pictures: Iterable[Integer[np.ndarray, "H W 3"]], begin: int) -> list[tuple]:
        """The people in successive pictures from frame ``begin`` on, as rows of ``RawDetections.of``."""
        footage, turns = self.footage, self.turns
        linear, offset = np.split(film_from_turned(footage.wh, turns), [2], axis=1)
        width, height = footage.wh
        wh = (height, width) if turns % 2 else (width, height)
        upright = (rotate_picture(picture, turns) for picture in pictures)
        rows = []
        for frame, seen in enumerate(detect_people(upright, self.network, footage.fps, self.seen.get(begin)), begin):
            for person in seen:
                keypoints = keypoints_with_confidence(person, wh, self.worth)
                keypoints[:, :2] = keypoints[:, :2] @ linear.T + offset[:, 0]
                points_m = np.column_stack([person.points_m[:, :2] @ linear.T, person.points_m[:, 2]])
                affine = person.region.crop_from_picture(MASK_PX)
                shift = affine[:, 2] - affine[:, :2] @ linear.T @ offset[:, 0]
                affine = np.column_stack([affine[:, :2] @ linear.T, shift])
                rows.append((frame, keypoints, person.presence, points_m, person.mask, affine))
        return rows
