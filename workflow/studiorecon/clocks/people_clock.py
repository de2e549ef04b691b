# SPDX-License-Identifier: Apache-2.0
"""Lags between cameras from people: tracks of two cameras are compared, and those of one person agree on a lag.

With the user's calibration, its epipolar geometry is additional evidence.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from studiorecon.clocks.calibrated_lag import CalibratedPair, calibrated_lag, normalise_detections
from studiorecon.clocks.offset_consensus import Pair
from studiorecon.clocks.people_lag import Meeting, PeopleLag, joint_lag, track_lag
from studiorecon.keypoints.correspondence import stable_detections
from studiorecon.scene.camera import Lens
from studiorecon.scene.clocks import Clock
from studiorecon.scene.people import Detections

# Least confidence of keypoints, number of longest tracks per camera, and least length of a track.
_SURE = 0.3
_TRACKS = 6
_MIN_S = 1.0
# Lags of several tracks are one when they are this close, in frames or sigmas; other lags must weigh this much less.
_SAME_FRAMES, _SAME_SIGMAS = 1.5, 3.0
_MIN_WEIGHT = 1.5
# The second best lag must fit worse by this factor, over all tracks that agree on a lag. People who walk evenly or
# hardly move, and two different people, reached 2 to 6 on a synthetic take and a real one with a detector's keypoints,
# at false lags of up to 25 frames; people who turn and swing their arms had 20 to 110.
_MIN_RATIO = 10.0
# Without a calibration, tracks that agree must show bodies for so many seconds together, of so many joints. Two people
# who walk similarly for less fit some epipolar geometry a second and more off (0.8 s of them reached a ratio of 11).
_MIN_BODY_S, _JOINTS = 1.2, 12
# No detector's keypoints agree better than this from two sides, frames.
_FLOOR_FRAMES = 0.05


Lenses = Mapping[str, tuple[Lens, tuple[int, int]]]
"""camera → its calibrated lens, and the size of its footage."""


def people_pair(
    seen: Sequence[Detections], clocks: Sequence[Clock], rate: float, lenses: Lenses | None = None
) -> tuple[list[Pair], dict[int, str]]:
    """Pairs of cameras whose keypoints (by source frames) determine a lag, and the reason for every camera without one.

    Times are at ``rate`` per second. With the ``lenses`` of a given calibration there are two estimates: one with free
    epipolar geometry, one by the calibration. The calibration's counts where there is no other, or where it is the
    sharper of two that agree; where they disagree, the calibration is distrusted.
    """
    index = {c.camera: i for i, c in enumerate(clocks)}
    stable = stable_detections(seen)
    tracks = {index[d.camera]: _longest(d, clocks[index[d.camera]], rate) for d in stable}
    rays: dict[int, list[tuple[int, np.ndarray]]] = {}
    for d in stable:
        if lenses and d.camera in lenses:
            rays[index[d.camera]] = _longest(normalise_detections(d, *lenses[d.camera]), clocks[index[d.camera]], rate)
    sighted = [i for i in sorted(tracks) if tracks[i]]
    reasons = {
        i: "it has no keypoints" if i not in tracks else "no person is visible long enough" for i in range(len(clocks))
    }
    reasons.update(dict.fromkeys(sighted, "no person in it moves enough to determine one offset"))
    pairs = []
    for a, b in itertools.combinations(sighted, 2):
        met = [
            (first, second, begin_b - begin_a)
            for (begin_a, first), (begin_b, second) in itertools.product(tracks[a], tracks[b])
        ]
        lags = [track_lag(first, second, rate) for first, second, _ in met]
        found = [(lag.rows + later, lag) for lag, (*_, later) in zip(lags, met) if lag is not None]
        agreed = _together(_agreed(found, _MIN_BODY_S * _JOINTS * rate), lags, met)
        if lenses and a in rays and b in rays:
            pair = CalibratedPair.of(lenses[clocks[a].camera][0], lenses[clocks[b].camera][0])
            agreed = _sharper(agreed, _agreed(_by_calibration(rays[a], rays[b], rate, pair)))
        if agreed is not None:
            pairs.append(Pair(a, b, -agreed[0] / rate, agreed[1] / rate))
    for i in {c for p in pairs for c in (p.first, p.second)}:
        reasons.pop(i, None)
    return pairs, reasons


def _together(
    agreed: tuple[float, float] | None, lags: Sequence[PeopleLag | None], met: Sequence[Meeting]
) -> tuple[float, float] | None:
    """The lag on which tracks agreed, from all tracks of both cameras under one epipolar geometry.

    A few seconds of one track have too small a sigma.
    """
    if agreed is None:
        return None
    rows, sigma = agreed
    agree = [
        lag is not None and abs(lag.rows + later - rows) <= _near(lag.sigma_rows, sigma)
        for lag, (*_, later) in zip(lags, met)
    ]
    mine, others = [m for m, a in zip(met, agree) if a], [m for m, a in zip(met, agree) if not a]
    lag = joint_lag(mine, others, round(rows)) if mine else None
    if lag is None or abs(lag.rows - rows) > _near(lag.sigma_rows, sigma):
        return agreed
    return lag.rows, max(lag.sigma_rows, _FLOOR_FRAMES)


def _near(first_sigma: float, second_sigma: float) -> float:
    return max(_SAME_FRAMES, _SAME_SIGMAS * float(np.hypot(first_sigma, second_sigma)))


def _by_calibration(
    first: Sequence[tuple[int, np.ndarray]], second: Sequence[tuple[int, np.ndarray]], rate: float, pair: CalibratedPair
) -> list[tuple[float, PeopleLag]]:
    found = []
    for (begin_a, one), (begin_b, other) in itertools.product(first, second):
        lag = calibrated_lag(one, other, rate, pair)
        if lag is not None:
            found.append((lag.rows + begin_b - begin_a, lag))
    return found


def _sharper(free: tuple[float, float] | None, calibrated: tuple[float, float] | None) -> tuple[float, float] | None:
    """Rows and sigma of one of two estimates."""
    if free is None or calibrated is None:
        return free if calibrated is None else calibrated
    contradict = abs(free[0] - calibrated[0]) > _SAME_SIGMAS * np.hypot(free[1], calibrated[1])
    return free if contradict or free[1] <= calibrated[1] else calibrated


def _agreed(found: Sequence[tuple[float, PeopleLag]], least_points: float = 0.0) -> tuple[float, float] | None:
    """Rows and sigma of the lag with most of the evidence; None where two lags have much of it.

    Also None where it has fewer keypoints than ``least_points``.
    """
    if not found:
        return None
    rows = np.array([r for r, _ in found])
    sigma = np.maximum([lag.sigma_rows for _, lag in found], _FLOOR_FRAMES)
    weight = np.array([lag.points * np.log(lag.ratio) for _, lag in found])
    near = np.abs(rows[:, None] - rows) <= np.maximum(_SAME_FRAMES, _SAME_SIGMAS * np.hypot(sigma[:, None], sigma))
    best = int(np.argmax(near @ weight))
    others = ~near[best]
    if others.any() and (near[others] @ weight).max() * _MIN_WEIGHT > near[best] @ weight:
        return None
    mine = near[best]
    if sum(lag.points for (_, lag), agrees in zip(found, mine) if agrees) < least_points:
        return None
    if np.prod([lag.ratio for (_, lag), agrees in zip(found, mine) if agrees]) < _MIN_RATIO:
        return None
    share = 1 / sigma[mine] ** 2
    mean = float((share * rows[mine]).sum() / share.sum())
    # The scatter between tracks counts where it exceeds their own.
    chi = float((share * (rows[mine] - mean) ** 2).sum() / max(mine.sum() - 1, 1))
    return mean, float(max(np.sqrt(max(chi, 1.0) / share.sum()), _FLOOR_FRAMES))


def _longest(seen: Detections, clock: Clock, rate: float) -> list[tuple[int, np.ndarray]]:
    """First row and keypoints (T, J, 3), homogeneous, NaN where missing, of the longest tracks; rows of 1 / ``rate``
    seconds."""
    even = not clock.times_s and abs(clock.fps - rate) < 1e-6
    own = clock.own_s
    inside = (seen.frame >= 0) & (seen.frame < len(own))
    frame, track, keypoints = seen.frame[inside], seen.track[inside], seen.keypoints[inside]
    sure = (keypoints[..., 2] >= _SURE) & np.isfinite(keypoints[..., :2]).all(-1)
    points = np.where(sure[..., None], np.concatenate([keypoints[..., :2], np.ones((*sure.shape, 1))], -1), np.nan)
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
