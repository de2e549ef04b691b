# SPDX-License-Identifier: Apache-2.0
"""People found and followed through the pictures of one camera.

Every ``_LOOK_S`` people are looked for in the whole picture. Who is found is followed through the pictures after that,
and back through those since the look before, by the landmarks themselves: they say where the body will be looked at
next, so that most pictures cost one run of the landmark network per person.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

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
# Pictures held between two looks, bytes: 4K at 60 per second is looked at more often.
_HELD_BYTES = 400e6
# Time in which a body's speed is forgotten to 1/e. A man on a spot and two who walk, 10 to 60 pictures a second: their
# hips are expected within 0.1 to 2 % of their height, twice as near as without.
_KEPT_S = 0.4


@dataclass(frozen=True)
class Walker:
    """Somebody who is followed: what was last seen of them, and how far their region moved in that step (2,) pixels."""

    seen: Landmarks
    step: Float[np.ndarray, " 2"]

    def region(self, fps: float) -> Region:
        """Where to look in the next picture."""
        following = self.seen.next_region
        return replace(following, centre=following.centre + np.exp(-1 / (_KEPT_S * fps)) * self.step)


def follow(
    network: BlazePose, picture: Integer[np.ndarray, "H W 3"], walkers: Sequence[Walker], fps: float
) -> list[Walker]:
    """Those of ``walkers`` who are found again in the next picture (or the one before)."""
    pairs = [(w, seen) for w in walkers if (seen := detect_in_region(network, picture, w.region(fps))) is not None]
    kept = drop_overlapping([seen for _, seen in pairs])
    return [
        Walker(seen, seen.next_region.centre - walker.seen.next_region.centre)
        for walker, seen in pairs
        if any(seen is k for k in kept)
    ]


def detect_people(
    pictures: Iterable[Integer[np.ndarray, "H W 3"]], detector: Detector, fps: float
) -> Iterator[list[Landmarks]]:
    """Everybody in each of the pictures, in order."""
    network = detector.placer
    walkers: list[Walker] = []
    held: list[np.ndarray] = []
    results: list[list[Landmarks]] = []
    closely_at = 0
    for number, picture in enumerate(pictures):
        every = max(1, min(round(_LOOK_S * fps), int(_HELD_BYTES / picture.nbytes)))
        walkers = follow(network, picture, walkers, fps)
        results.append([w.seen for w in walkers])
        held.append(picture)
        if number and len(held) < every:
            continue
        new = detector.detect_new_people(picture, results[-1])
        if number >= closely_at:
            small = detector.detect_new_people(picture, [*results[-1], *new], closely=True)
            new += small
            # Where there are people whom only a close look finds, more will come.
            closely_at = number + (1 if small else max(1, round(_CLOSE_LOOK_S * fps)))
        found = [Walker(seen, np.zeros(2)) for seen in new]
        walkers += found
        results[-1] = [w.seen for w in walkers]
        for back in range(2, len(held) + 1):
            found = follow(network, held[-back], found, fps)
            # Whoever runs into somebody known has been followed already.
            known = results[-back]
            everybody = drop_overlapping([*known, *(w.seen for w in found)])
            found = [w for w in found if any(w.seen is e for e in everybody)]
            results[-back] = known + [w.seen for w in found]
        # The last picture is looked at again: whoever is found next time goes back to it.
        yield from results[:-1]
        held, results = [picture], [results[-1]]
    yield from results


def keypoints_with_confidence(
    seen: Landmarks, wh: tuple[int, int], worth: dict[str, list[float]]
) -> Float[np.ndarray, "K 3"]:
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
