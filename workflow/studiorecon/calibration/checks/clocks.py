# SPDX-License-Identifier: Apache-2.0
"""Checks whether the cameras' clocks agree: if so, people's rays meet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from studiorecon.keypoints.correspondence import (
    group_affinity,
    ray_directions,
    stable_detections,
    track_graph,
    track_groups,
)
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

# Largest error of a calibration where people are, metres: a constant gap between rays below it is no evidence about
# clocks.
_CALIBRATION_M = 0.03
_MIN_FRAMES = 8
_MIN_SINE = 0.1
# Lags inside the interval lose at most this in twice log-likelihood (95 %), plus the effect of chance on the best of a
# dozen lags: N gaps of noise, paired differently at every lag, differ by the root of N.
_INTERVAL = 4.0
_CHANCE = 4.0
# Shutters of synchronised cameras differ by up to half a frame, and only whole frames can be cut.
_HALF_FRAME = 0.5
_Groups = list[list[tuple[int, int]]]


@dataclass(frozen=True)
class KeypointLag:
    """Number of frames by which a camera's keypoints lag the others' (positive: later), with its 95 % interval.

    ``valid`` is False where the people moved too little, or where the best lag is at the end of the search.
    """

    camera: str
    frames: float
    low: float
    high: float
    valid: bool


def lags(detections: Sequence[Detections], cameras: Sequence[Camera], search: int, gate_m: float) -> list[KeypointLag]:
    """The lag of every camera at which its rays best meet the others', for the same people at all lags.

    A wrong lag makes the signed gap between two rays follow the joint's speed; a wrong calibration makes it constant.
    So the gap's spread over time counts fully, its mean only against 3 cm of calibration error. A detector's errors in
    neighbouring frames are correlated: frames count by the autocorrelation of their gaps. Against several cameras the
    median counts, so that one late camera makes no other one late.
    """
    stable = stable_detections(detections)
    rays = [ray_directions(d.keypoints, c) for d, c in zip(stable, cameras)]
    groups = _groups(stable, cameras, gate_m)[0]
    found = []
    for v, d in enumerate(stable):
        mine = groups if _has(groups, v) else _groups_of_a_late_camera(stable, cameras, v, search, gate_m)
        found.append(_lag_from_costs(d.camera, *_costs(stable, cameras, rays, v, mine, search), search))
    return found


def _lag_from_costs(camera: str, cost: np.ndarray, count: float, search: int) -> KeypointLag:
    shifts, slack = np.arange(-search, search + 1), _INTERVAL + _CHANCE * np.sqrt(count)
    best = int(np.argmin(cost))
    fine = np.linspace(-search, search, 40 * search + 1)
    near = fine[np.interp(fine, shifts, cost) <= cost[best] + slack]
    if best in (0, len(shifts) - 1) or near[-1] - near[0] > search:
        return KeypointLag(camera, 0.0, float(-search), float(search), False)
    before, at, after = cost[best - 1 : best + 2]
    lag = shifts[best] + 0.5 * (before - after) / max(before - 2 * at + after, 1e-12)
    return KeypointLag(
        camera, float(lag), float(min(near[0], lag - _HALF_FRAME)), float(max(near[-1], lag + _HALF_FRAME)), True
    )


def _has(groups: _Groups, view: int) -> bool:
    return any(v == view for group in groups for v, _ in group)


def _groups(stable: Sequence[Detections], cameras: Sequence[Camera], gate_m: float) -> tuple[_Groups, float]:
    """(view, track) of every person whom several cameras see, and their summed affinity."""
    graph = track_graph(stable, cameras)
    groups = track_groups(graph.distance_m, graph.view, graph.moments, gate_m)
    affinity = sum(group_affinity(g, graph.distance_m, gate_m) * len(g) for g in groups)
    return [[(int(graph.view[i]), int(graph.track[i])) for i in g] for g in groups], affinity


def _groups_of_a_late_camera(
    stable: Sequence[Detections], cameras: Sequence[Camera], view: int, search: int, gate_m: float
) -> _Groups:
    """Groups at the shift of camera ``view`` with the best agreement of all cameras."""
    tried = []
    for shift in range(-search, search + 1):
        moved = [replace(d, frame=d.frame - shift) if v == view else d for v, d in enumerate(stable)]
        tried.append(_groups(moved, cameras, gate_m))
    return max(tried, key=lambda found: found[1])[0]


def _costs(
    stable: Sequence[Detections],
    cameras: Sequence[Camera],
    rays: Sequence[tuple[np.ndarray, np.ndarray]],
    view: int,
    groups: _Groups,
    search: int,
) -> tuple[np.ndarray, float]:
    """(2 search + 1,) twice the negative log-likelihood of every lag of camera ``view``, the median over views, and
    their count."""
    nothing = np.zeros(2 * search + 1)
    cost, count = dict.fromkeys(range(len(cameras)), nothing), dict.fromkeys(range(len(cameras)), 0.0)
    for group in groups:
        # Tracks of one camera in a group are one person at different times: however often a track broke off, they are
        # one series.
        series = {v: _series(stable[v], [t for w, t in group if w == v]) for v in {v for v, _ in group}}
        for other in series if view in series else ():
            if other != view:
                gaps = _gaps(cameras, rays, (view, series[view]), (other, series[other]), search)
                misfit, gap_count = _misfit(gaps) if gaps.shape[1] >= _MIN_FRAMES else (nothing, 0.0)
                cost[other], count[other] = cost[other] + misfit, count[other] + gap_count
    heard = [v for v in count if count[v] > 0]
    if not heard:
        return nothing, 0.0
    return np.median([cost[v] - cost[v].min() for v in heard], axis=0), float(np.median([count[v] for v in heard]))


def _series(seen: Detections, tracks: Sequence[int]) -> dict[int, int]:
    """Frame → detection of some tracks of a camera, in the order of frames."""
    rows = np.flatnonzero(np.isin(seen.track, tracks))
    return {int(seen.frame[i]): int(i) for i in rows[np.argsort(seen.frame[rows], kind="stable")]}


def _gaps(
    cameras: Sequence[Camera],
    rays: Sequence[tuple[np.ndarray, np.ndarray]],
    own: tuple[int, dict[int, int]],
    other: tuple[int, dict[int, int]],
    search: int,
) -> np.ndarray:
    """(2 search + 1, T, 12) signed gaps between rays of two (view, series), metres, NaN unknown.

    The T frames have partners at all lags.
    """
    shifts = range(-search, search + 1)
    frames = [f for f in own[1] if all(f - s in other[1] for s in shifts)]
    mine = np.array([own[1][f] for f in frames], dtype=int)
    partners = np.array([[other[1][f - s] for f in frames] for s in shifts], dtype=int)
    first, second = rays[own[0]][0][mine][None], rays[other[0]][0][partners]
    across = np.cross(first, second)
    sine = np.linalg.norm(across, axis=-1)
    known = (rays[own[0]][1][mine][None] & rays[other[0]][1][partners] & (sine > _MIN_SINE)).all(0)
    gap = across @ (cameras[other[0]].centre_m - cameras[own[0]].centre_m) / np.where(sine > _MIN_SINE, sine, 1.0)
    return np.where(known, gap, np.nan)


def _misfit(gaps: np.ndarray) -> tuple[np.ndarray, float]:
    """(S,) twice the negative log-likelihood of gaps (S, T, K) up to a constant, and their number of independent
    samples."""
    known = np.isfinite(gaps[0])
    joints = known.sum(0) >= _MIN_FRAMES
    if not joints.any():
        return np.zeros(len(gaps)), 0.0
    gaps, known = gaps[..., joints], known[:, joints]
    mean = np.nanmedian(gaps, axis=1)
    rest = np.where(known, gaps - mean[:, None], 0.0)
    scale = 1.4826 * np.array([np.median(np.abs(r[known])) for r in rest]) + 1e-6
    clipped = np.clip(rest, -3 * scale[:, None, None], 3 * scale[:, None, None])
    variance = (clipped**2).sum((1, 2)) / known.sum() + 1e-8
    best = clipped[int(np.argmin(variance))]
    both = known[1:] & known[:-1]
    alike = float(np.clip((best[1:] * best[:-1])[both].sum() / max((best**2).sum(), 1e-12), 0.0, 0.95))
    count = known.sum() * (1 - alike) / (1 + alike)
    return count * np.log(variance) + mean.mean(1) ** 2 / (_CALIBRATION_M**2 + variance / count), float(count)
