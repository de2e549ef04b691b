# SPDX-License-Identifier: Apache-2.0
"""Warns of what has no match: people without motion or a record, motion without people, heads below feet."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.keypoints.motion import Motion
from studiorecon.keypoints.motion_agreement import MIN_FRAMES, ShiftChange, is_upside_down

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# Share of the picture's height that people have where a film without their motion is named: twice the height from which
# `Motion.busy` sees one.
_MIN_TALL = 0.2
# Share of their keypoints that are where bodies seldom are: people who stay in one place may be invisible motion.
_MIN_WALKING = 0.5
# Share of the frames that hold nobody, although as much moves in them as in the others, from which they are named.
_MIN_UNSEEN = 0.25
# Share of the people with their head below their feet, of whom a few may lie or be on their hands.
_MIN_UPSIDE_DOWN = 0.9


def without_motion(
    camera: str, height_share: Num[np.ndarray, "D K"], keypoints: Num[np.ndarray, "D K 3"], walking_share: float
) -> list[str]:
    """A warning where tall people walk in a film without motion; ``height_share``: y over the picture's height."""
    there = (keypoints[..., 2] > 0) & (keypoints[..., :2] != 0).any(-1) & np.isfinite(height_share)
    shown = np.where(there, height_share, np.nan)[there.any(-1)]
    if not len(shown) or walking_share < _MIN_WALKING:
        return []
    if np.median(np.nanmax(shown, axis=-1) - np.nanmin(shown, axis=-1)) < _MIN_TALL:
        return []
    return [
        f"people move in the keypoints of camera {camera}, but nothing of their size moves in its pictures: check "
        "that film and keypoints are of one take"
    ]


def without_people(
    camera: str, motion: Motion, frame: Integer[np.ndarray, " D"], recorded: Integer[np.ndarray, " P"]
) -> list[str]:
    """A warning where detections leave out many of the ``recorded`` frames that move as the others do."""
    known = np.isin(motion.frame, recorded)
    somebody = np.isin(motion.frame, frame)[known]
    moves = (motion.near == 1).mean(axis=(1, 2))[known]
    if (~somebody).mean() < _MIN_UNSEEN or np.median(moves[~somebody]) < 0.5 * np.median(moves[somebody]):
        return []
    return [
        f"the keypoints of camera {camera} have no person in {(~somebody).mean():.0%} of its film's frames, although "
        "as much moves there as in the others: check whether some keypoints are missing"
    ]


def without_record(camera: str, recorded: Integer[np.ndarray, " P"], frames: int, gap_frames: float) -> list[str]:
    """A warning that names the frames of a film of ``frames`` without a record, where more than ``gap_frames`` follow
    each other: no track bridges them."""
    known = np.concatenate([[-1], recorded, [frames]])
    gaps = [(a + 1, b - 1) for a, b in pairwise(known.tolist()) if b - a - 1 > gap_frames]
    if not gaps:
        return []
    listed = ", ".join(f"{first}–{last}" for first, last in gaps[:3])
    more = f" and {len(gaps) - 3} more stretches" if len(gaps) > 3 else ""
    return [
        f"the keypoints of camera {camera} have no entry for frames {listed}{more} of its film's {frames}: check "
        "whether a file is missing"
    ]


def without_match(
    camera: str, frame: Integer[np.ndarray, " S"], lift: Num[np.ndarray, " S"], chance: float, fits: float
) -> list[str]:
    """A warning where keypoints match the motion no better than ``chance`` in a stretch of the frames, and ``fits`` or
    more in the others; ``lift`` of every ``frame``, NaN unknown.

    The stretch is the one whose mean differs most from that of the others, by the variance between the two.
    """
    known = np.isfinite(lift)
    frame, lift = frame[known], lift[known]
    stops = np.arange(len(lift) + 1)
    inside = stops - stops[:, None]
    inside = np.where((inside >= MIN_FRAMES) & (len(lift) - inside >= MIN_FRAMES), inside, 0)
    if not inside.any():
        return []
    outside = len(lift) - inside
    total = np.concatenate([[0.0], np.cumsum(lift)])
    there = (total - total[:, None]) / np.maximum(inside, 1)
    elsewhere = (total[-1] - inside * there) / outside
    apart = inside * outside * (elsewhere - there).clip(0) ** 2
    first, stop = np.unravel_index(int(np.argmax(apart)), apart.shape)
    if not (there[first, stop] < chance and elsewhere[first, stop] > fits):
        return []
    return [
        f"the keypoints of camera {camera} match the motion in its pictures, except in frames {frame[first]}–"
        f"{frame[stop - 1]}: check whether those are of another camera or take"
    ]


def with_missing_frames(camera: str, change: ShiftChange | None, sigmas: float, chance: float) -> list[str]:
    """A warning where film or keypoints lack frames at one place, by ``sigmas`` or more; a part whose lift is
    ``chance`` shows other people."""
    if change is None or change.sigmas < sigmas or change.lift < chance:
        return []
    lacks, repeat = (
        ("its keypoints lack", "the film repeats") if change.frames > 0 else ("the film lacks", "its keypoints repeat")
    )
    count = abs(change.frames)
    return [
        f"the keypoints of camera {camera} match the motion in its pictures, but from about frame {change.frame} on "
        f"with {count} frames' difference: {lacks} about {count} frames there, or {repeat} them; bring "
        f"keypoints of this very film, or use the frames before (frames: {{first: 0, count: {change.frame}}} in "
        "capture.yaml)"
    ]


def upside_down(camera: str, keypoints: Num[np.ndarray, "D K 3"], names: Sequence[str]) -> list[str]:
    """A warning that everybody is upside down, where the film does not show whether they are."""
    lower = is_upside_down(keypoints, names)
    if len(lower) < 10 or lower.mean() < _MIN_UPSIDE_DOWN:
        return []
    return [
        f"{lower.mean():.0%} of the people in the keypoints of camera {camera} have their head below their feet, "
        "and its pictures do not show whether that is right: check that y is counted from the top"
    ]
