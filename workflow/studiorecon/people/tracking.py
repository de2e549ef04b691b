# SPDX-License-Identifier: Apache-2.0
"""Following people in one camera, from frame to frame, by their keypoints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

_REFUSED = 1e6


@dataclass(frozen=True)
class TrackingLimits:
    """When two detections of one camera are the same person.

    Attributes:
        step_share: largest median keypoint distance between them, as a share of the person's box diagonal, per frame apart.
        shape_share: largest median keypoint distance once the two are laid on each other (same measure): a person's outline changes
            little between frames, a false detection's is another one. However long the gap, what is shaped otherwise is no rival.
        gap_frames: frames without a detection after which a track ends.
        duplicate_share: two detections of one frame closer than this (same measure) are one person found twice.
        clear_ratio: the second best continuation of a track must be this many times further away, else it ends: two short
            tracks are joined again by the other cameras, one that jumped to another person is not taken apart any more.
    """

    step_share: float
    shape_share: float
    gap_frames: int
    duplicate_share: float
    clear_ratio: float


def distance_shares(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(A, B) median distance over shared keypoints of detections (A, K, 3) and (B, K, 3), as a share of the smaller box diagonal.

    inf where fewer than three keypoints are shared. The median, because one misplaced wrist is not another person.
    """
    return _median_shares(first, second, aligned=False)


def shape_shares(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(A, B) the same after the median offset between the two is taken out: how differently they are shaped, wherever they are."""
    return _median_shares(first, second, aligned=True)


def _median_shares(first: np.ndarray, second: np.ndarray, aligned: bool) -> np.ndarray:
    if not len(first) or not len(second):
        return np.zeros((len(first), len(second)))
    shared = (first[:, None, :, 2] > 0) & (second[None, :, :, 2] > 0)
    offset = np.nan_to_num(first[:, None, :, :2]) - np.nan_to_num(second[None, :, :, :2])
    if aligned:
        offset = offset - np.stack([_medians(offset[..., axis], shared) for axis in (0, 1)], axis=-1)[:, :, None]
    middle = _medians(np.linalg.norm(offset, axis=-1), shared)
    diagonal = np.minimum(box_diagonals(first)[:, None], box_diagonals(second)[None])
    return np.where(shared.sum(-1) >= 3, middle / np.maximum(diagonal, 1e-9), np.inf)


def _medians(values: np.ndarray, present: np.ndarray) -> np.ndarray:
    """(...,) lower median over the last axis of the present values, 0 where there is none."""
    # Sorting with inf for missing ones and picking the middle of the present ones is a median without all-NaN warnings.
    ordered = np.sort(np.where(present, values, np.inf), axis=-1)
    middle = np.take_along_axis(ordered, np.maximum((present.sum(-1) - 1) // 2, 0)[..., None], axis=-1)[..., 0]
    return np.where(np.isfinite(middle), middle, 0.0)


def box_diagonals(keypoints: np.ndarray) -> np.ndarray:
    """(D,) diagonal in pixels of the box of present keypoints (D, K, 3)."""
    present = keypoints[..., 2:3] > 0
    low = np.where(present, keypoints[..., :2], np.inf).min(1)
    high = np.where(present, keypoints[..., :2], -np.inf).max(1)
    return np.linalg.norm(np.where(np.isfinite(high - low), high - low, 0.0), axis=-1)


def without_duplicates(frame: np.ndarray, keypoints: np.ndarray, limits: TrackingLimits) -> np.ndarray:
    """(D,) bool: detections to keep when the less confident of two that lie on each other in one frame is dropped."""
    keep = np.ones(len(frame), dtype=bool)
    strength = keypoints[..., 2].sum(-1)
    for t in np.unique(frame):
        which = np.flatnonzero(frame == t)
        which = which[np.argsort(-strength[which], kind="stable")]
        shares = distance_shares(keypoints[which], keypoints[which])
        for late in range(1, len(which)):
            early = keep[which[:late]]
            keep[which[late]] = not (early & (shares[:late, late] < limits.duplicate_share)).any()
    return keep


def match(cost: np.ndarray, limit: float) -> list[tuple[int, int]]:
    """Pairs of the cheapest assignment whose cost is below ``limit``.

    Inadmissible and non-finite pairs are priced out before the assignment and dropped after it (A01, A02, A03, A13).
    """
    if 0 in cost.shape:
        return []
    admissible = np.isfinite(cost) & (cost < limit)
    rows, columns = scipy.optimize.linear_sum_assignment(np.where(admissible, cost, _REFUSED))
    return [(int(r), int(c)) for r, c in zip(rows, columns) if admissible[r, c]]


def tracks(frame: np.ndarray, keypoints: np.ndarray, limits: TrackingLimits) -> np.ndarray:
    """(D,) track id of every detection, numbered by first appearance; ``keypoints`` (D, K, 3), NaN where confidence is 0."""
    ids = np.full(len(frame), -1)
    latest: dict[int, int] = {}
    for t in np.unique(frame):
        now = np.flatnonzero(frame == t)
        open_tracks = [k for k, d in latest.items() if t - frame[d] <= limits.gap_frames]
        gaps = np.array([t - frame[latest[k]] for k in open_tracks], dtype=np.float64)
        before = keypoints[[latest[k] for k in open_tracks]]
        shares = distance_shares(before, keypoints[now]) / np.maximum(gaps[:, None], 1.0)
        shares = np.where(shape_shares(before, keypoints[now]) < limits.shape_share, shares, np.inf)
        for row, column in match(shares, limits.step_share):
            rivals = np.concatenate([np.delete(shares[row], column), np.delete(shares[:, column], row)])
            if (rivals < min(limits.clear_ratio * shares[row, column], limits.step_share)).any():
                # Ended for good: as an open track it would be a rival of its own continuation in every later frame.
                del latest[open_tracks[row]]
            else:
                ids[now[column]] = open_tracks[row]
        for detection in now[ids[now] < 0]:
            ids[detection] = ids.max() + 1
        latest.update({int(ids[d]): int(d) for d in now})
    return ids
