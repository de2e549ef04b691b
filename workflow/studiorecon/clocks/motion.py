# SPDX-License-Identifier: Apache-2.0
"""Lags from motion: people move at the same moments in every camera, so the change of pictures over time is
correlated."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.clocks.posterior import (
    HALF,
    MAX_HALF_S,
    Lag,
    Source,
    choose_reference,
    estimate_offsets,
    lag_from_gains,
)
from studiorecon.footage.frames import small_grey
from studiorecon.footage.source import FootageSource
from studiorecon.scene.clocks import Clock

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

MOTION = Source("motion")
# A person who walks from camera to camera passes them one after the other: one lag of twenty is such a walk's.
_OUTLIER_PROBABILITY, _STRAY = 0.05, 0.03
# Pictures are shrunk to this width in pixels before differencing: keeps people, averages sensor and compression noise
# away.
_WIDTH = 160
# Grey levels of difference that noise still reaches after shrinking.
_NOISE_LEVELS = 3.0
# Slower changes show mostly which person is near a camera, not when.
_DETREND_S = 0.5
# Two views of one motion correlate no better: a higher value is no evidence.
_MAX_CORRELATION = 0.9
# One moment looks different from two sides: sigma of the distance between peaks of motion in synchronous cameras, and
# how far from the best lag others are still the same peak.
_VIEWS_S, _PEAK_S = 0.04, 0.3
_MIN_OVERLAP_S, _MIN_SHARE = 1.0, 0.5


@dataclass(frozen=True)
class MotionLag:
    """Rows (frames at the common rate) by which a second series lags a first one, and the probability that another lag,
    or none, is right."""

    rows: float
    sigma_rows: float
    outlier_probability: float
    reason: str = ""


def motion_energy(frames: Iterable[Integer[np.ndarray, "H W"]]) -> Iterator[float]:
    """The T - 1 mean absolute changes between successive grey frames (H, W) uint8 above the noise, in grey levels."""
    before = None
    for frame in frames:
        grey = frame.astype(np.float32)
        if before is not None:
            yield float(np.maximum(np.abs(grey - before) - _NOISE_LEVELS, 0).mean())
        before = grey


def read_motion_energy(source: FootageSource, seconds: float) -> Iterator[float]:
    """``motion_energy`` of the first ``seconds`` of footage, as far as it can be read."""
    return motion_energy(small_grey(source, _WIDTH, round(seconds * source.fps)))


def motion_lags(
    energies: Sequence[Float[np.ndarray, " T"]], clocks: Sequence[Clock], rate: float
) -> tuple[list[Lag], dict[int, str]]:
    """The lag of every camera to the reference by all pairs together, and the reason for every camera without one.

    Pairs are no independent evidence: who walks round the cameras passes all of them in turn. So a camera counts once.
    """
    rows = [_evenly_sampled(e, c, rate) for e, c in zip(energies, clocks)]
    pairs: list[Lag] = []
    reasons: dict[int, str] = {}
    for a, b in itertools.combinations(range(len(rows)), 2):
        lag = motion_lag(rows[a], rows[b], rate)
        if lag.outlier_probability < 0.5:
            pairs.append(Lag(MOTION, a, b, -lag.rows / rate, lag.sigma_rows / rate, lag.outlier_probability))
        else:
            reasons.setdefault(a, lag.reason)
            reasons.setdefault(b, lag.reason)
    reference = choose_reference(pairs, len(rows))
    lags = [
        Lag(MOTION, reference, c, offset.seconds, max(offset.half_s / HALF, _VIEWS_S, 0.5 / rate), _STRAY)
        for c, offset in enumerate(estimate_offsets(pairs, len(rows), reference))
        if c != reference and offset.half_s <= MAX_HALF_S
    ]
    for i in {c for lag in lags for c in (lag.first, lag.second)}:
        reasons.pop(i, None)
    return lags, reasons


def _evenly_sampled(energy: np.ndarray, clock: Clock, rate: float) -> np.ndarray:
    if len(energy) < 2 or (not clock.times_s and abs(clock.fps - rate) < 1e-6):
        return energy
    own = clock.own_s[: len(energy) + 1]
    middles = (own[1:] + own[:-1])[: len(energy)] / 2
    per_second = energy[: len(middles)] / np.maximum(np.diff(own)[: len(energy)], 1e-6) / rate
    return np.interp(np.arange(0.5 / rate, own[-1], 1 / rate), middles, per_second)


def motion_lag(first: Float[np.ndarray, " T"], second: Float[np.ndarray, " t"], rate: float) -> MotionLag:
    """The lag of two energies (T,) and (T',) at ``rate`` values per second, with a reason where nothing determines
    it."""
    if broken := int((~np.isfinite(first)).sum() + (~np.isfinite(second)).sum()):
        return _unknown(f"{broken} values of its motion are not finite")
    shorter = min(len(first), len(second))
    least = max(_MIN_OVERLAP_S * rate, _MIN_SHARE * shorter, 3)
    if shorter < least:
        return _unknown(f"{shorter / rate:.1f} s of motion are too short")
    if first.std() == 0 or second.std() == 0:
        return _unknown("nothing moves in one of the two pictures")
    # A person near the camera moves more pixels: the time counts, not the amount.
    slow, sigma = scipy.ndimage.gaussian_filter1d, _DETREND_S * rate
    a, b = (np.sqrt(e) - slow(np.sqrt(e), sigma, mode="nearest") for e in (first, second))
    lags, correlation, overlap = _correlations(a, b)
    # Bartlett: two series that repeat themselves in the same rhythm have few independent moments.
    alike = (_autocorrelation(a)[:shorter] * _autocorrelation(b)[:shorter])[1:]
    moments = overlap / (1 + 2 * np.maximum(alike, 0).sum())
    # Likelihood of a bivariate normal with this correlation against two series without any.
    gain = -0.5 * np.maximum(moments - 3, 0) * np.log1p(-(np.clip(correlation, 0, _MAX_CORRELATION) ** 2))
    allowed = overlap >= least
    gain = np.where(allowed, gain, -np.inf)
    best = int(np.argmax(gain))
    rows, spread, outliers = lag_from_gains(lags, gain, max(2, _PEAK_S * rate), _OUTLIER_PROBABILITY)
    # No difference of frames resolves half a frame.
    return MotionLag(
        rows,
        max(spread, _VIEWS_S * rate, 0.5),
        outliers,
        f"motion over time correlates at {correlation[best]:.2f} over {moments[best]:.0f} independent moments at best, "
        "which several lags explain",
    )


def _correlations(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lags (L,), correlation (L,) of a[t] with b[t + lag] over their overlap, and its length (L,)."""
    ones_a, ones_b = np.ones(len(a)), np.ones(len(b))

    def over(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return scipy.signal.correlate(y, x, "full", "fft")

    count = np.maximum(np.round(over(ones_a, ones_b)), 1)
    sum_a, sum_b = over(a, ones_b), over(ones_a, b)
    variance = (over(a**2, ones_b) - sum_a**2 / count) * (over(ones_a, b**2) - sum_b**2 / count)
    whole = float((a**2).sum() * (b**2).sum())
    covariance = over(a, b) - sum_a * sum_b / count
    return (
        np.arange(-len(a) + 1, len(b)),
        np.where(variance > 1e-12 * whole, covariance / np.sqrt(np.maximum(variance, 1e-300)), 0.0),
        count,
    )


def _autocorrelation(a: np.ndarray) -> np.ndarray:
    product = scipy.signal.correlate(a - a.mean(), a - a.mean(), "full", "fft")[len(a) - 1 :]
    return product / max(float(product[0]), 1e-300)


def _unknown(reason: str) -> MotionLag:
    return MotionLag(0.0, np.inf, 1.0, reason)
