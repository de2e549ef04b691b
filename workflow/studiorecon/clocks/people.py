# SPDX-License-Identifier: Apache-2.0
"""Lags from people: at the right lag, keypoints of one person in two cameras fit one epipolar geometry.

With a calibration, that geometry is near the calibrated one. Without, or where the calibration is far off, it is free.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.clocks.epipolar import (
    MOMENT_S,
    NOISE,
    Geometry,
    Meeting,
    fit_lags,
    lag_between_frames,
    lag_matrices,
    squared_error,
)
from studiorecon.clocks.posterior import Lag, Source, lag_from_gains
from studiorecon.geometry.lens import calibration_from_video_pixels, normalised_from_calibration
from studiorecon.keypoints.correspondence import stable_detections
from studiorecon.scene.camera import Lens
from studiorecon.scene.clocks import Clock
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float

# A joint seems ahead where a detector is late, at a metre a second: 1.5 mm (1 sigma). Poses that are off by a degree
# shift the lags of their cameras by 5 mm more.
FREE, CALIBRATED = Source("people", bias_s=0.0015), Source("people", bias_s=0.005)
# Share of pairs of cameras in which two people who walk alike are taken for one.
_OUTLIER_PROBABILITY = 0.005
# Share of pairs of tracks that show one person, and of calibrations that are further off than their prior.
_SAME, _MISCALIBRATED = 0.3, 0.1
# Median error of another person's joints under a calibration, body heights.
_OTHERS = 0.1
# Least confidence of keypoints, number of longest tracks per camera, and least length of a track and of an overlap.
_SURE = 0.3
_TRACKS = 6
_MIN_S, _MIN_SHARE = 1.0, 0.3
# Fewer pairs of keypoints at a lag fit some geometry by chance: F has seven unknowns.
_MIN_PAIRS = 100
# Lags so near each other are one; further off, the same geometry must fit worse, or nobody moves.
_APART_S = 0.3

Lenses = Mapping[str, tuple[Lens, tuple[int, int]]]
"""camera → its calibrated lens, and the size of its footage."""


@dataclass(frozen=True)
class View:
    """One camera's longest tracks: first row and keypoints, in body heights about their mean, homogeneous, NaN where
    missing; ``to_rays`` maps them to rays of ``camera_from_world``, where it is calibrated."""

    tracks: list[tuple[int, Float[np.ndarray, "T J 3"]]]
    to_rays: Float[np.ndarray, "3 3"]
    camera_from_world: Float[np.ndarray, "4 4"] | None


def people_lags(
    seen: Sequence[Detections], clocks: Sequence[Clock], rate: float, lenses: Lenses | None = None
) -> tuple[list[Lag], dict[int, str]]:
    """Lags of the cameras whose keypoints (by source frames) determine one, and the reason for every camera without
    one.

    Times are at ``rate`` per second; ``lenses`` are those of a given calibration.
    """
    index = {c.camera: i for i, c in enumerate(clocks)}
    views = {index[d.camera]: _view(d, clocks[index[d.camera]], rate, lenses or {}) for d in stable_detections(seen)}
    sighted = [i for i in sorted(views) if views[i].tracks]
    reasons = {
        i: "it has no keypoints" if i not in views else "no person is visible long enough" for i in range(len(clocks))
    }
    reasons.update(dict.fromkeys(sighted, "no person in it moves enough to determine one offset"))
    lags = []
    for a, b in itertools.combinations(sighted, 2):
        found = pair_lag(views[a], views[b], rate)
        if found is not None:
            source, rows, sigma_rows, outliers = found
            lags.append(Lag(source, a, b, -rows / rate, sigma_rows / rate, outliers))
    for i in {c for lag in lags for c in (lag.first, lag.second)}:
        reasons.pop(i, None)
    return lags, reasons


def pair_lag(first: View, second: View, rate: float) -> tuple[Source, float, float, float] | None:
    """Source of the lag, rows by which the second camera lags the first, their sigma, and the probability that they are
    wrong; None where another lag, or none, is likelier."""
    meetings = [
        Meeting(one, other, begin_b - begin_a)
        for (begin_a, one), (begin_b, other) in itertools.product(first.tracks, second.tracks)
    ]
    priors: list[Geometry | None] = [None]
    if first.camera_from_world is not None and second.camera_from_world is not None:
        priors.append(Geometry.of(first.camera_from_world, second.camera_from_world, first.to_rays, second.to_rays))
    sums = [lag_matrices(m.first, m.second) for m in meetings]
    begins = [int(s[0][0]) + m.later for s, m in zip(sums, meetings)]
    lags = np.arange(min(begins), max(begin + len(s[0]) for begin, s in zip(begins, sums)))
    gains = np.zeros((len(priors), len(meetings), len(lags)))
    for k, (s, meeting) in enumerate(zip(sums, meetings)):
        place = begins[k] - int(lags[0])
        shorter = min(len(meeting.first), len(meeting.second))
        for g, prior in enumerate(priors):
            gains[g, k, place : place + len(s[0])] = _gain(*s, shorter, rate, prior)
    total = np.logaddexp(np.log(_SAME) + gains, np.log1p(-_SAME)).sum(1)
    share = [0.0] if len(priors) == 1 else [np.log(_MISCALIBRATED), np.log1p(-_MISCALIBRATED)]
    total += np.array(share)[:, None]
    gain = np.logaddexp.reduce(total, axis=0)
    rows, spread, outliers = lag_from_gains(lags, gain, max(2, _APART_S * rate), _OUTLIER_PROBABILITY)
    if outliers > 0.5:
        return None
    best = int(np.argmax(gain))
    g = int(np.argmax(total[:, best]))
    likeliest_first = [meetings[k] for k in np.argsort(-gains[g, :, best], kind="stable")]
    fine = lag_between_frames(likeliest_first, int(lags[best]), rate, priors[g])
    if fine is not None and abs(fine[0] - rows) <= max(2.0, 3 * spread):
        rows, spread = fine
    else:
        spread = max(spread, 0.5)
    return (FREE if len(priors) == 1 else CALIBRATED), rows, spread, max(outliers, _OUTLIER_PROBABILITY)


def _gain(
    lags: np.ndarray, matrices: np.ndarray, count: np.ndarray, shorter: int, rate: float, prior: Geometry | None
) -> np.ndarray:
    """(L,) log-likelihood of every lag of two tracks of one person, against tracks of two people."""
    overlap = np.minimum(shorter, np.minimum(lags - lags[0], lags[-1] - lags) + 1)
    usable = (overlap >= max(_MIN_S, _MIN_SHARE * shorter / rate) * rate) & (count >= _MIN_PAIRS)
    moments = overlap / (rate * MOMENT_S)
    fit = fit_lags(matrices, moments, prior)
    if not usable.any():
        return np.zeros(len(lags))
    reach = max(2, round(_APART_S * rate))
    beside = np.full(len(lags), np.inf)
    for step in (-reach, reach):
        moved = np.clip(np.arange(len(lags)) + step, 0, len(lags) - 1)
        beside = np.minimum(beside, np.where(usable[moved], squared_error(fit.form, matrices[moved]), np.inf))
    # Under a calibration, others are a tenth of a height away. A free geometry fits anybody somehow: there other lags
    # are the measure. Who does not move fits as well a moment later, which says nothing.
    others = float(np.median(fit.error[usable])) if prior is None else _OTHERS**2
    null = np.minimum(others, np.where(np.isfinite(beside), beside, 0.0))
    gain = moments / 2 * np.log((NOISE**2 + null) / (NOISE**2 + fit.error)) - fit.penalty / 2
    return np.where(usable, gain, 0.0)


def _view(seen: Detections, clock: Clock, rate: float, lenses: Lenses) -> View:
    known = lenses.get(seen.camera)
    pixels = seen.keypoints[..., :2]
    there = (seen.keypoints[..., 2] >= _SURE) & np.isfinite(pixels).all(-1)
    points = np.where(there[..., None], pixels, 1.0)
    if known is not None:
        lens, wh = known
        affine = calibration_from_video_pixels(lens, wh)
        points, valid = normalised_from_calibration(points @ affine[:, :2].T + affine[:, 2], lens)
        there &= valid
    points = np.where(there[..., None], points, np.nan)
    if not there.any():
        return View([], np.eye(3), None)
    middle = np.nanmean(points, axis=(0, 1))
    tall = np.where(there, points[..., 1], -np.inf).max(1) - np.where(there, points[..., 1], np.inf).min(1)
    height = float(np.median(tall[np.isfinite(tall)])) + 1e-12
    to_rays = np.array([[height, 0, middle[0]], [0, height, middle[1]], [0, 0, 1.0]])
    scaled = np.concatenate([(points - middle) / height, np.where(there[..., None], 1.0, np.nan)], axis=-1)
    pose = known[0].camera_from_world if known is not None else None
    return View(_longest(replace(seen, keypoints=scaled), clock, rate), to_rays, pose)


def _longest(seen: Detections, clock: Clock, rate: float) -> list[tuple[int, np.ndarray]]:
    """First row and keypoints of the longest tracks; rows of 1 / ``rate`` seconds."""
    even = not clock.times_s and abs(clock.fps - rate) < 1e-6
    own = clock.own_s
    inside = (seen.frame >= 0) & (seen.frame < len(own))
    frame, track, points = seen.frame[inside], seen.track[inside], seen.keypoints[inside]
    names, sizes = np.unique(track, return_counts=True)
    found = []
    for name in names[np.argsort(-sizes, kind="stable")][:_TRACKS]:
        mine = np.flatnonzero(track == name)
        if len(mine) < _MIN_S * clock.fps:
            break
        # Uneven frames go to the nearest row: late and early ones average out.
        row = frame[mine] if even else np.rint(own[frame[mine]] * rate).astype(int)
        dense = np.full((row.max() - row.min() + 1, *points.shape[1:]), np.nan)
        dense[row - row.min()] = points[mine]
        found.append((int(row.min()), dense))
    return found
