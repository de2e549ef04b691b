# SPDX-License-Identifier: Apache-2.0
"""Clocks from motion: people move at the same moments in every camera, so motion over time is correlated between
cameras.

The last resort: motion energy only resolves whole frames, depends on the direction of view, and fails in a scene that
does not move or moves evenly (V07).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.footage.frames import small_grey
from studiorecon.footage.source import FootageSource

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# Pictures are shrunk to this width in pixels before differencing: keeps people, averages sensor and compression noise
# away.
_WIDTH = 160
# Grey levels of difference that noise still reaches after shrinking.
_NOISE_LEVELS = 3.0
# A correlation of fewer independent samples than this is not evidence.
_MIN_MOMENTS = 8.0
_MIN_CORRELATION = 0.5
# Slower changes show mostly which person is near a camera, not when.
_DETREND_S = 0.5
# One moment looks different from two sides: sigma of the distance between peaks of motion in synchronous cameras.
_VIEWS_S = 0.04
# The best lag must be so many standard errors above no correlation. The best of all wrong lags is three above it where
# two people walk, and five (two steps off) where three walk about.
_MIN_HEIGHT = 6.0
_ALIKE = 0.95
# It must exceed every other lag further off than this by so many standard errors.
_APART_S, _MIN_Z = 0.3, 2.0
# Motion with a larger correlation to itself some time later is ambiguous: a person who walks evenly past one camera
# after the other fits best whole steps off.
_MAX_EVEN = 0.5
_MIN_OVERLAP_S, _MIN_SHARE = 1.0, 0.5
# Seconds of a long clip that are decoded for this.
_SEEN_S = 90.0


@dataclass(frozen=True)
class Lag:
    """Rows (frames at the common rate) by which a second series lags a first one.

    ``sigma_rows`` is never below half a frame, nor below 40 ms.
    """

    rows: float
    sigma_rows: float
    correlation: float
    valid: bool
    reason: str = ""


def motion_energy(frames: Iterable[Integer[np.ndarray, "H W"]]) -> Float[np.ndarray, " T-1"]:
    """(T - 1,) mean absolute change between successive grey frames (H, W) uint8 above the noise, in grey levels."""
    energy = []
    before = None
    for frame in frames:
        grey = frame.astype(np.float32)
        if before is not None:
            energy.append(float(np.maximum(np.abs(grey - before) - _NOISE_LEVELS, 0).mean()))
        before = grey
    return np.array(energy)


def compare(first: Float[np.ndarray, " T"], second: Float[np.ndarray, " t"], rate: float) -> Lag:
    """The lag of two energies (T,) and (T',) at ``rate`` values per second; not valid, with a reason, where it is
    ambiguous."""
    if broken := int((~np.isfinite(first)).sum() + (~np.isfinite(second)).sum()):
        return _unknown(f"{broken} values of its motion are not finite")
    least = max(_MIN_OVERLAP_S * rate, _MIN_SHARE * min(len(first), len(second)), 3)
    if min(len(first), len(second)) < least:
        return _unknown(f"{min(len(first), len(second)) / rate:.1f} s of motion are too short")
    if first.std() == 0 or second.std() == 0:
        return _unknown("nothing moves in one of the two pictures")
    # A person near the camera moves more pixels: the time counts, not the amount.
    slow, sigma = scipy.ndimage.gaussian_filter1d, _DETREND_S * rate
    a, b = (np.sqrt(e) - slow(np.sqrt(e), sigma, mode="nearest") for e in (first, second))
    lags, scores, overlap = _correlations(a, b)
    scores = np.where(overlap >= least, scores, -1.0)
    best = int(np.argmax(scores))
    own = a[max(0, -lags[best]) : len(a) + min(0, len(b) - len(a) - lags[best])]
    other = b[max(0, lags[best]) :][: len(own)]
    moments = _independent_moments(own, other) if min(own.std(), other.std()) > 0 else 0.0
    top = float(scores[best])
    if moments < _MIN_MOMENTS:
        return _unknown(f"{len(own) / rate:.1f} s show {moments:.0f} independent moments of motion, too few", top)
    if top < _MIN_CORRELATION:
        return _unknown(f"motion over time correlates at {top:.2f} only", top)
    for energy in (a, b):
        period_s, evenness = _rhythm(energy, least, rate)
        if evenness > _MAX_EVEN:
            return _unknown(f"what moves repeats itself every {period_s:.2f} s", top)
    # Two views of one motion never correlate more than this: larger values do not indicate the right lag.
    height = np.arctanh(np.clip(scores, -_ALIKE, _ALIKE)) * np.sqrt(max(moments - 3, 1.0))
    if height[best] < _MIN_HEIGHT:
        return _unknown(f"motion over time correlates at {top:.2f} over {moments:.0f} independent moments only", top)
    rivals = np.abs(lags - lags[best]) > max(2, _APART_S * rate)
    if (height[rivals] > height[best] - _MIN_Z).any():
        return _unknown("several lags fit the motion about equally well", top)
    if best in (0, len(lags) - 1):
        return _unknown("the best lag is at the end of the search", top)
    # Lags that fit within one standard error, and half a frame, which no difference of frames resolves.
    alike = np.abs(lags - lags[best])[height > height[best] - 1]
    return Lag(float(lags[best]), float(max(0.5, _VIEWS_S * rate, alike.max())), top, True)


def _rhythm(a: np.ndarray, least: float, rate: float) -> tuple[float, float]:
    """The period after which a series is most similar to itself, more than ``_APART_S``, in seconds, and that
    correlation."""
    lags, scores, overlap = _correlations(a, a)
    scores = np.where((overlap >= least) & (lags > max(2, _APART_S * rate)), scores, -1.0)
    return float(lags[np.argmax(scores)]) / rate, float(scores.max())


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


def _independent_moments(a: np.ndarray, b: np.ndarray) -> float:
    """Number of independent samples of two smooth series (Bartlett: N / (1 + 2 Σ ρa ρb), up to where ρ first
    vanishes)."""
    a, b = (a - a.mean()) / a.std(), (b - b.mean()) / b.std()
    product = np.array(
        [np.mean(a[k:] * a[: len(a) - k]) * np.mean(b[k:] * b[: len(b) - k]) for k in range(1, len(a) // 2)]
    )
    gone = np.flatnonzero(product <= 0.01)
    return len(a) / (1 + 2 * float(product[: gone[0] if len(gone) else None].sum()))


def _unknown(reason: str, correlation: float = 0.0) -> Lag:
    return Lag(0.0, np.inf, correlation, False, reason)


def read_motion_energy(source: FootageSource) -> Float[np.ndarray, " T"]:
    """``motion_energy`` of footage, as far as it can be read."""
    return motion_energy(small_grey(source, _WIDTH, round(_SEEN_S * source.fps)))
