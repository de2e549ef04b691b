# SPDX-License-Identifier: Apache-2.0
"""The lag between two cameras' sound tracks: generalised cross-correlation with phase transform.

Knapp & Carter, The generalized correlation method for estimation of time delay, IEEE TASSP 1976. Loudness over time
gives the second, whatever the microphones, the room and the drift; whitened spectra of short windows give the
millisecond, and its change along the clip. Without a clear peak (a hum, each microphone's own noise) the lag is
undetermined.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.clocks.posterior import Lag, Source
from studiorecon.clocks.timeline import Timeline
from studiorecon.footage.sound_track import RATE_HZ
from studiorecon.progress import progress

if TYPE_CHECKING:
    from jaxtyping import Float

# Sound needs 3 ms a metre and the speaker's position is unknown: sigma for 1.5 m of difference between two cameras.
SOUND = Source("sound", bias_s=1.5 / 343 / math.sqrt(2))
_OUTLIER_PROBABILITY = 0.002
# Every sound track is compared with those of so many cameras; more only cost time.
_HUBS = 3
# Speech and claps; phones attenuate below, distant microphones lose higher frequencies.
_BAND_HZ = (200.0, 3600.0)
# Loudness is compared in steps of this many samples, in this many bands.
_HOP = 40
_BANDS_HZ = (200.0, 500.0, 1100.0, 2000.0, 3600.0)
_CANDIDATES = 6
_APART_S = 0.2
# Windows of the fine search, its range about a candidate, and the drifts to try.
_WINDOW_S, _STEP_S = 1.0, 0.5
_REACH_S = 0.05
_FINER = 4
MAX_DRIFT_PPM, _DRIFT_STEPS = 200.0, 41
# The peak must be this many times the scatter of the rest, and this many times the next one beyond a room's echoes.
_MIN_Z, _MIN_RATIO = 8.0, 1.5
_ECHO_S = 0.02
_MIN_OVERLAP_S = 1.5
# Sigma of one window's lag, and of crystals' frequencies.
_LAG_NOISE_S, _CRYSTAL = 1e-4, 50e-6
_ROUNDS = 5
# Longest stretch that is searched for the second, seconds: two sound tracks of ten minutes take a second.
_SEARCHED_S = 600.0


@dataclass(frozen=True)
class SoundLag:
    """The lag of two sound tracks: how much later the first file records a sound, and how much faster its clock runs.

    Attributes:
        lag_s: seconds of the first one's file minus those of the other's, at ``middle_s`` of the first one's.
        sigma_s: its sigma, from the scatter between parts of the clip.
        drift_ppm: millionths of a second by which the lag grows every second.
        drift_sigma_ppm: its sigma; that of crystals where the clip is too short.
        valid: False without a clear peak, for the ``reason``.
    """

    lag_s: float
    sigma_s: float
    drift_ppm: float
    drift_sigma_ppm: float
    valid: bool
    reason: str = ""
    middle_s: float = 0.0


def sound_lags(
    sounds: Sequence[Float[np.ndarray, " N"] | None], lines: Sequence[Timeline]
) -> tuple[list[Lag], dict[int, str]]:
    """Lags of cameras whose sound tracks determine one, and the reason for every camera without one."""
    present = {i: s for i, s in enumerate(sounds) if s is not None}
    reasons = {i: "its video has no sound" for i in range(len(sounds)) if i not in present}
    wanted = [(a, b) for a, b in itertools.combinations(present, 2) if a in list(present)[:_HUBS]]
    lags = []
    for a, b in progress(wanted, "sound tracks"):
        heard = sound_lag(present[a], present[b])
        if not heard.valid:
            reasons.setdefault(b, heard.reason)
            reasons.setdefault(a, heard.reason)
            continue
        # By the first one's clock: t_a = (1 + d) (t_b + lag - d middle), on the files' own time lines.
        clear = abs(heard.drift_ppm) > 3 * heard.drift_sigma_ppm
        drift = 1e-6 * heard.drift_ppm if clear else 0.0
        offset_s = (1 + drift) * (lines[b].first_s + heard.lag_s - drift * heard.middle_s) - lines[a].first_s
        lags.append(
            Lag(SOUND, a, b, offset_s, heard.sigma_s, _OUTLIER_PROBABILITY, heard.drift_ppm, heard.drift_sigma_ppm)
        )
    for i in {c for lag in lags for c in (lag.first, lag.second)}:
        reasons.pop(i, None)
    return lags, reasons


def onset_strength(samples: Float[np.ndarray, " N"]) -> Float[np.ndarray, "bands T"]:
    """(bands, T) rises of the loudness in octave-wide bands, one value per ``_HOP`` samples, standardised."""
    found = []
    for low, high in itertools.pairwise(_BANDS_HZ):
        sos = scipy.signal.butter(2, (low, min(high, 0.49 * RATE_HZ)), "bandpass", fs=RATE_HZ, output="sos")
        power = scipy.signal.sosfilt(sos, samples) ** 2
        steps = power[: len(power) // _HOP * _HOP].reshape(-1, _HOP).mean(1)
        smooth = scipy.signal.lfilter([0.4], [1, -0.6], steps)
        floor = max(float(np.median(smooth)), 1e-12)
        rise = np.maximum(np.diff(np.log(smooth + floor), prepend=np.log(smooth[0] + floor)), 0)
        found.append((rise - rise.mean()) / max(rise.std(), 1e-9))
    return np.array(found)


def sound_lag(first: Float[np.ndarray, " N"], second: Float[np.ndarray, " M"]) -> SoundLag:
    """``SoundLag`` of two sound tracks of ``read_sound``, from time 0 of their files on."""
    shorter = min(len(first), len(second)) / RATE_HZ
    if shorter < _MIN_OVERLAP_S:
        return _nothing(f"{shorter:.1f} s of sound are too short")
    if min(first.std(), second.std()) < 1e-6:
        return _nothing("a sound track is silent")
    one, other = _limited(first), _limited(second)
    tried = [_fine(one, other, lag) for lag in _coarse(one, other)]
    tried.sort(key=lambda t: -t[0])
    if not tried:
        return _nothing("nothing happens in the sound")
    z, ratio, heard = tried[0]
    others = [t[0] for t in tried[1:] if abs(t[2].lag_s - heard.lag_s) > _REACH_S]
    if z < _MIN_Z:
        return _nothing(
            f"no time fits the sound tracks better than chance (peak {z:.1f} times the "
            f"scatter, {_MIN_Z:.0f} would be clear)"
        )
    if ratio < _MIN_RATIO or (others and z < _MIN_RATIO * max(others)):
        return _nothing("several offsets fit the sound tracks about equally well (a hum, or repeated sound)")
    return heard


def _limited(samples: np.ndarray) -> np.ndarray:
    sos = scipy.signal.butter(4, _BAND_HZ, "bandpass", fs=RATE_HZ, output="sos")
    return scipy.signal.sosfiltfilt(sos, samples).astype(np.float32) if len(samples) > 100 else samples


def _coarse(first: np.ndarray, second: np.ndarray) -> list[float]:
    """Seconds to add to the second one's time, best first: peaks of the correlation of loudness."""
    most = round(_SEARCHED_S * RATE_HZ)
    a, b = onset_strength(first[:most]), onset_strength(second[:most])
    score = sum(scipy.signal.correlate(x, y, "full", "fft") for x, y in zip(a, b))
    lags = np.arange(-b.shape[1] + 1, a.shape[1])
    overlap = np.minimum(np.minimum(lags + b.shape[1], a.shape[1]), np.minimum(a.shape[1] - lags, b.shape[1])).astype(
        float
    )
    score = score / np.sqrt(np.maximum(overlap, _MIN_OVERLAP_S * RATE_HZ / _HOP))
    apart = round(_APART_S * RATE_HZ / _HOP)
    found: list[float] = []
    while len(found) < _CANDIDATES and score.max() > 0:
        best = int(np.argmax(score))
        found.append(float(lags[best] * _HOP / RATE_HZ))
        score[max(best - apart, 0) : best + apart + 1] = -np.inf
    return found


