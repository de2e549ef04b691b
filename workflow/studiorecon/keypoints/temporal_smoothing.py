# SPDX-License-Identifier: Apache-2.0
"""Smooths keypoints over time: a network sees every picture separately, so its landmarks jitter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from studiorecon.scene.people import Detections

# Sigma of the weights over time. A hand that swings six times a second loses a fifth of its swing, one that swings
# three times a twentieth; at 60 pictures a second half the jitter is removed, at 10 nothing changes.
_SIGMA_S = 1 / 60
_REACH = 3.0


def smooth_keypoints(seen: Detections, fps: float) -> Detections:
    """``seen`` with every keypoint on a straight line through its track's neighbouring times.

    The line's weights fall with time and rise with confidence, so people who walk are not delayed, also at the ends of
    a track. Confidences are unchanged.
    """
    reach = int(_REACH * _SIGMA_S * fps + 1e-9)
    if not reach:
        return seen
    keypoints = seen.keypoints.copy()
    for track in np.unique(seen.track):
        mine = np.flatnonzero(seen.track == track)
        mine = mine[np.argsort(seen.frame[mine], kind="stable")]
        first, last = int(seen.frame[mine[0]]), int(seen.frame[mine[-1]])
        dense = np.zeros((last - first + 1 + 2 * reach, *seen.keypoints.shape[1:]))
        here = seen.frame[mine] - first + reach
        dense[here] = np.nan_to_num(seen.keypoints[mine])
        keypoints[mine, :, :2] = _on_lines(dense, here, reach, fps)
        keypoints[mine, :, :2] = np.where(
            seen.keypoints[mine, :, 2:] > 0, keypoints[mine, :, :2], seen.keypoints[mine, :, :2]
        )
    return replace(seen, keypoints=keypoints)


def _on_lines(dense: np.ndarray, here: np.ndarray, reach: int, fps: float) -> np.ndarray:
    """(N, K, 2) positions at the rows ``here`` of ``dense`` (T, K, 3), confidence 0 where there is none."""
    own = dense[here, :, :2]
    weights, times, offs = [], [], []
    for step in range(-reach, reach + 1):
        beside = dense[here + step]
        ahead_s = step / fps
        weights.append(beside[..., 2] * np.exp(-0.5 * (ahead_s / _SIGMA_S) ** 2))
        times.append(ahead_s)
        offs.append(beside[..., :2] - own)
    weight, time_s, off = np.stack(weights), np.array(times)[:, None, None], np.stack(offs)
    total = np.maximum(weight.sum(0), 1e-12)
    middle_s, middle = (weight * time_s).sum(0) / total, (weight[..., None] * off).sum(0) / total[..., None]
    spread = (weight * (time_s - middle_s) ** 2).sum(0)
    slope = (weight[..., None] * (time_s - middle_s)[..., None] * (off - middle)).sum(0) / np.maximum(spread, 1e-12)[
        ..., None
    ]
    # A line through one neighbour and the point itself leaves the point where it is.
    return own + middle - slope * middle_s[..., None]
