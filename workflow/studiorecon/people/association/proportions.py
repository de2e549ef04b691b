# SPDX-License-Identifier: Apache-2.0
"""Whether a skeleton has a person's proportions: a dog's shoulders and hips are narrow for its trunk, its shins short.

People of all ages and sizes lie well within the bounds; a measured skeleton may be off in one of them, where an arm
hides a shoulder, but not in two.
"""

from __future__ import annotations

import numpy as np

from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS

# Shares of the trunk (middle of the shoulders to that of the hips). The real man and the made studio's people: 0.65 to
# 0.71, 0.35 to 0.41, 0.71 to 0.87, 0.68 to 0.88; a dog on four legs: 0.33, 0.24, 0.63, 0.51 to 0.69.
_BOUNDS = {
    "shoulders": (0.45, 1.2),
    "hips": (0.27, 0.75),
    "thighs": (0.6, 1.3),
    "shins": (0.55, 1.3),
}
_ENDS = {
    "shoulders": [("left_shoulder", "right_shoulder")],
    "hips": [("left_hip", "right_hip")],
    "thighs": [("left_hip", "left_knee"), ("right_hip", "right_knee")],
    "shins": [("left_knee", "left_ankle"), ("right_knee", "right_ankle")],
}
_MOST_OUTSIDE = 1
# A length is known from so many frames, or from half of those in which anything is.
_LEAST_FRAMES = 3


def shares(points_m: np.ndarray) -> dict[str, float]:
    """Lengths of a skeleton (T, 12, 3; NaN unknown) as shares of its trunk, medians over time; what is hardly ever
    known is left out. Of a pair of limbs the one with the less likely length counts."""
    at = {name: k for k, name in enumerate(STABLE_KEYPOINTS)}
    middles = [
        np.mean([points_m[:, at[f"{side}_{joint}"]] for side in ("left", "right")], axis=0)
        for joint in ("shoulder", "hip")
    ]
    trunk_m = np.linalg.norm(middles[0] - middles[1], axis=-1)
    if np.isfinite(trunk_m).sum() < _LEAST_FRAMES:
        return {}
    found = {}
    for part, limbs in _ENDS.items():
        low, high = _BOUNDS[part]
        known = []
        for first, second in limbs:
            length_m = np.linalg.norm(points_m[:, at[first]] - points_m[:, at[second]], axis=-1)
            if np.isfinite(length_m).sum() >= max(_LEAST_FRAMES, 0.5 * np.isfinite(trunk_m).sum()):
                known.append(float(np.nanmedian(length_m) / np.nanmedian(trunk_m)))
        if known:
            found[part] = max(known, key=lambda share: max(low / share, share / high))
    return found


def why_no_person(points_m: np.ndarray) -> str:
    """Why a skeleton (T, 12, 3) has not a person's proportions, as the end of a sentence; "" when it has."""
    outside = {part: s for part, s in shares(points_m).items() if not _BOUNDS[part][0] <= s <= _BOUNDS[part][1]}
    if len(outside) <= _MOST_OUTSIDE:
        return ""
    told = ", ".join(f"{part} {share:.2f}" for part, share in outside.items())
    return f"its proportions are not a person's, an animal's rather: {told} of its trunk"
