# SPDX-License-Identifier: Apache-2.0
"""People in one picture: MoveNet finds them, BlazePose places each one once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.detector.blazepose import LANDMARKS, LAYOUT, PRESENT, BlazePose, Landmarks
from studiorecon.detector.crops import Region, region_of_body
from studiorecon.detector.movenet import MoveNet, Sighting, shrink_to
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.keypoints.tracking import distance_shares

if TYPE_CHECKING:
    from jaxtyping import Integer

# Longer sides at which every picture is searched, pixels: the first for people who fill it, the second for the others.
_SEARCHED_PX = (320, 640)
# The same of a close look: people of 40 pixels are found at this size, and at twice the size it would take 1.5 s.
_CLOSE_PX = 1280
# Larger people (share of the longer side) need no close look: at that size it sees parts of them as people.
_SMALL_SHARE = 0.125
# Least score of a sighting, of 1: low, because BlazePose accepts or rejects the region after it.
_MIN_SCORE = 0.1
# The same of a close look, where BlazePose, which sees few pixels, cannot: people of 40 to 60 pixels score 0.18 to 0.41
# there, and bags, signs and lamps 0.12 to 0.18, rarely 0.26.
_MIN_CLOSE_SCORE = 0.2
# A sighting nearer than this to a person (median distance, share of the smaller one's diagonal) is that person.
_SAME_SIGHTING = 0.2
# Two skeletons of one picture nearer than this are one person.
_SAME_BODY = 0.1
# Bounds of a region with a person: in a smaller one (pixels) limbs cannot be resolved; the larger one is in pictures.
_SMALLEST_PX, _LARGEST = 24, 4.0
# A landmark of this visibility should lie under the network's own mask.
_VISIBLE = 0.3
_NAMES = LAYOUTS["coco17"].keypoints
_SHARED = [LAYOUTS[LAYOUT].keypoints.index(name) for name in _NAMES]


@dataclass(frozen=True)
class Detector:
    """The two networks: ``finder`` detects the people in a picture, ``placer`` their landmarks."""

    finder: MoveNet
    placer: BlazePose

    def detect_new_people(
        self, picture: Integer[np.ndarray, "H W 3"], known: Sequence[Landmarks] = (), closely: bool = False
    ) -> list[Landmarks]:
        """Landmarks of the people in the picture (RGB) who are not ``known`` yet; ``closely`` searches only for small
        ones, and takes up to ten times as long."""
        wh = picture.shape[1], picture.shape[0]
        edges, least = ([_CLOSE_PX], _MIN_CLOSE_SCORE) if closely else (_SEARCHED_PX, _MIN_SCORE)
        sightings = [one for edge in edges for one in self.finder.find(picture, edge, least)]
        if closely:
            sightings = [s for s in sightings if np.ptp(s.keypoints[:, :2], axis=0).max() < _SMALL_SHARE * max(wh)]
        taken = [k.keypoints[_SHARED] for k in known]
        found: list[Landmarks] = []
        for one in sorted(sightings, key=lambda s: -s.score):
            if _is_one_of(one, taken):
                continue
            taken.append(one.keypoints)
            region = region_of_body(dict(zip(_NAMES, one.keypoints[:, :2])), wh)
            first = detect_in_region(self.placer, picture, region) if region else None
            # The finder's region is rough; the landmarks' own is what they are best in.
            seen = detect_in_region(self.placer, picture, first.next_region) if first else None
            if seen is not None:
                found.append(seen)
                taken.append(seen.keypoints[_SHARED])
        everybody = drop_overlapping([*known, *found])
        return [f for f in found if any(f is e for e in everybody)]

    def surest(self, picture: Integer[np.ndarray, "H W 3"]) -> list[float]:
        """Score of the surest person whom the finder sees at a glance in the picture turned counter-clockwise by 0, 1,
        2 and 3 quarters; 0 without one."""
        small, glance_px = shrink_to(picture, _SEARCHED_PX[0]), _SEARCHED_PX[0]
        seen = [self.finder.find(np.ascontiguousarray(np.rot90(small, k)), glance_px, _MIN_SCORE) for k in range(4)]
        return [max((one.score for one in own), default=0.0) for own in seen]


def _is_one_of(sighting: Sighting, people: Sequence[np.ndarray]) -> bool:
    """Whether a sighting is of one of ``people`` (17 points each)."""
    others = np.array(people).reshape(-1, len(_SHARED), 3)
    return bool((distance_shares(sighting.keypoints[None], others) < _SAME_SIGHTING).any())


def drop_overlapping(found: Iterable[Landmarks]) -> list[Landmarks]:
    """The people without those who overlap a more confident one: duplicates, and skeletons that jumped to another
    person."""
    kept: list[Landmarks] = []
    for one in sorted(found, key=lambda f: -f.presence * f.keypoints[:, 2].sum()):
        others = np.array([k.keypoints for k in kept]).reshape(-1, LANDMARKS, 3)
        if not (distance_shares(one.keypoints[None], others) < _SAME_BODY).any():
            kept.append(one)
    return kept


def is_plausible_region(region: Region, picture: Integer[np.ndarray, "H W 3"]) -> bool:
    """Whether a region has a size that can hold a person, and overlaps the picture."""
    height, width = picture.shape[:2]
    reach = region.side / 2
    inside = (region.centre > -reach).all() and region.centre[0] < width + reach and region.centre[1] < height + reach
    return bool(
        np.isfinite(region.centre).all() and inside and _SMALLEST_PX <= region.side <= _LARGEST * max(width, height)
    )


def detect_in_region(network: BlazePose, picture: Integer[np.ndarray, "H W 3"], region: Region) -> Landmarks | None:
    """Landmarks of the person in ``region``; None without one, or for an implausible region."""
    if not is_plausible_region(region, picture):
        return None
    seen = network.look(picture, region)
    return seen if seen.presence >= PRESENT and is_plausible_region(seen.next_region, picture) else None


def landmark_confidence(seen: Landmarks) -> float:
    """Confidence of landmarks: presence, visibility, and the share of visible landmarks under the network's mask."""
    visible = seen.keypoints[seen.keypoints[:, 2] > _VISIBLE, :2]
    if not len(visible):
        return 0.0
    edge = seen.mask.shape[0]
    affine = seen.region.crop_from_picture(edge)
    columns, rows = np.floor(visible @ affine[:, :2].T + affine[:, 2]).astype(int).T
    inside = (columns >= 0) & (rows >= 0) & (columns < edge) & (rows < edge)
    covered = np.zeros(len(visible))
    covered[inside] = seen.mask[rows[inside], columns[inside]] > 127
    return float(seen.presence * seen.keypoints[:, 2].mean() * covered.mean())
