# SPDX-License-Identifier: Apache-2.0
"""Evidence of people for one reading of a calibration: under the right one the rays of their joints meet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from studiorecon.keypoints.detections import to_pinhole
from studiorecon.rig.active_cameras import shared_frames
from studiorecon.rig.correspondences import make_observations
from studiorecon.rig.human_size import is_adult, median_stature_m
from studiorecon.rig.starts import FRAMES, LIMITS, Start, is_clearly_better, people_nats
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float

T = TypeVar("T")
# As where cameras are judged on people (``rig.agreement``).
_GATE_M = 0.25


def agreement(
    lenses: Sequence[Lens], sizes: Sequence[tuple[int, int]], people: Sequence[Detections]
) -> Float[np.ndarray, " F"]:
    """Log-likelihood ratio of people's joints in each of 24 frames, lenses against chance, summed; 0 where no rays
    meet."""
    return people_nats(Start("", "", *_pinholes(lenses, sizes, people)), shared_frames(people, FRAMES), _GATE_M)[0]


def is_in_metres(lenses: Sequence[Lens], sizes: Sequence[tuple[int, int]], people: Sequence[Detections]) -> bool | None:
    """Whether people have an adult's stature in the lenses' world; None where too few of their bones are seen."""
    cameras, seen = _pinholes(lenses, sizes, people)
    found, _ = make_observations(seen, cameras, shared_frames(people, FRAMES), _GATE_M)
    stature_m = median_stature_m(cameras, found, LIMITS)
    return None if stature_m is None else is_adult(stature_m)


def _pinholes(
    lenses: Sequence[Lens], sizes: Sequence[tuple[int, int]], people: Sequence[Detections]
) -> tuple[list[Camera], list[Detections]]:
    both = [to_pinhole(d, lens, wh) for d, lens, wh in zip(people, lenses, sizes, strict=True)]
    return [camera for camera, _ in both], [seen for _, seen in both]


def best_candidate(candidates: Sequence[T], fit: Callable[[T], Float[np.ndarray, " F"]]) -> tuple[int, bool]:
    """Index of the candidate that people clearly prefer, else 0; and whether they prefer one."""
    scores = [fit(candidate) for candidate in candidates]
    order = np.argsort([-s.sum() for s in scores], kind="stable")
    first = int(order[0])

    if all(is_clearly_better(scores[first], scores[int(other)]) for other in order[1:]):
        return first, len(scores) > 1
    # Of several that fit about equally well the likeliest one, unless people show that it is wrong.
    equal = [i for i in range(len(scores)) if not is_clearly_better(scores[first], scores[i])]
    return equal[0], False
