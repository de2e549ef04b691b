# SPDX-License-Identifier: Apache-2.0
"""Who is in one picture: found in windows over it, each skeleton once.

``detect_new_people`` is for films, where whoever is missed is found half a second later. ``detect_exhaustively`` is for
pictures that have no neighbours: fainter candidates, windows that are turned for people who bend down, and the surest
of several looks.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.detector.blazepose import LANDMARKS, PRESENT, BlazePose, Landmarks
from studiorecon.detector.crops import Region
from studiorecon.detector.windows import grid
from studiorecon.keypoints.tracking import distance_shares

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# How sure the detector must be of somebody.
_CANDIDATE = 0.5
# Two squares that overlap more than this (intersection over union) hold one person until landmarks say otherwise.
_SAME_SQUARE = 0.5
# Two skeletons of one picture nearer than this (median distance, share of the smaller one's diagonal) are one person.
_SAME_BODY = 0.1
# Regions smaller than this hold nobody whose limbs could be told, pixels; larger than this times the picture neither.
_SMALLEST_PX, _LARGEST = 24, 4.0
# Where a picture has no neighbours: how sure the detector must be, how windows are turned, how often a region is looked
# at, and how sure all that is said of somebody must be together.
_FAINT, _TURNS_RAD, _LOOKS, _SURE = 0.3, (0.0, np.pi / 4, -np.pi / 4), 3, 0.3
# Regions whose middles are this near (share of the side), whose sides differ by this factor and turns by this angle are
# one candidate.
_NEAR, _FACTOR, _TURN_RAD = 0.15, 1.35, 0.7
# A landmark of this visibility should lie under the network's own mask.
_VISIBLE = 0.3


def overlap(first: Region, second: Region) -> float:
    """Intersection over union of two regions as upright squares."""
    low = np.maximum(first.centre - first.side / 2, second.centre - second.side / 2)
    high = np.minimum(first.centre + first.side / 2, second.centre + second.side / 2)
    shared = float(np.prod(np.maximum(high - low, 0.0)))
    return shared / (first.side**2 + second.side**2 - shared)


def drop_overlapping(found: Iterable[Landmarks]) -> list[Landmarks]:
    """Without those who lie on somebody surer: one person found twice, or a skeleton that jumped to another person."""
    return drop_duplicates(sorted(found, key=lambda f: -f.presence * f.keypoints[:, 2].sum()))


def drop_duplicates(ordered: Iterable[Landmarks]) -> list[Landmarks]:
    """Without those who lie on somebody before them."""
    kept: list[Landmarks] = []
    for one in ordered:
        others = np.array([k.keypoints for k in kept]).reshape(-1, LANDMARKS, 3)
        if not (distance_shares(one.keypoints[None], others) < _SAME_BODY).any():
            kept.append(one)
    return kept


def is_plausible_region(region: Region, picture: Integer[np.ndarray, "H W 3"]) -> bool:
    """Whether a region is of a size that can hold somebody, and touches the picture."""
    height, width = picture.shape[:2]
    reach = region.side / 2
    inside = (region.centre > -reach).all() and region.centre[0] < width + reach and region.centre[1] < height + reach
    return bool(
        np.isfinite(region.centre).all() and inside and _SMALLEST_PX <= region.side <= _LARGEST * max(width, height)
    )


def detect_in_region(network: BlazePose, picture: Integer[np.ndarray, "H W 3"], region: Region) -> Landmarks | None:
    """Who is in ``region``; None when nobody is, or the region is none."""
    if not is_plausible_region(region, picture):
        return None
    seen = network.look(picture, region)
    return seen if seen.presence >= PRESENT and is_plausible_region(seen.next_region, picture) else None


def detect_new_people(
    network: BlazePose,
    picture: Integer[np.ndarray, "H W 3"],
    windows: Sequence[tuple[Num[np.ndarray, " 2"], float]],
    known: Sequence[Landmarks],
) -> list[Landmarks]:
    """Who is in ``windows`` of the picture beside those already ``known`` in it."""
    candidates = [c for corner, side in windows for c in network.detect(picture, corner, side, _CANDIDATE)]
    taken = [k.region for k in known]
    found: list[Landmarks] = []
    for _, region in sorted(candidates, key=lambda c: -c[0]):
        if any(overlap(region, other) > _SAME_SQUARE for other in taken):
            continue
        first = detect_in_region(network, picture, region)
        # The detector's circle is rough; the landmarks' own is what they are best in.
        seen = detect_in_region(network, picture, first.next_region) if first else None
        if seen is not None:
            found.append(seen)
            taken += [region, seen.region]
    everybody = drop_overlapping([*known, *found])
    return [f for f in found if any(f is e for e in everybody)]


def detect_exhaustively(network: BlazePose, picture: Integer[np.ndarray, "H W 3"]) -> list[Landmarks]:
    """Who is in a picture that has no neighbours; 25 s of a core for a 4K one."""
    wh = picture.shape[1], picture.shape[0]
    candidates = [
        candidate
        for corner, side in grid(wh)
        for turn in _TURNS_RAD
        for candidate in network.detect(picture, corner, side, _FAINT, turn)
    ]
    tried: list[Region] = []
    rated: list[tuple[float, Landmarks]] = []
    for score, region in sorted(candidates, key=lambda c: -c[0]):
        if any(_one_candidate(region, other) for other in tried):
            continue
        tried.append(region)
        looks: list[Landmarks] = []
        while len(looks) < _LOOKS and (seen := detect_in_region(network, picture, region)) is not None:
            looks.append(seen)
            region = seen.next_region
        if looks:
            best = max(looks, key=landmark_confidence)
            rated.append((score * landmark_confidence(best), best))
    ordered = sorted(rated, key=lambda one: -one[0])
    return drop_duplicates(seen for surety, seen in ordered if surety >= _SURE)


def _one_candidate(first: Region, second: Region) -> bool:
    turned = abs((first.turn_rad - second.turn_rad + np.pi) % (2 * np.pi) - np.pi)
    factor = max(first.side, second.side) / min(first.side, second.side)
    near = np.linalg.norm(first.centre - second.centre) < _NEAR * second.side
    return bool(near and factor < _FACTOR and turned < _TURN_RAD)


def landmark_confidence(seen: Landmarks) -> float:
    """How sure the landmark network is: presence, visibility, and the share of visible landmarks under its mask."""
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
