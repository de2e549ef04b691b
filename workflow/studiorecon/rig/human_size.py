# SPDX-License-Identifier: Apache-2.0
"""Checks that people have a human size, because a calibration in feet fits every pixel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.errors import UserError
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.rig.correspondences import Observations
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Num

# Stature and lengths of bones between keypoints of a mean adult, metres.
_ADULT_M = 1.70
_BONES = {("shoulder", "hip"): 0.52, ("hip", "knee"): 0.42, ("knee", "ankle"): 0.41}
# A toddler, and the tallest person on record, with a margin of a third: bones of few keypoints are short or long.
_SMALLEST_M, _LARGEST_M = 0.5, 3.0
_ADULTS_M = 1.3, 2.2
# Bones that a median needs.
_MIN_BONES = 30
# Number of each unit in a metre.
UNITS_PER_METRE = {"millimetres": 1000.0, "centimetres": 100.0, "inches": 39.3701, "feet": 3.28084}


def _statures_m(cameras: Sequence[Camera], seen: Observations, limits: Limits) -> Num[np.ndarray, " N"]:
    """For each of the N bones that the cameras see, the stature of a mean adult with that bone, metres."""
    if not len(seen.frame):
        return np.zeros(0)
    found = triangulate(seen.pixels, seen.confidence, cameras, limits)
    counted = found.verified if len(cameras) > 2 and found.verified.sum() >= _MIN_BONES else found.valid
    of_body = seen.group * (int(seen.frame.max()) + 1) + seen.frame
    bodies, row = np.unique(of_body, return_inverse=True)
    joints = np.full((len(bodies), len(STABLE_KEYPOINTS), 3), np.nan)
    joints[row[counted], seen.keypoint[counted]] = found.points_m[counted]
    found_m = []
    for (upper, lower), length_m in _BONES.items():
        for side in ("left", "right"):
            ends = [STABLE_KEYPOINTS.index(f"{side}_{joint}") for joint in (upper, lower)]
            found_m.append(np.linalg.norm(joints[:, ends[0]] - joints[:, ends[1]], axis=-1) * _ADULT_M / length_m)
    all_m = np.concatenate(found_m)
    return all_m[np.isfinite(all_m)]


def median_stature_m(cameras: Sequence[Camera], seen: Observations, limits: Limits) -> float | None:
    """The median stature in metres; None where too few bones are seen."""
    found_m = _statures_m(cameras, seen, limits)
    return float(np.median(found_m)) if len(found_m) >= _MIN_BONES else None


def check_human_size(cameras: Sequence[Camera], seen: Observations, limits: Limits) -> float | None:
    """``median_stature_m``; raises UserError for an impossible one."""
    stature_m = median_stature_m(cameras, seen, limits)
    if is_possible(stature_m):
        return stature_m
    assert stature_m is not None
    raise size_refusal(stature_m)


def is_possible(stature_m: float | None) -> bool:
    """Whether a stature is unknown, or between a toddler's and the tallest person's."""
    return stature_m is None or _SMALLEST_M <= stature_m <= _LARGEST_M


def is_adult(stature_m: float | None) -> bool:
    """Whether a stature is known and an adult's, so that its unit of length is metres."""
    return stature_m is not None and _ADULTS_M[0] <= stature_m <= _ADULTS_M[1]


def size_refusal(stature_m: float) -> UserError:
    """The refusal of lengths by which people are ``stature_m`` tall."""
    cause, factor = "", _ADULT_M / stature_m
    for unit, per_metre in UNITS_PER_METRE.items():
        if is_adult(stature_m / per_metre):
            cause, factor = f" but, it seems, {unit};", 1 / per_metre
        elif is_adult(stature_m * per_metre):
            cause, factor = f", metres were probably read as {unit};", per_metre
    if is_adult(10 * stature_m):
        cause, factor = ", centimetres were probably read as millimetres: set calibration.unit: cm, or", 10.0
    return UserError(
        f"people would be {stature_m:.3g} m tall by this calibration, so its lengths are not metres{cause or ';'} "
        f"multiply calibration.scale by {factor:.4g}, which makes people {stature_m * factor:.2f} m tall"
    )
