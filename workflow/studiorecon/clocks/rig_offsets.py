# SPDX-License-Identifier: Apache-2.0
"""Clocks from all calibrated cameras at once: a late camera sees people at earlier positions.

Two cameras cannot separate a calibration error of centimetres from the lag of a person who walks on. All cameras
together are first refined on the people; the remaining shift along people's motion is time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import evenly_spread
from studiorecon.clocks.timeline import common_moments
from studiorecon.geometry.triangulation import Limits, triangulate, unit_px
from studiorecon.keypoints.detections import to_pinhole
from studiorecon.keypoints.resampling import resample_keypoints
from studiorecon.rig.bundle import AgreementLimits, CalibrationPrior, fit_cameras
from studiorecon.rig.correspondences import Observations, make_observations
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.clocks import Clock
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float, Num

# Number of moments in use, and distance to either side over which speeds are measured.
_MOMENTS, _BESIDE_S = 64, 0.1
_ROUNDS, _SETTLED_S, _NEARLY_SETTLED_S, _LOOKED_BACK = 10, 0.001, 0.005, 4
# A detector's bias along the direction of motion (1 σ), which looks like a lag. In four scenes lags were off by 7 ms
# (rms) and at most 16 ms, at about a metre a second.
_BESIDE_M = 0.01
# A camera's lag must be so many sigmas, and joints must fit better by this share with all lags.
_SIGMAS, _GAIN = 2.0, 0.1
# Fewer points are no evidence. Neither are points whose stretches of time differ by more than the first sigma on the
# way or the second in the end: such a camera sees other people. Little motion is no evidence either.
_MIN_POINTS, _MAX_SPREAD_S, _MAX_SPREAD_LEFT_S, _MAX_SIGMA_S = 100, 0.04, 0.015, 0.04
# Stretches of time that are left out in turn to estimate a lag's sigma.
_STRETCH_S = 0.5
_LOOSE = 3.0
_STEPS = 10


@dataclass(frozen=True)
class RigOffsets:
    """Seconds (V,) by which to set the cameras' clocks later, and one sigma; NaN: unknown."""

    seconds: Float[np.ndarray, " V"]
    sigma_s: Float[np.ndarray, " V"]


def offsets_vs_rig(
    clocks: Sequence[Clock], seen: Sequence[Detections], lenses: Mapping[str, tuple[Lens, tuple[int, int]]]
) -> RigOffsets | None:
    """Lags of the cameras with a calibrated lens (and footage size) and detections (by source frames), by the current
    clocks.

    None where fewer than three such cameras exist, clocks do not converge, or some are clearly late and joints fit
    hardly better for it.
    """
    with_people = {d.camera: d for d in seen if len(d.frame)}
    index = [i for i, c in enumerate(clocks) if c.camera in with_people and c.camera in lenses]
    if len(index) < 3:
        return None
    mine = [clocks[i] for i in index]
    asked = [with_people[c.camera] for c in mine]
    added, looked = np.zeros(len(mine)), list[_Looked]()
    cameras: list[Camera] = []
    for _ in range(_ROUNDS):
        set_so = [replace(c, offset_s=c.offset_s + a) for c, a in zip(mine, added)]
        placed = _placed(set_so, asked, cameras, lenses)
        if placed is None:
            return None
        cameras = placed.cameras
        looked.append(_Looked(added, *_lateness(placed), placed.misfit))
        if not np.isfinite(looked[-1].late_s).any():
            return None
        if looked[-1].left_s < _SETTLED_S:
            break
        added = _next(looked[-_LOOKED_BACK:])
    last = min(looked, key=lambda one: one.left_s)
    sure = (last.spread_s <= _MAX_SPREAD_LEFT_S) & (last.sigma_s <= _MAX_SIGMA_S)
    clearly = (np.abs(last.added_s[sure]) > _SIGMAS * last.sigma_s[sure]).any()
    if last.left_s > _NEARLY_SETTLED_S or (clearly and not last.misfit < (1 - _GAIN) * looked[0].misfit):
        return None
    seconds, sigma = np.full((2, len(clocks)), np.nan)
    seconds[index], sigma[index] = np.where(sure, last.added_s, np.nan), np.where(sure, last.sigma_s, np.nan)
    return RigOffsets(seconds, sigma)


@dataclass(frozen=True)
class _Placed:
    """Cameras refined on people at some clocks, their observations at ``fps``, and their misfit."""

    cameras: list[Camera]
    seen: Observations
    fps: float
    misfit: float


@dataclass(frozen=True)
class _Looked:
    """Lags that remain with ``added_s`` on the clocks, their spread over stretches of time, their total sigma, and the
    misfit.

    The total sigma includes constant errors.
    """

    added_s: np.ndarray
    late_s: np.ndarray
    spread_s: np.ndarray
    sigma_s: np.ndarray
    misfit: float

    @property
    def left_s(self) -> float:
        return float(np.nanmax(np.abs(self.late_s)))


def _next(looked: Sequence[_Looked]) -> np.ndarray:
    """(V,) the next correction (Anderson, "Iterative procedures for nonlinear integral equations", J. ACM 12, 1965).

    Cameras that are rotated to fit wrong clocks absorb most of a lag, so plain steps converge slowly.
    """
    added, late = np.array([one.added_s for one in looked]), np.nan_to_num([one.late_s for one in looked])
    if len(looked) < 2:
        return added[-1] + late[-1]
    steps, changes = np.diff(added, axis=0).T, np.diff(late, axis=0).T
    shares = np.linalg.lstsq(changes, late[-1], rcond=1e-3)[0]
    return added[-1] + late[-1] - (steps + changes) @ shares


