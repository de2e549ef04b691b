# SPDX-License-Identifier: Apache-2.0
"""Who may have come back: two people who are never there together and wear the same.

Tracks end where nobody is seen, so who comes back after seconds out of every picture is somebody new. Colours of
clothes are compared camera by camera, so that no camera has to agree with another. It is told and not done: two people
in the same kit would become one body without a word.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.footage.video import read_frame, to_float
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.progress import say
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float

# Places on a body whose clothes are compared: the middle between these keypoints.
_PLACES = (
    ("left_shoulder", "right_shoulder", "left_hip", "right_hip"),
    ("left_shoulder", "left_elbow"),
    ("right_shoulder", "right_elbow"),
    ("left_hip", "left_knee"),
    ("right_hip", "right_knee"),
    ("left_knee", "left_ankle"),
    ("right_knee", "right_ankle"),
)
_SURE = 0.3
# Pictures of a person and camera; half the width of a place, of the trunk's height.
_PICTURES, _PLACE = 8, 0.08
# The same clothes differ by less (CIE 1976 ΔE, the median over places and cameras), and by less than this share of what
# tells people apart who are there together; with fewer places in common nothing is said.
_ALIKE, _CLEARLY, _LEAST_PLACES = 10.0, 0.5, 4


@dataclass(frozen=True)
class Return:
    """``later`` may be ``earlier``, who was last seen in frame ``left`` and seen again in ``back``."""

    earlier: str
    later: str
    left: int
    back: int


def returns(given: Sequence[Detections], whose: Mapping[tuple[str, int], str], videos: Sequence[Path]) -> list[Return]:
    """Who may have come back, in order of their return; ``whose``: (camera, track) → person. Reads pictures only where
    somebody comes after somebody else has gone."""
    seen = _seen(given, whose)
    spans = {person: _span([given[v].frame[rows] for v, rows in own.items()]) for person, own in seen.items()}
    after = [(a, b) for a, b in permutations(spans, 2) if spans[a][1] < spans[b][0]]
    if not after:
        return []
    looks = {person: _look(given, videos, own) for person, own in seen.items()}
    # Who is there together is not the same person.
    together = [pair for pair in combinations(spans, 2) if pair not in after and pair[::-1] not in after]
    two = [_apart(looks[a], looks[b]) for a, b in together]
    limit = min([_ALIKE, *(_CLEARLY * value for value in two if np.isfinite(value))])
    # Everybody comes back as one, and from where they last were.
    found: list[Return] = []
    for a, b in sorted(after, key=lambda pair: (spans[pair[1]][0], -spans[pair[0]][1])):
        taken = any(one.later == b or one.earlier == a for one in found)
        if not taken and _apart(looks[a], looks[b]) < limit:
            found.append(Return(a, b, spans[a][1], spans[b][0]))
    return found


def tell_returned(those: Sequence[Return], fps: float) -> None:
    """Say who may have come back, and what makes one person of the two."""
    for one in those:
        say(
            f"{one.later}, who comes in frame {one.back}, wears what {one.earlier} wore, who left in frame {one.left}, "
            f"{(one.back - one.left) / fps:.1f} s before. If that is one person, write {one.earlier} in place of "
            f"{one.later} in a copy of people/identities.tsv in the dataset folder"
        )


def _seen(given: Sequence[Detections], whose: Mapping[tuple[str, int], str]) -> dict[str, dict[int, np.ndarray]]:
    """Person → view → rows of their detections."""
    seen: dict[str, dict[int, np.ndarray]] = {}
    for v, one in enumerate(given):
        names = np.array([whose.get((one.camera, int(track)), "") for track in one.track], dtype=object)
        for person in sorted({name for name in names if name}):
            seen.setdefault(person, {})[v] = np.flatnonzero(names == person)
    return seen


def _span(frames: Sequence[np.ndarray]) -> tuple[int, int]:
    """First and last of some cameras' frames."""
    every = np.concatenate(frames)
    return int(every.min()), int(every.max())


def _look(
    given: Sequence[Detections], videos: Sequence[Path], seen: Mapping[int, np.ndarray]
) -> dict[int, Float[np.ndarray, "P 3"]]:
    """View → colours (L*a*b*) of the places on a person's body, NaN where none is seen."""
    found = {}
    for v, rows in seen.items():
        middles, radii = _places(given[v], rows)
        whole = np.flatnonzero(np.isfinite(radii))
        chosen = whole[np.unique(np.linspace(0, len(whole) - 1, min(_PICTURES, len(whole))).round().astype(int))]
        looks = [_colours(read_frame(videos[v], int(given[v].frame[rows[k]])), middles[k], radii[k]) for k in chosen]
        if looks:
            stacked = np.stack(looks)
            known = np.isfinite(stacked[..., 0]).any(0)
            found[v] = np.full(stacked.shape[1:], np.nan)
            found[v][known] = np.nanmedian(stacked[:, known], axis=0)
    return found


def _places(given: Detections, rows: np.ndarray) -> tuple[Float[np.ndarray, "D P 2"], Float[np.ndarray, " D"]]:
    """Pixels of the places of some detections, and half their width; NaN where keypoints are missing."""
    layout = LAYOUTS[given.layout]
    points = np.where(given.keypoints[rows, :, 2:] >= _SURE, given.keypoints[rows, :, :2], np.nan)
    at = {name: points[:, layout.index(name)] for place in _PLACES for name in place if name in layout.keypoints}
    nowhere = np.full((len(rows), 2), np.nan)
    middles = np.stack([np.mean([at.get(name, nowhere) for name in place], axis=0) for place in _PLACES], axis=1)
    shoulders, hips = (
        (at.get(f"left_{part}", nowhere) + at.get(f"right_{part}", nowhere)) / 2 for part in ("shoulder", "hip")
    )
    return middles, _PLACE * np.linalg.norm(shoulders - hips, axis=-1)


def _colours(picture: np.ndarray, middles: np.ndarray, radius: float) -> Float[np.ndarray, "P 3"]:
    """L*a*b* of a picture's places, the median over each."""
    reach, (height, width) = max(1, round(radius)), picture.shape[:2]
    found = np.full((len(middles), 3), np.nan)
    for k, middle in enumerate(middles):
        if not np.isfinite(middle).all():
            continue
        x, y = np.floor(middle).astype(int)
        if 0 <= x < width and 0 <= y < height:
            place = picture[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1]
            lab = cv2.cvtColor(np.ascontiguousarray(to_float(place)), cv2.COLOR_RGB2LAB)
            found[k] = np.median(lab.reshape(-1, 3), axis=0)
    return found


def _apart(one: Mapping[int, np.ndarray], other: Mapping[int, np.ndarray]) -> float:
    """How much two people's clothes differ, the median over places and the cameras that saw both; inf where too few
    places tell."""
    differences = np.concatenate(
        [np.zeros(0), *(np.linalg.norm(one[v] - other[v], axis=-1) for v in one.keys() & other)]
    )
    known = differences[np.isfinite(differences)]
    return float(np.median(known)) if len(known) >= _LEAST_PLACES else np.inf
