# SPDX-License-Identifier: Apache-2.0
"""Scores recorded keypoints against the film's motion under possible readings of their numbers.

One measurement covers every mix-up: the numbering, the unit and size of the picture, mirrored and turned pictures,
exchanged coordinates, another camera's film. A moving person changes the picture only where they are. The *lift* of a
reading is how much nearer to motion its keypoints are in their own frames than in others: 0 for chance, 1 at best. A
person who does not move gives no evidence and no verdict.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.special import ndtri, stdtr

from studiorecon.keypoints.coordinate_readings import apply_reading
from studiorecon.keypoints.motion import Motion

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num

# Keypoints with a higher confidence count, of the body only: layouts list hands and faces last.
_SURE, _BODY_POINTS = 0.3, 26
# A position that a body covers in more than this share of the frames is no evidence: a person there is the usual state.
_USUAL_SHARE = 0.4
# With fewer keypoints or frames than this a score decides nothing.
MIN_POINTS, MIN_FRAMES = 60, 8
# Frames that may be missing at one place; after a longer gap keypoints match no better than those of another take.
MAX_MISSING = 15
# A smaller shift is a detector's smoothing; so is this one of all frames.
MIN_SHIFT, _SMOOTHING = 2, 1
# Side of the grid on which bodies are drawn to detect who moves.
_GRID = 64


@dataclass(frozen=True)
class Score:
    """How well keypoints fit a film under one reading.

    Attributes:
        lift: mean over frames; 0 where there are none.
        hit: share of the keypoints that are on motion.
        per_frame: lift in every examined frame of the film; NaN where no keypoint counts.
        points: how many keypoints count.
    """

    lift: float
    hit: float
    per_frame: Float[np.ndarray, " S"]
    points: int

    @property
    def enough(self) -> bool:
        """Whether it rests on enough keypoints and frames."""
        return self.points >= MIN_POINTS and int(np.isfinite(self.per_frame).sum()) >= MIN_FRAMES

    @property
    def sigmas(self) -> float:
        """By how many standard deviations the lift is above chance."""
        return _sigmas(self.per_frame)

    def over(self, other: Score) -> float:
        """By how many standard deviations this one is better than another, in frames that both have."""
        return _sigmas(self.per_frame - other.per_frame)


def _sigmas(values: np.ndarray) -> float:
    """Mean over standard deviation of the mean; neighbouring frames are correlated, so frames count in pairs."""
    known = values[np.isfinite(values)]
    if len(known) < MIN_FRAMES:
        return 0.0
    pairs = known[: len(known) // 2 * 2].reshape(-1, 2).mean(-1)
    spread = float(pairs.std(ddof=1)) / np.sqrt(len(pairs))
    return float(known.mean()) / max(spread, 1e-3)


def _normal_sigmas(values: np.ndarray) -> float:
    """The deviation of a normal distribution that is as rare as the mean: that of few frames is Student's."""
    pairs = int(np.isfinite(values).sum()) // 2
    return float(-ndtri(stdtr(pairs - 1, -_sigmas(values)))) if pairs > 1 else 0.0


@dataclass(frozen=True)
class Movers:
    """N keypoints, as recorded, of people who move, one per row; ``person``: index of each one's detection."""

    person: Integer[np.ndarray, " N"]
    points: Float[np.ndarray, "N 2"]


def moving_keypoints(keypoints: Num[np.ndarray, "D K 3"], frame: Integer[np.ndarray, " D"]) -> Movers:
    """The confident keypoints at positions that bodies seldom cover, in any unit."""
    body = keypoints[:, :_BODY_POINTS]
    sure = np.isfinite(body).all(-1) & (body[..., 2] > _SURE) & (body[..., :2] != 0).any(-1)
    person, which = np.nonzero(sure)
    points = body[person, which, :2]
    if not len(points):
        return Movers(person, points)
    low, high = points.min(0), points.max(0)
    grid = np.clip((points - low) / np.maximum(high - low, 1e-9) * (_GRID - 1), 0, _GRID - 1).round().astype(np.int32)
    covered = _covered(grid, person, frame)
    return Movers(*(a[covered[grid[:, 1], grid[:, 0]] <= _USUAL_SHARE] for a in (person, points)))


def _covered(grid: np.ndarray, person: np.ndarray, frame: np.ndarray) -> Float[np.ndarray, "G G"]:
    """Share of up to 64 frames in which a person's outline covers a cell."""
    frames = np.unique(frame)
    chosen = frames[np.unique(np.linspace(0, len(frames) - 1, 64).round().astype(int))]
    total = np.zeros((_GRID, _GRID))
    for one in chosen:
        drawn = np.zeros((_GRID, _GRID), np.uint8)
        for who in np.flatnonzero(frame == one):
            outline = grid[person == who]
            if len(outline):
                cv2.fillConvexPoly(drawn, cv2.convexHull(outline), 1)
        total += drawn
    return total / len(chosen)


