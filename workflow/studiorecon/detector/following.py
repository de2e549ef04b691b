# SPDX-License-Identifier: Apache-2.0
"""People found and followed through the pictures of one camera.

Every ``_LOOK_S`` people are looked for in windows over the picture and about what differs from the usual picture. Who
is found is followed through the pictures after that, and back through those since the look before, by the landmarks
themselves: they say where the body will be looked at next, so that most pictures cost one run of the landmark network
per person.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from studiorecon.detector.blazepose import LANDMARKS, PRESENT, BlazePose, Landmarks
from studiorecon.detector.crops import Region
from studiorecon.detector.windows import changed, grid
from studiorecon.keypoints.tracking import distance_shares

# Time between two looks at the whole picture.
_LOOK_S = 0.5
# Pictures held between two looks, bytes: 4K at 60 per second is looked at more often.
_HELD_BYTES = 400e6
# How sure the detector must be of somebody.
_CANDIDATE = 0.5
# Two squares that overlap more than this (intersection over union) hold one person until landmarks say otherwise.
_SAME_SQUARE = 0.5
# Two skeletons of one picture nearer than this (median distance, share of the smaller one's diagonal) are one person.
_SAME_BODY = 0.1
# Regions smaller than this hold nobody whose limbs could be told, pixels; larger than this times the picture neither.
_SMALLEST_PX, _LARGEST = 24, 4.0
# Of its last step, how much of it a body is expected to make again.
_KEPT_STEP = 0.7


@dataclass(frozen=True)
class Walker:
    """Somebody who is followed: what was last seen of them, and how far their region moved in that step (2,) pixels."""

    seen: Landmarks
    step: np.ndarray

    def region(self) -> Region:
        """Where to look in the next picture."""
        following = self.seen.next_region
        return replace(following, centre=following.centre + _KEPT_STEP * self.step)


def overlap(first: Region, second: Region) -> float:
    """Intersection over union of two regions as upright squares."""
    low = np.maximum(first.centre - first.side / 2, second.centre - second.side / 2)
    high = np.minimum(first.centre + first.side / 2, second.centre + second.side / 2)
    shared = float(np.prod(np.maximum(high - low, 0.0)))
    return shared / (first.side**2 + second.side**2 - shared)


def unlike(found: Iterable[Landmarks]) -> list[Landmarks]:
    """Without those who lie on somebody surer: one person found twice, or a skeleton that jumped to another person."""
    kept: list[Landmarks] = []
    for one in sorted(found, key=lambda f: -f.presence * f.keypoints[:, 2].sum()):
        others = np.array([k.keypoints for k in kept]).reshape(-1, LANDMARKS, 3)
        if not (distance_shares(one.keypoints[None], others) < _SAME_BODY).any():
            kept.append(one)
    return kept


def sensible(region: Region, picture: np.ndarray) -> bool:
    """Whether a region is of a size that can hold somebody, and touches the picture."""
    height, width = picture.shape[:2]
    reach = region.side / 2
    inside = (region.centre > -reach).all() and region.centre[0] < width + reach and region.centre[1] < height + reach
    return bool(
        np.isfinite(region.centre).all() and inside and _SMALLEST_PX <= region.side <= _LARGEST * max(width, height)
    )


def look_again(network: BlazePose, picture: np.ndarray, region: Region) -> Landmarks | None:
    """Who is in ``region``; None when nobody is, or the region is none."""
    if not sensible(region, picture):
        return None
    seen = network.look(picture, region)
    return seen if seen.presence >= PRESENT and sensible(seen.next_region, picture) else None


def newcomers(
    network: BlazePose, picture: np.ndarray, windows: Sequence[tuple[np.ndarray, float]], known: Sequence[Landmarks]
) -> list[Landmarks]:
    """Who is in ``windows`` of the picture beside those already ``known`` in it."""
    candidates = [c for corner, side in windows for c in network.detect(picture, corner, side, _CANDIDATE)]
    taken = [k.region for k in known]
    found: list[Landmarks] = []
    for _, region in sorted(candidates, key=lambda c: -c[0]):
        if any(overlap(region, other) > _SAME_SQUARE for other in taken):
            continue
        first = look_again(network, picture, region)
        # The detector's circle is rough; the landmarks' own is what they are best in.
        seen = look_again(network, picture, first.next_region) if first else None
        if seen is not None:
            found.append(seen)
            taken += [region, seen.region]
    everybody = unlike([*known, *found])
    return [f for f in found if any(f is e for e in everybody)]


def follow(network: BlazePose, picture: np.ndarray, walkers: Sequence[Walker]) -> list[Walker]:
    """Those of ``walkers`` who are found again in the next picture (or the one before)."""
    pairs = [(w, seen) for w in walkers if (seen := look_again(network, picture, w.region())) is not None]
    kept = unlike([seen for _, seen in pairs])
    return [
        Walker(seen, seen.next_region.centre - walker.seen.next_region.centre)
        for walker, seen in pairs
        if any(seen is k for k in kept)
    ]


def people_in(
    pictures: Iterable[np.ndarray], network: BlazePose, background: np.ndarray | None, fps: float
) -> Iterator[list[Landmarks]]:
    """Everybody in each of the pictures, in order; ``background`` is the usual picture, if there is one."""
    walkers: list[Walker] = []
    held: list[np.ndarray] = []
    results: list[list[Landmarks]] = []
    for number, picture in enumerate(pictures):
        every = max(1, min(round(_LOOK_S * fps), int(_HELD_BYTES / picture.nbytes)))
        walkers = follow(network, picture, walkers)
        results.append([w.seen for w in walkers])
        held.append(picture)
        if number and len(held) < every:
            continue
        windows = grid((picture.shape[1], picture.shape[0])) + (
            changed(picture, background) if background is not None else []
        )
        found = [Walker(seen, np.zeros(2)) for seen in newcomers(network, picture, windows, results[-1])]
        walkers += found
        results[-1] = [w.seen for w in walkers]
        for back in range(2, len(held) + 1):
            found = follow(network, held[-back], found)
            # Whoever runs into somebody known has been followed already.
            known = results[-back]
            everybody = unlike([*known, *(w.seen for w in found)])
            found = [w for w in found if any(w.seen is e for e in everybody)]
            results[-back] = known + [w.seen for w in found]
        # The last picture is looked at again: whoever is found next time goes back to it.
        yield from results[:-1]
        held, results = [picture], [results[-1]]
    yield from results


def believed(seen: Landmarks, wh: tuple[int, int], worth: dict[str, list[float]]) -> np.ndarray:
    """Keypoints (K, 3) of somebody in a picture of ``wh`` pixels, with confidence; those outside the picture are
    missing.

    BlazePose's visibility becomes the confidence that ``worth`` gives it; a better network's score is one already.
    """
    sure = np.interp(seen.keypoints[:, 2], worth["visibility"], worth["confidence"])
    keypoints = np.column_stack([seen.keypoints[:, :2], sure])
    if seen.better is not None:
        known = np.isfinite(seen.better).all(1)
        keypoints[known] = seen.better[known]
    inside = np.all((keypoints[:, :2] >= 0) & (keypoints[:, :2] <= wh), axis=-1)
    return np.column_stack(
        [np.where(inside[:, None], keypoints[:, :2], np.nan), np.where(inside, keypoints[:, 2], 0.0)]
    )
