# SPDX-License-Identifier: Apache-2.0
"""Is somebody in the picture where the keypoints say so? Where a keypoint has moved, the picture must have changed.

No plate is needed, and a person who stands still is not judged. A skeleton of nobody (left over from another take, projected by
a wrong calibration) moves over a picture that stays the same; it can be consistent in all views to a pixel, so geometry alone
cannot tell. On a real take such a skeleton scored 0.26, the man beside it 0.96.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

_RADIUS_SHARE = 0.004
_BLUR_PX = 1.5
_LEAST_PLACES = 20
_LEAST_VIEWS = 2


@dataclass(frozen=True)
class EvidenceLimits:
    """When pictures contradict keypoints.

    Attributes:
        frames: pictures per camera that are compared; 0 = no test.
        confidence: surer keypoints only; doubtful ones wander over a person who stands still.
        step_share: how far a keypoint must have moved between two pictures, as a share of the longer image side.
        difference: grey levels (of 255) by which the picture must have changed there.
        absent_share, present_share: below the first nobody is there, above the second somebody is.
    """

    frames: int
    confidence: float
    step_share: float
    difference: float
    absent_share: float
    present_share: float


def sampled_frames(frames: np.ndarray, wanted: int) -> np.ndarray:
    """At most ``wanted`` of the distinct ``frames``, evenly spread."""
    distinct = np.unique(frames)
    if not len(distinct) or not wanted:
        return distinct[:0]
    return np.unique(distinct[np.linspace(0, len(distinct) - 1, min(wanted, len(distinct))).round().astype(int)])


def motion_support(pictures: Sequence[np.ndarray], keypoints: Sequence[np.ndarray], limits: EvidenceLimits) -> np.ndarray:
    """(2,) how many places that a keypoint left or reached show a change, and how many places there are.

    ``pictures`` are (H, W, 3) uint8 of one camera, ``keypoints`` one person's (K, 3) in each of them. Every two pictures are
    compared, after a little blur and without their median colour (exposure).
    """
    blurred = [cv2.GaussianBlur(p, (0, 0), _BLUR_PX).astype(np.float32) for p in pictures]
    smooth = [b - np.median(b[::4, ::4], axis=(0, 1)) for b in blurred]
    counts = np.zeros(2, dtype=int)
    for a, b in combinations(range(len(pictures)), 2):
        sure = (keypoints[a][:, 2] >= limits.confidence) & (keypoints[b][:, 2] >= limits.confidence)
        first, second = keypoints[a][sure, :2], keypoints[b][sure, :2]
        moved = np.linalg.norm(first - second, axis=-1) > limits.step_share * max(pictures[a].shape[:2])
        if not moved.any():
            continue
        changed = np.abs(smooth[a] - smooth[b]).max(-1) > limits.difference
        radius = max(1, round(_RADIUS_SHARE * max(changed.shape)))
        near = cv2.dilate(changed.astype(np.uint8), np.ones((2 * radius + 1, 2 * radius + 1), np.uint8))
        columns, rows = np.floor(np.concatenate([first[moved], second[moved]])).astype(int).T
        inside = (columns >= 0) & (columns < near.shape[1]) & (rows >= 0) & (rows < near.shape[0])
        counts += int(near[rows[inside], columns[inside]].sum()), int(inside.sum())
    return counts


def person_share(counts: np.ndarray) -> float:
    """Mean over views of the supported share, from (V, 2) counts; NaN when fewer than two views have twenty places to judge.

    Views weigh equally: somebody else who happens to pass in one line of sight must not vouch for nobody in all others.
    """
    judged = counts[counts[:, 1] >= _LEAST_PLACES]
    return float((judged[:, 0] / judged[:, 1]).mean()) if len(judged) >= _LEAST_VIEWS else float("nan")


def absent(shares: Sequence[float], limits: EvidenceLimits) -> list[bool]:
    """For every person whether the pictures say that nobody is there.

    Only believed when the same pictures confirm somebody else: videos that are badly lit, or out of step with the keypoints,
    contradict everybody, and then contradict nobody.
    """
    trusted = any(share >= limits.present_share for share in shares)
    return [bool(trusted and share < limits.absent_share) for share in shares]
