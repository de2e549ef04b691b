# SPDX-License-Identifier: Apache-2.0
"""Evidence of people for one reading of a calibration: under the right one the rays of their joints meet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.keypoints.detections import to_pinhole
from studiorecon.rig.active_cameras import shared_frames
from studiorecon.rig.correspondences import Observations, make_observations
from studiorecon.rig.human_size import ADULTS_M, MIN_BONES, statures_m
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

T = TypeVar("T")
# Frames on which people judge a calibration, spread over those that show them.
FRAMES = 24
# As where cameras are judged on people; wide, since a calibration may be slightly off and still be the right one.
_GATE_M = 0.25
_LIMITS = Limits(outlier_units=9.0)
NOISE_SHARE = 0.003
"""Error of detectors, as a share of the longer side (6 of 1920 px)."""
# Standard errors by which a reading must be better than the usual one: 1 in 700 by chance.
_SURE = 3.0


def agreement(
    lenses: Sequence[Lens], sizes: Sequence[tuple[int, int]], people: Sequence[Detections]
) -> Float[np.ndarray, " F"]:
    """Log-likelihood ratio of people's joints in each of 24 frames, lenses against chance, summed; 0 where no rays
    meet."""
    frames, cameras, found = _sample_observations(lenses, sizes, people)
    total = np.zeros(len(frames))
    if found is None:
        return total
    points = triangulate(found.pixels, found.confidence, cameras, _LIMITS)
    counted = points.inliers & (points.verified if len(cameras) > 2 else points.valid)
    longer = np.array([[max(wh)] for wh in sizes], float)
    noise, gate = NOISE_SHARE * longer, _LIMITS.huber_share * _LIMITS.outlier_units * longer
    error = np.where(counted, points.error_px, gate)
    # Cauchy's distribution: a calibration that is somewhat off is still far better than a wrong one.
    fit = np.maximum(np.log((gate**2 + noise**2) / (error**2 + noise**2)), 0.0).sum(0)
    np.add.at(total, np.searchsorted(frames, found.frame), fit)
    return total


def is_in_metres(lenses: Sequence[Lens], sizes: Sequence[tuple[int, int]], people: Sequence[Detections]) -> bool | None:
    """Whether people have an adult's stature in the lenses' world; None where too few of their bones are seen."""
    _, cameras, found = _sample_observations(lenses, sizes, people)
    statures = statures_m(cameras, found, _LIMITS) if found is not None else np.zeros(0)
    if len(statures) < MIN_BONES:
        return None
    return bool(ADULTS_M[0] <= np.median(statures) <= ADULTS_M[1])


def _sample_observations(
    lenses: Sequence[Lens], sizes: Sequence[tuple[int, int]], people: Sequence[Detections]
) -> tuple[Integer[np.ndarray, " F"], list[Camera], Observations | None]:
    """Some frames, the lenses' pinholes, and what these see of people in those frames; None for nobody."""
    frames = shared_frames(people, FRAMES)
    both = [to_pinhole(d, lens, wh) for d, lens, wh in zip(people, lenses, sizes, strict=True)]
    cameras, seen = [c for c, _ in both], [d for _, d in both]
    if not len(frames):
        return frames, cameras, None
    found, _ = make_observations(seen, cameras, frames, _GATE_M)
    return frames, cameras, found if len(found.frame) else None


def best_candidate(candidates: Sequence[T], fit: Callable[[T], Float[np.ndarray, " F"]]) -> tuple[int, bool]:
    """Index of the candidate that people clearly prefer, else 0; and whether they prefer one."""
    scores = [fit(candidate) for candidate in candidates]
    order = np.argsort([-s.sum() for s in scores], kind="stable")
    first = int(order[0])

    def clearly(better: np.ndarray, other: np.ndarray) -> bool:
        gain = better - other
        return bool(gain.sum() > 0 and gain.mean() > _SURE * gain.std() / np.sqrt(max(len(gain), 1)))

    if all(clearly(scores[first], scores[int(other)]) for other in order[1:]):
        return first, len(scores) > 1
    # Of several that fit about equally well the likeliest one, unless people show that it is wrong.
    equal = [i for i in range(len(scores)) if not clearly(scores[first], scores[i])]
    return equal[0], False
