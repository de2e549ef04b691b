# SPDX-License-Identifier: Apache-2.0
"""Tracks people in one camera, from frame to frame, by their keypoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer, Num

# Time over which a track's speed is measured and extrapolated: an arm swings back after a quarter of a stride.
_REMEMBERED_S = 0.2
# How fast an outline may change beyond ``shape_share``, shares of the box diagonal per second: a person turns, bends,
# sits down.
_RESHAPED_S = 0.8
# A second candidate this near to a track's prediction, as a share of the gate, makes the match doubtful however well
# the first fits: people who meet may pass or turn back.
_TOO_NEAR = 0.2


@dataclass(frozen=True)
class TrackingLimits:
    """When two detections of one camera are the same person; lengths are shares of the person's box diagonal.

    Attributes:
        place_share, speed_share_s: largest median keypoint distance of a detection from its track's last or predicted
            position: so much at once, and so much more per second since the track was last seen.
        shape_share: the same at once when the two are aligned: false detections have other outlines.
        gap_s: time without a detection after which a track ends.
        duplicate_share: two detections of one frame closer than this are one person detected twice.
        clear_ratio: the second best continuation of a track must be this many times further away, else it ends: other
            cameras join two short tracks again, but never split one that jumped to another person.
    """

    place_share: float = 0.12
    speed_share_s: float = 2.0
    shape_share: float = 0.1
    gap_s: float = 0.5
    duplicate_share: float = 0.04
    clear_ratio: float = 2.0


def distance_shares(first: Num[np.ndarray, "A K 3"], second: Num[np.ndarray, "B K 3"]) -> Num[np.ndarray, "A B"]:
    """Median distance over shared keypoints of any two detections, as a share of the smaller box diagonal.

    inf where fewer than three keypoints are shared. The median, because one misplaced wrist is not another person.
    """
    return _median_shares(first, second, aligned=False)


def shape_shares(first: Num[np.ndarray, "A K 3"], second: Num[np.ndarray, "B K 3"]) -> Num[np.ndarray, "A B"]:
    """The same after the median offset between the two is removed: the difference in shape, at any position."""
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


def box_diagonals(keypoints: Num[np.ndarray, "D K 3"]) -> Num[np.ndarray, " D"]:
    """Diagonal in pixels of the box of present keypoints."""
    present = keypoints[..., 2:3] > 0
    low = np.where(present, keypoints[..., :2], np.inf).min(1)
    high = np.where(present, keypoints[..., :2], -np.inf).max(1)
    return np.linalg.norm(np.where(np.isfinite(high - low), high - low, 0.0), axis=-1)


def drop_duplicates(
    frame: Integer[np.ndarray, " D"], keypoints: Num[np.ndarray, "D K 3"], limits: TrackingLimits
) -> Bool[np.ndarray, " D"]:
    """Which detections to keep when the less confident of two overlapping ones in a frame is dropped."""
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


def match_detections(cost: Num[np.ndarray, "A B"], limit: float) -> list[tuple[int, int]]:
    """Pairs of the cheapest assignment whose cost is below ``limit``; others are excluded before it (A01–A03, A13)."""
    if 0 in cost.shape:
        return []
    admissible = np.isfinite(cost) & (cost < limit)
    rows, columns = scipy.optimize.linear_sum_assignment(np.where(admissible, cost, 1e6))
    return [(int(r), int(c)) for r, c in zip(rows, columns) if admissible[r, c]]


def track_ids(
    frame: Integer[np.ndarray, " D"], keypoints: Num[np.ndarray, "D K 3"], limits: TrackingLimits, fps: float
) -> Num[np.ndarray, " D"]:
    """Track id of every detection, numbered by first appearance; ``keypoints``: NaN where confidence is 0.

    A track continues at its last position or at the one predicted from its speed, whichever is nearer: people walk on,
    and people stop. So the same gates fit ten pictures a second and a hundred and twenty.
    """
    ids = np.full(len(frame), -1)
    open_tracks: dict[int, list[int]] = {}
    for t in np.unique(frame):
        now = np.flatnonzero(frame == t)
        open_tracks = {k: seen for k, seen in open_tracks.items() if (t - frame[seen[-1]]) / fps <= limits.gap_s}
        names = list(open_tracks)
        elapsed_s = np.array([(t - frame[open_tracks[k][-1]]) / fps for k in names])[:, None]
        cost = _strangeness(
            keypoints[[open_tracks[k][-1] for k in names]],
            np.array([_gone_on(frame, keypoints, open_tracks[k], int(t), fps) for k in names]).reshape(
                -1, *keypoints.shape[1:]
            ),
            keypoints[now],
            elapsed_s,
            limits,
        )
        for row, column in match_detections(cost, 1.0):
            rivals = np.concatenate([np.delete(cost[row], column), np.delete(cost[:, column], row)])
            if (rivals < np.clip(limits.clear_ratio * cost[row, column], _TOO_NEAR, 1.0)).any():
                # Removed for good: as an open track it would compete with its own continuation in every later frame.
                del open_tracks[names[row]]
            else:
                ids[now[column]] = names[row]
        for detection in now[ids[now] < 0]:
            ids[detection] = ids.max() + 1
        for detection in now:
            seen = open_tracks.setdefault(int(ids[detection]), [])
            seen.append(int(detection))
            while (t - frame[seen[0]]) / fps > _REMEMBERED_S and len(seen) > 2:
                seen.pop(0)
    return ids


def _strangeness(
    before: np.ndarray, ahead: np.ndarray, now: np.ndarray, elapsed_s: np.ndarray, limits: TrackingLimits
) -> np.ndarray:
    """Distance of detections from tracks at their last or predicted positions, as a share of the gate."""
    strayed = np.minimum(distance_shares(before, now), distance_shares(ahead, now))
    changed = np.minimum(shape_shares(before, now), shape_shares(ahead, now))
    alike = changed < limits.shape_share + _RESHAPED_S * elapsed_s
    return np.where(alike, strayed / (limits.place_share + limits.speed_share_s * elapsed_s), np.inf)


def _gone_on(frame: np.ndarray, keypoints: np.ndarray, seen: Sequence[int], t: int, fps: float) -> np.ndarray:
    """Keypoints of a track at frame ``t``, extrapolated at the speed of a line through its last moments.

    None is extrapolated further than ``_REMEMBERED_S``, because a keypoint swings back after a while.
    """
    last, recent = keypoints[seen[-1]], list(seen)
    if len(recent) < 2:
        return last
    ago_s = (frame[recent] - frame[recent[-1]]) / fps
    present = keypoints[recent][..., 2] > 0
    weight = present.astype(np.float64)
    count = np.maximum(weight.sum(0), 1.0)
    places = np.where(present[..., None], keypoints[recent][..., :2], 0.0)
    middle_s, middle = (weight * ago_s[:, None]).sum(0) / count, places.sum(0) / count[:, None]
    off_s = weight * (ago_s[:, None] - middle_s)
    speed = (off_s[..., None] * (places - middle)).sum(0) / np.maximum((off_s**2).sum(0), 1e-9)[:, None]
    ahead_s = min((t - frame[recent[-1]]) / fps, _REMEMBERED_S)
    return np.column_stack([last[:, :2] + ahead_s * speed, last[:, 2]])
