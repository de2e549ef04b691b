# SPDX-License-Identifier: Apache-2.0
"""Is somebody in the picture where the keypoints say so? The clean plate knows what the room looks like without people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

_RADIUS_SHARE = 0.004
_LEAST_KEYPOINTS = 5


@dataclass(frozen=True)
class EvidenceLimits:
    """When pictures contradict keypoints; see ``config.yaml`` for each value's meaning."""

    frames: int
    difference: float
    absent_share: float
    present_share: float


def foreground(frame: np.ndarray, plate: np.ndarray, difference: float) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) bool: pixels that differ from the plate, and (H, W) bool: where the plate is measured.

    ``frame`` (H, W, 3) and ``plate`` (H, W, 4) uint8. Both are blurred a little against noise and misregistration; the plate's
    median offset per channel is taken off against a change of exposure.
    """
    measured = plate[..., 3] > 127
    first = cv2.GaussianBlur(frame, (0, 0), 1.5).astype(np.float32)
    second = cv2.GaussianBlur(plate[..., :3], (0, 0), 1.5).astype(np.float32)
    if not measured.any():
        return np.zeros(measured.shape, dtype=bool), measured
    offset = np.median((first - second)[measured], axis=0)
    return (np.abs(first - second - offset).max(-1) > difference) & measured, measured


def keypoint_support(keypoints: np.ndarray, present: np.ndarray, measured: np.ndarray) -> tuple[int, int]:
    """How many keypoints (K, 3) lie on (or within 0.4 % of the image of) foreground, and how many could be judged.

    Judged are keypoints inside the picture on a measured piece of plate.
    """
    height, width = present.shape
    radius = max(1, round(_RADIUS_SHARE * max(height, width)))
    near = cv2.dilate(present.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)))
    usable = keypoints[:, 2] > 0
    columns, rows = np.floor(keypoints[usable, 0]).astype(int), np.floor(keypoints[usable, 1]).astype(int)
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    columns, rows = columns[inside], rows[inside]
    judged = measured[rows, columns]
    return int((near[rows, columns] > 0)[judged].sum()), int(judged.sum())


def person_share(counts: Sequence[tuple[int, int]]) -> float:
    """Mean over views of the supported share, from (supported, judged) per view; NaN when no view could judge.

    Views weigh equally: another person who happens to stand in one line of sight must not vouch for nobody in all others.
    """
    shares = [on / judged for on, judged in counts if judged >= _LEAST_KEYPOINTS]
    return float(np.mean(shares)) if shares else float("nan")


def absent(shares: Sequence[float], limits: EvidenceLimits) -> list[bool]:
    """For every person whether the pictures say that nobody is there.

    Only believed when the same pictures confirm somebody else: a plate that still contains the people who never moved
    contradicts everybody, and then contradicts nobody.
    """
    trusted = any(share >= limits.present_share for share in shares)
    return [bool(trusted and share < limits.absent_share) for share in shares]