def _placed(
    clocks: Sequence[Clock],
    asked: Sequence[Detections],
    start: Sequence[Camera],
    lenses: Mapping[str, tuple[Lens, tuple[int, int]]],
) -> _Placed | None:
    """Cameras refined on people at ``clocks``. ``start``: approximate cameras for the identities; by default the
    calibrated ones."""
    moments = common_moments(clocks, 0, 0)
    beside = max(1, round(_BESIDE_S * moments.fps))
    if moments.frames <= 2 * beside + 1:
        return None
    timed = [resample_keypoints(d, moments, lenses[d.camera][1][1]) for d in asked]
    given, on = zip(*(to_pinhole(d, *lenses[d.camera]) for d in timed))
    middle = evenly_spread(moments.frames - 2 * beside, _MOMENTS) + beside
    frames = np.unique(np.concatenate([middle - beside, middle, middle + beside]))
    agreement = AgreementLimits()
    observations, _ = make_observations(on, start or given, frames, agreement.gate_m)
    if not len(observations.frame):
        return None
    # The moments on either side of the middle one only measure speeds.
    adjusted = fit_cameras(
        given, observations.of(np.isin(observations.frame, middle)), agreement.limits, CalibrationPrior().bundle
    )
    # Where people give too little evidence, cameras stay at their poses.
    cameras = adjusted.cameras if adjusted else list(start or given)
    observations, _ = make_observations(on, cameras, frames, agreement.gate_m)
    return _Placed(cameras, observations, moments.fps, _misfit(cameras, observations, agreement.limits))


def _misfit(cameras: Sequence[Camera], seen: Observations, limits: Limits) -> float:
    """Mean error of all observations, in error units; outliers count as the outlier limit."""
    found = triangulate(seen.pixels, seen.confidence, cameras, limits)
    counted = found.verified if len(cameras) > 2 else found.valid
    units = np.where(counted, found.error_px, np.nan) / unit_px(cameras, limits)[:, None]
    error = np.minimum(np.nan_to_num(units, nan=limits.outlier_units), limits.outlier_units)
    return float(error[np.isfinite(seen.pixels[..., 0])].mean())


def _lateness(placed: _Placed) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(V,) seconds by which each camera sees joints ahead of the others, median 0, with two sigmas; NaN without
    evidence.

    The first sigma is their spread over stretches of time, the second includes constant errors.
    """
    cameras, seen, fps = placed.cameras, placed.seen, placed.fps
    limits = AgreementLimits().limits
    wide = replace(limits, outlier_units=limits.outlier_units * _LOOSE)
    beside = max(1, round(_BESIDE_S * fps))
    names = list(zip(seen.group.tolist(), seen.keypoint.tolist(), seen.frame.tolist()))
    place = {name: i for i, name in enumerate(names)}
    before, after = (np.array([place.get((g, k, f + way), -1) for g, k, f in names]) for way in (-beside, beside))
    both = (before >= 0) & (after >= 0)
    late, spread, sigma = np.full((3, len(cameras)), np.nan)
    for v, camera in enumerate(cameras):
        rest = [k for k in range(len(cameras)) if k != v]
        found = triangulate(seen.pixels[rest], seen.confidence[rest], [cameras[k] for k in rest], wide)
        points_m = np.where((found.verified if len(rest) > 2 else found.valid)[:, None], found.points_m, np.nan)
        step_m = np.where(both[:, None], (points_m[after] - points_m[before]) / 2, np.nan)
        here, ahead, behind = (camera.project(points_m + way * step_m)[0] for way in (0, 1, -1))
        per_s = (ahead - behind) * fps / (2 * beside)
        off = seen.pixels[v] - here
        known = np.isfinite(off).all(-1) & np.isfinite(per_s).all(-1)
        if known.sum() < _MIN_POINTS:
            continue
        stretch = seen.frame[known] // max(1, round(_STRETCH_S * fps))
        seconds, spread_s = _slope(off[known], per_s[known], stretch, float(unit_px([camera], limits)[0]))
        speed_m = np.linalg.norm(step_m[known], axis=-1) * fps / beside
        if spread_s <= _MAX_SPREAD_S:
            lasting_s = _BESIDE_M / max(float(np.sqrt(np.mean(speed_m**2))), 1e-9)
            late[v], spread[v], sigma[v] = seconds, spread_s, np.hypot(spread_s, lasting_s)
    if np.isfinite(late).any():
        late -= np.nanmedian(late)
    return late, spread, sigma


def _slope(
    off: Num[np.ndarray, "N 2"], per_s: Num[np.ndarray, "N 2"], stretch: Num[np.ndarray, " N"], unit: float
) -> tuple[float, float]:
    """The seconds that explain pixels ``off`` at speeds ``per_s``, and their jackknife sigma over the stretches of
    time.

    By least absolute distances beyond ``unit``; the sigma is inf for a single stretch.
    """
    seconds = 0.0
    for _ in range(_STEPS):
        weight = 1 / np.maximum(np.linalg.norm(off - seconds * per_s, axis=-1), unit)
        along, square = weight * (off * per_s).sum(-1), weight * (per_s**2).sum(-1)
        seconds = float(along.sum() / max(square.sum(), 1e-12))
    names, of = np.unique(stretch, return_inverse=True)
    count = len(names)
    if count < 2:
        return seconds, float("inf")
    left = (along.sum() - np.bincount(of, along)) / np.maximum(square.sum() - np.bincount(of, square), 1e-12)
    return seconds, float(np.sqrt((count - 1) / count * ((left - left.mean()) ** 2).sum()))
