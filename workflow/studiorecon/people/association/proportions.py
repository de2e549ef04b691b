# SPDX-License-Identifier: Apache-2.0
"""Checks whether a skeleton has a person's proportions: a dog has narrow shoulders and hips for its trunk.

Its forelegs are not arms, and false landmarks do not keep their distances. People of all ages and sizes are well within
the bounds. A measured skeleton may be off in one of them, where an arm hides a shoulder, but not in two.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS

if TYPE_CHECKING:
    from jaxtyping import Float

# Shares of the trunk (middle of the shoulders to that of the hips). The real man and the synthetic studio's people:
# 0.65 to 0.71, 0.35 to 0.41, 0.47 to 0.57, 0.44 to 0.52, 0.71 to 0.87, 0.68 to 0.88; dogs on four legs: 0.15 to 0.35,
# 0.09 to 0.35, 0.21 to 0.45, 0.24 to 0.46, 0.41 to 0.98, 0.38 to 0.95.
_BOUNDS = {
    "shoulders": (0.45, 1.2),
    "hips": (0.27, 0.75),
    "upper arms": (0.35, 0.9),
    "forearms": (0.3, 0.85),
    "thighs": (0.6, 1.3),
    "shins": (0.55, 1.3),
}
_ENDS = {
    "shoulders": [("left_shoulder", "right_shoulder")],
    "hips": [("left_hip", "right_hip")],
    "upper arms": [("left_shoulder", "left_elbow"), ("right_shoulder", "right_elbow")],
    "forearms": [("left_elbow", "left_wrist"), ("right_elbow", "right_wrist")],
    "thighs": [("left_hip", "left_knee"), ("right_hip", "right_knee")],
    "shins": [("left_knee", "left_ankle"), ("right_knee", "right_ankle")],
}
# Bones have constant length: the median over them of their difference from their own median (people: 0.01 to 0.03;
# dogs: 0.08 to 0.27).
_UNSTEADY = 0.08
_MAX_OUTSIDE = 1
# A length needs so many frames, or half of those with any known point.
_MIN_FRAMES = 3


def lengths_m(points_m: Float[np.ndarray, "T 12 3"]) -> dict[str, list[Float[np.ndarray, " F"]]]:
    """Lengths of a skeleton's bones (T, 12, 3; NaN unknown), metres, in the frames in which they are known; "trunk" as
    well.

    Bones that are hardly ever known are left out.
    """
    at = {name: k for k, name in enumerate(STABLE_KEYPOINTS)}
    middles = [
        np.mean([points_m[:, at[f"{side}_{joint}"]] for side in ("left", "right")], axis=0)
        for joint in ("shoulder", "hip")
    ]
    ends = {"trunk": [(middles[0], middles[1])]}
    for part, limbs in _ENDS.items():
        ends[part] = [(points_m[:, at[first]], points_m[:, at[second]]) for first, second in limbs]
    known = {part: [np.linalg.norm(a - b, axis=-1) for a, b in limbs] for part, limbs in ends.items()}
    least = max(_MIN_FRAMES, 0.5 * float(np.isfinite(known["trunk"][0]).sum()))
    long = {part: [v[np.isfinite(v)] for v in values] for part, values in known.items()}
    return {part: kept for part, values in long.items() if (kept := [v for v in values if len(v) >= least])}


def shares(lengths: Mapping[str, Sequence[Float[np.ndarray, " F"]]]) -> dict[str, float]:
    """Medians over time as shares of the trunk, {} without a trunk; of a pair of limbs the less likely length
    counts."""
    if "trunk" not in lengths:
        return {}
    trunk_m = float(np.median(lengths["trunk"][0]))
    found = {}
    for part, (low, high) in _BOUNDS.items():
        own = [float(np.median(values)) / trunk_m for values in lengths.get(part, [])]
        if own:
            found[part] = max(own, key=lambda share: max(low / share, share / high))
    return found


def unsteadiness(lengths: Mapping[str, Sequence[Float[np.ndarray, " F"]]]) -> float:
    """Median relative difference of a bone's length from its own median; 0 where none is known."""
    own = [np.median(np.abs(v - np.median(v))) / np.median(v) for values in lengths.values() for v in values]
    return float(np.median(own)) if own else 0.0


def proportion_fault(points_m: Float[np.ndarray, "T 12 3"]) -> str:
    """Why a skeleton (T, 12, 3) lacks a person's proportions, as the end of a sentence; "" when it has them."""
    lengths = lengths_m(points_m)
    described = [
        f"{part} {share:.2f} of its trunk"
        for part, share in shares(lengths).items()
        if not _BOUNDS[part][0] <= share <= _BOUNDS[part][1]
    ]
    if (wavers := unsteadiness(lengths)) > _UNSTEADY:
        described.append(f"bones that change their length by {wavers:.0%}")
    if len(described) <= _MAX_OUTSIDE:
        return ""
    return f"its proportions are not a person's, an animal's rather: {', '.join(described)}"