def _fine(first: np.ndarray, second: np.ndarray, lag_s: float) -> tuple[float, float, SoundLag]:
    """The peak's height over the scatter, its ratio to the next peak, and its lag, within ``_REACH_S`` of ``lag_s``."""
    shift = round(lag_s * RATE_HZ)
    a, b = (first[shift:], second) if shift >= 0 else (first, second[-shift:])
    length = min(len(a), len(b))
    if length < _MIN_OVERLAP_S * RATE_HZ:
        return 0.0, 0.0, _nothing("too little in common")
    times, correlation, weight = _windows(a[:length], b[:length])
    middle = float((weight * times).sum() / weight.sum())
    tried = np.linspace(-MAX_DRIFT_PPM, MAX_DRIFT_PPM, _DRIFT_STEPS) if length > 10 * RATE_HZ else np.zeros(1)
    lags = np.arange(correlation.shape[1])
    step = 1 / (RATE_HZ * _FINER)
    summed = np.zeros((len(tried), correlation.shape[1]))
    for row, ppm in enumerate(tried):
        for moved, curve, w in zip(np.rint(1e-6 * ppm * (times - middle) / step).astype(int), correlation, weight):
            summed[row] += w * np.roll(curve, -moved)
        # Crystals are within tens of millionths: of drifts that fit equally, the least counts.
        summed[row] *= 1 - 0.05 * (ppm / MAX_DRIFT_PPM) ** 2
    scatter = 1.4826 * np.median(np.abs(summed - np.median(summed))) + 1e-12
    row, best = (int(i) for i in np.unravel_index(int(np.argmax(summed)), summed.shape))
    beyond = np.abs(lags - best) * step > _ECHO_S
    second_best = float(summed[row][beyond].max())
    z = float(summed[row, best]) / scatter
    heard = _settled(times - middle, correlation, weight, best, float(tried[row]), step)
    offset = shift / RATE_HZ + heard.lag_s - _REACH_S
    # Times of the first track: the windows count from the later start.
    begin = max(shift, 0) / RATE_HZ
    return (
        z,
        float(summed[row, best]) / max(second_best, scatter),
        SoundLag(offset, heard.sigma_s, heard.drift_ppm, heard.drift_sigma_ppm, True, "", middle + begin),
    )