def score_reading(
    moving: Movers, frame: Integer[np.ndarray, " D"], film_from_recorded: Num[np.ndarray, "2 3"], motion: Motion
) -> Score:
    """How well ``moving`` fit ``motion`` if detection d shows frame ``frame[d]`` of the film and the map is right."""
    shown = frame[moving.person] if len(moving.person) else np.zeros(0, np.int64)
    sample = np.clip(np.searchsorted(motion.frame, shown), 0, len(motion.frame) - 1)
    counted = motion.frame[sample] == shown
    sample = sample[counted]
    here = motion.at(sample, apply_reading(film_from_recorded, moving.points[counted]))
    number = np.bincount(sample, minlength=len(motion.frame))
    lift = np.bincount(sample, here[:, 0] - here[:, 1], minlength=len(motion.frame))
    per_frame = np.where(number > 0, lift / np.maximum(number, 1), np.nan)
    if not len(sample):
        return Score(0.0, 0.0, per_frame, 0)
    return Score(float(np.nanmean(per_frame)), float(here[:, 0].mean()), per_frame, len(sample))


@dataclass(frozen=True)
class ShiftChange:
    """From film frame ``frame`` on keypoints fit the film ``frames`` frames later than before; ``sigmas``: by how many
    standard deviations each part prefers its own shift; ``lift``: of the part that fits worse."""

    frame: int
    frames: int
    sigmas: float
    lift: float


def shift_change(
    frame: Integer[np.ndarray, " S"], lift: Mapping[int, Float[np.ndarray, " S"]], usual: int
) -> ShiftChange | None:
    """The likeliest change of shift within a film; None where it is too short.

    ``lift``: of every shift within ``MAX_MISSING`` + 1 of ``usual``, the best one for all frames, per examined frame;
    unknown ones are NaN and count as chance.
    """
    cuts = np.arange(MIN_FRAMES, len(frame) - MIN_FRAMES + 1)
    best: tuple[float, ShiftChange] | None = None
    for main in range(usual - _SMOOTHING, usual + _SMOOTHING + 1):
        for missing in (m for m in range(-MAX_MISSING, MAX_MISSING + 1) if len(cuts) and abs(m) >= MIN_SHIFT):
            gain = lift[main + missing] - lift[main]
            before = np.nan_to_num(gain).cumsum()
            of_all = float(np.nansum(lift[main] - lift[usual]))
            for later, total in ((True, before[-1] - before[cuts - 1]), (False, before[cuts - 1])):
                cut = int(cuts[np.argmax(total)])
                if best is None or of_all + total.max() > best[0]:
                    there, rest = (gain[cut:], gain[:cut]) if later else (gain[:cut], gain[cut:])
                    sigmas = min(_normal_sigmas(there), _normal_sigmas(-rest))
                    shifts = (main, main + missing) if later else (main + missing, main)
                    parts = lift[shifts[0]][:cut], lift[shifts[1]][cut:]
                    worse = min(float(part[np.isfinite(part)].sum()) / len(part) for part in parts)
                    change = ShiftChange(int(frame[cut]), shifts[0] - shifts[1], sigmas, worse)
                    best = of_all + total.max(), change
    return None if best is None else best[1]


def best_score(scores: Iterable[tuple[int, Score]]) -> tuple[int, Score]:
    """The index and score of the largest lift; the first of equal ones."""
    return max(scores, key=lambda one: one[1].lift)


def is_upside_down(keypoints: Num[np.ndarray, "D K 3"], names: Sequence[str]) -> Bool[np.ndarray, " D"]:
    """Detections with head and both ankles seen whose head is lower."""
    at = {name: k for k, name in enumerate(names)}
    if not {"nose", "left_ankle", "right_ankle"} <= at.keys():
        return np.zeros(0, bool)
    parts = keypoints[:, [at["nose"], at["left_ankle"], at["right_ankle"]]]
    seen = (parts[..., 2] > _SURE).all(-1)
    return parts[seen, 0, 1] > parts[seen, 1:, 1].max(-1)


def is_frozen(keypoints: Num[np.ndarray, "D K 3"], frame: Integer[np.ndarray, " D"]) -> bool:
    """Whether every picture has exactly the same numbers, which no detector's output on a film has."""
    frames, count = np.unique(frame, return_counts=True)
    if len(frames) < MIN_FRAMES or len(set(count.tolist())) > 1:
        return False
    stacked = keypoints.reshape(len(frames), -1)
    return bool(np.array_equal(stacked, np.broadcast_to(stacked[:1], stacked.shape), equal_nan=True))
