# SPDX-License-Identifier: Apache-2.0
"""Finds people in the pictures of one camera and follows them.

Every ``_LOOK_S`` the whole picture is searched. People found there are followed forwards, and backwards to the search
before, by their landmarks, which give the region in the next picture: most pictures cost one run of the landmark
network per person. Above 30 pictures a second, landmarks between are interpolated where the neighbouring pictures show
that this is exact enough.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.detector.blazepose import BlazePose, Landmarks
from studiorecon.detector.crops import Region
from studiorecon.detector.frame_detection import Detector, detect_in_region, drop_overlapping

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# Time between two looks at the whole picture.
_LOOK_S = 0.5
# Time between two close looks, which cost ten times as much, where the last one found nobody.
_CLOSE_LOOK_S = 5.0
# Rate at which people are placed, pictures per second: arms and legs bend slowly enough for the pictures between.
_PLACED_FPS = 30.0
# Largest error of interpolation, share of the person's extent: half of a landmark's own noise.
_EXACT_SHARE = 0.004
# Less visible landmarks do not say how exact it is.
_VISIBLE = 0.5
# Pictures held between two looks, bytes: 4K at 60 per second is looked at more often.
_HELD_BYTES = 400e6
# Time in which a body's speed is forgotten to 1/e. A man on a spot and two who walk, 10 to 60 pictures a second: their
# hips are expected within 0.1 to 2 % of their height, twice as near as without.
_KEPT_S = 0.4


@dataclass(frozen=True)
class Walker:
    """A person who is followed: the last landmarks, the region's motion (2,) in that step in pixels, and their
    number."""

    seen: Landmarks
    step: Float[np.ndarray, " 2"]
    number: int

    def region(self, fps: float) -> Region:
        """The region in the next picture."""
        following = self.seen.next_region
        return replace(following, centre=following.centre + np.exp(-1 / (_KEPT_S * fps)) * self.step)


def follow_people(
    network: BlazePose, picture: Integer[np.ndarray, "H W 3"], walkers: Sequence[Walker], fps: float
) -> list[Walker]:
    """Those of ``walkers`` who are found in the next picture (or the one before)."""
    pairs = [(w, seen) for w in walkers if (seen := detect_in_region(network, picture, w.region(fps))) is not None]
    kept = drop_overlapping([seen for _, seen in pairs])
    return [
        Walker(seen, seen.next_region.centre - walker.seen.next_region.centre, walker.number)
        for walker, seen in pairs
        if any(seen is k for k in kept)
    ]


def detect_people(
    pictures: Iterable[Integer[np.ndarray, "H W 3"]],
    detector: Detector,
    fps: float,
    first: list[Landmarks] | None = None,
) -> Iterator[list[Landmarks]]:
    """The people in each of the pictures, in order; ``first``: those in the first picture, where they are known."""
    network, stride = detector.placer, max(1, round(fps / _PLACED_FPS))
    placed_fps = fps / stride
    walkers: list[Walker] = []
    held: list[np.ndarray] = []
    results: list[dict[int, Landmarks] | None] = []  # of people by number; None = not placed yet
    closely_at = people = 0
    for number, picture in enumerate(pictures):
        every = max(1, min(round(_LOOK_S * fps), int(_HELD_BYTES / picture.nbytes)))
        held.append(picture)
        looks = not number or len(held) >= every
        if not looks and (len(held) - 1) % stride:
            results.append(None)
            continue
        walkers = follow_people(network, picture, walkers, placed_fps)
        results.append({w.number: w.seen for w in walkers})
        if not looks:
            continue
        known = [w.seen for w in walkers]
        new = detector.detect_new_people(picture, known) if number or first is None else first
        if number >= closely_at:
            small = detector.detect_new_people(picture, [*known, *new], closely=True)
            new = [*new, *small]
            # Where there are people whom only a close look finds, more will come.
            closely_at = number + (1 if small else max(1, round(_CLOSE_LOOK_S * fps)))
        found = [Walker(seen, np.zeros(2), people + k) for k, seen in enumerate(new)]
        people += len(found)
        walkers += found
        results[-1] = {w.number: w.seen for w in walkers}
        for back in range(len(held) - 2, -1, -1):
            known_there = results[back]
            if known_there is None:
                continue
            found = follow_people(network, held[back], found, placed_fps)
            # A track that meets a known person is that person's.
            everybody = drop_overlapping([*known_there.values(), *(w.seen for w in found)])
            found = [w for w in found if any(w.seen is e for e in everybody)]
            known_there |= {w.number: w.seen for w in found}
        # The last picture is kept: people of the next look are followed back to it.
        yield from fill_between(network, held, results)[:-1]
        held, results = [picture], [results[-1]]
    if results and results[-1] is None:
        results[-1] = {w.number: w.seen for w in follow_people(network, held[-1], walkers, placed_fps)}
    yield from fill_between(network, held, results)


def fill_between(
    network: BlazePose, pictures: Sequence[Integer[np.ndarray, "H W 3"]], results: Sequence[dict[int, Landmarks] | None]
) -> list[list[Landmarks]]:
    """The people in each of the pictures; some have ``results`` by people's numbers, the others, but
    neither the first nor the last, None.

    Between two pictures that both show a person the landmarks are interpolated if the motion is smooth enough;
    otherwise, and for people in one of the two only, the landmark network runs.
    """
    placed = [k for k, one in enumerate(results) if one is not None]
    known = [one or {} for one in results]
    out = [list(one.values()) for one in known]
    for n, (first, last) in enumerate(pairwise(placed)):
        before, after = known[first], known[last]
        around = [known[k] for k in placed[max(n - 1, 0) : n + 3]]
        for between in range(first + 1, last):
            seen = []
            for number in dict.fromkeys([*before, *after]):
                ends = [one[number] for one in (before, after) if number in one]
                guess = interpolate_landmarks(ends[0], ends[-1], (between - first) / (last - first))
                smooth = len(ends) == 2 and moves_smoothly([one.get(number) for one in around])
                own = guess if smooth else detect_in_region(network, pictures[between], guess.next_region)
                seen += [own] if own is not None else []
            out[between] = drop_overlapping(seen)
    return out


def moves_smoothly(seen: Sequence[Landmarks | None]) -> bool:
    """Whether interpolation is exact enough half-way between evenly spaced pictures, of which three are needed:
    half-way the error is a quarter of that over twice the time."""
    errors = []
    for before, now, after in zip(seen, seen[1:], seen[2:]):
        if before is None or now is None or after is None:
            continue
        visible = now.keypoints[:, 2] > _VISIBLE
        off = np.linalg.norm((now.keypoints - (before.keypoints + after.keypoints) / 2)[:, :2], axis=1)
        extent = float(np.linalg.norm(np.ptp(now.keypoints[:, :2], axis=0)))
        errors.append(float(np.quantile(off[visible], 0.9)) / 4 / extent if visible.any() and extent else np.inf)
    return bool(errors) and max(errors) < _EXACT_SHARE


def interpolate_landmarks(first: Landmarks, last: Landmarks, share: float) -> Landmarks:
    """Landmarks at ``share`` of the time between the first and the last."""

    def mix(a: Any, b: Any) -> Any:
        return (1 - share) * a + share * b

    def region(a: Region, b: Region) -> Region:
        turned = np.angle(np.exp(1j * (b.turn_rad - a.turn_rad)))
        return Region(mix(a.centre, b.centre), mix(a.side, b.side), a.turn_rad + share * float(turned))

    return Landmarks(
        mix(first.keypoints, last.keypoints),
        mix(first.presence, last.presence),
        mix(first.points_m, last.points_m),
        np.rint(mix(first.mask.astype(np.float32), last.mask.astype(np.float32))).astype(np.uint8),
        region(first.region, last.region),
        region(first.next_region, last.next_region),
        mix(first.better, last.better) if first.better is not None and last.better is not None else None,
    )


def keypoints_with_confidence(
    seen: Landmarks, wh: tuple[int, int], worth: dict[str, list[float]]
) -> Float[np.ndarray, "K 3"]:
    """Keypoints and confidences of a person in a picture of ``wh`` pixels; those outside the picture are missing.

    ``worth`` maps BlazePose's visibility to confidence; scores of the user's network are used as they are.
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