def _windows(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Middles (W,) in seconds, whitened correlations (W, lags) at ``_FINER`` times the rate, and each window's
    weight."""
    size, step = round(_WINDOW_S * RATE_HZ), round(_STEP_S * RATE_HZ)
    reach = round(_REACH_S * RATE_HZ)
    begins = np.arange(0, len(a) - size + 1, step)
    padded = 2 * size
    taper = np.hanning(size).astype(np.float32)
    band = np.fft.rfftfreq(padded, 1 / RATE_HZ)
    inside = (band >= _BAND_HZ[0]) & (band <= _BAND_HZ[1])
    found = np.zeros((len(begins), 2 * reach * _FINER + 1), np.float32)
    power = np.zeros((2, len(begins)))
    for i, begin in enumerate(begins):
        pieces = [x[begin : begin + size] * taper for x in (a, b)]
        power[:, i] = [float((p**2).mean()) for p in pieces]
        cross = np.conj(np.fft.rfft(pieces[1], padded)) * np.fft.rfft(pieces[0], padded)
        white = np.where(inside, cross / (np.abs(cross) + 1e-20), 0)
        curve = np.fft.irfft(white, padded * _FINER)
        found[i] = np.concatenate([curve[-reach * _FINER :], curve[: reach * _FINER + 1]])
    # A window in which one of the two has only its usual noise counts a tenth.
    quiet = np.maximum(np.quantile(power, 0.2, axis=1, keepdims=True), 1e-14)
    weight = np.minimum(np.sqrt(np.maximum(power / quiet - 1, 0)).min(0), 10.0) + 0.1
    return (begins + size / 2) / RATE_HZ, found, weight


def _settled(
    times: np.ndarray, correlation: np.ndarray, weight: np.ndarray, best: int, ppm: float, step: float
) -> SoundLag:
    """Lag at the windows' middle, counted from the first column, and drift, from the windows' own peaks about the
    common one."""
    near = round(0.002 / step)
    lags, heights = np.zeros(len(times)), np.zeros(len(times))
    for i, (t, curve) in enumerate(zip(times, correlation)):
        centre = best + round(1e-6 * ppm * t / step)
        low = max(centre - near, 0)
        part = curve[low : centre + near + 1]
        if len(part) < 3:
            continue
        top = int(np.clip(np.argmax(part), 1, len(part) - 2))
        before, at, after = part[top - 1 : top + 2]
        lags[i] = (low + top + 0.5 * (before - after) / min(before - 2 * at + after, -1e-12)) * step
        heights[i] = max(float(at), 0.0)
    noise = 1.4826 * np.median(np.abs(correlation)) + 1e-12
    use = np.clip(heights / noise - 3, 0, None) * weight
    use = use if (use > 0).any() else weight
    columns = np.stack([np.ones(len(times)), times], 1)
    robust = np.ones(len(times))
    for _ in range(_ROUNDS):
        w = use * robust
        w = w * (w.sum() / (w**2).sum())  # sums to the number of windows that count
        information = columns.T @ (w[:, None] * columns)
        solution = np.linalg.solve(information + np.diag([0.0, (_LAG_NOISE_S / _CRYSTAL) ** 2]), columns.T @ (w * lags))
        rest = np.abs(lags - columns @ solution)
        order = np.argsort(rest)
        middle = float(rest[order][np.searchsorted(np.cumsum(w[order]), 0.5 * w.sum())]) + 0.2 * step
        robust = 1 / np.maximum(rest / (3 * middle), 1.0) ** 2
    inverse = np.linalg.inv(information + np.diag([0.0, (_LAG_NOISE_S / _CRYSTAL) ** 2]))
    # Neighbouring windows share half of their sound: together they count as one.
    scatter = 2 * inverse @ (columns.T @ (((w * rest) ** 2)[:, None] * columns)) @ inverse
    sigma = np.sqrt(np.diag(scatter) + np.diag(inverse) * _LAG_NOISE_S**2)
    return SoundLag(float(solution[0]), float(sigma[0]), 1e6 * float(solution[1]), 1e6 * float(sigma[1]), True)


def _nothing(reason: str) -> SoundLag:
    return SoundLag(0.0, np.inf, 0.0, np.inf, False, reason)
