# SPDX-License-Identifier: Apache-2.0
"""Do the clocks agree? Everybody moves at the same moments, whichever camera looks: motion over time is compared between cameras.

A warning, not a measurement: the lag that is used for anything is measured on keypoints (rays must meet). Motion energy only
sees lags of whole frames, and nothing at all in a scene that does not move or moves evenly (numerics V07).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

# Shrinking before differencing: keeps people, averages sensor and compression noise away.
_SHRINK = 4
# Grey levels of difference that noise still reaches after shrinking.
_NOISE_LEVELS = 3.0
# A correlation of fewer independent samples than this is not evidence.
_LEAST_MOMENTS = 6.0


@dataclass(frozen=True)
class Lag:
    """How many frames one camera's pictures come after the other cameras' (positive: later).

    Attributes:
        camera: camera name.
        frames: best whole-frame lag, 0 when ``valid`` is False.
        correlation, correlation_at_zero: of its motion over time with the others', at the best lag and as filmed.
        valid: False when there is too little to tell; ``reason`` then says what.
    """

    camera: str
    frames: int
    correlation: float
    correlation_at_zero: float
    valid: bool
    reason: str


def motion_energy(frames: Iterable[np.ndarray]) -> np.ndarray:
    """(T − 1,) mean absolute change between successive frames (H, W, 3) uint8 above the noise, in grey levels."""
    energy = []
    before = None
    for frame in frames:
        small = cv2.resize(frame, (max(1, frame.shape[1] // _SHRINK), max(1, frame.shape[0] // _SHRINK)), interpolation=cv2.INTER_AREA)
        grey = small.astype(np.float32).mean(axis=2)
        if before is not None:
            energy.append(float(np.maximum(np.abs(grey - before) - _NOISE_LEVELS, 0).mean()))
        before = grey
    return np.array(energy)


def lags(cameras: Sequence[str], energies: Sequence[np.ndarray], search: int, min_correlation: float, min_z: float) -> list[Lag]:
    """The lag of every camera against the mean of the others, searched over ± ``search`` frames; empty without energies.

    A lag is reported when its correlation reaches ``min_correlation`` and lies ``min_z`` standard errors above that of no lag; no
    lag is reported when nothing else is better by one standard error. The standard error counts how many independent moments the
    motion has: slow motion over a short clip has a handful, and then everything is undetermined.
    """
    return [_lag(camera, index, energies, search, min_correlation, min_z) for index, camera in enumerate(cameras[: len(energies)])]


def _lag(camera: str, index: int, energies: Sequence[np.ndarray], search: int, min_correlation: float, min_z: float) -> Lag:
    def unknown(reason: str, correlation: float = 0.0, at_zero: float = 0.0) -> Lag:
        return Lag(camera, 0, correlation, at_zero, False, reason)

    own = energies[index]
    if broken := int((~np.isfinite(own)).sum()):
        return unknown(f"{broken} of {len(own)} values of its motion are not finite")
    usable = [i for i, e in enumerate(energies) if i != index and len(e) == len(own) and np.isfinite(e).all() and e.std() > 0]
    others = [_standardised(energies[i]) for i in usable]
    if not others or own.std() == 0:
        return unknown("nothing moves in its pictures or in the others'")
    reference = np.mean(others, axis=0)
    moments = _independent_moments(own, reference)
    if moments < _LEAST_MOMENTS:
        return unknown(f"{len(own) + 1} frames show {moments:.0f} independent moments of motion, too few")
    reach = min(search, len(own) // 2)
    scores = np.array([_correlation(own, reference, shift) for shift in range(-reach, reach + 1)])
    best, zero = int(np.argmax(scores)), float(scores[reach])
    if scores[best] < min_correlation:
        return unknown(f"its motion correlates at {scores[best]:.2f} only", float(scores[best]), zero)
    gain = float(np.arctanh(min(scores[best], 0.999)) - np.arctanh(np.clip(zero, -0.999, 0.999))) * np.sqrt(moments - 3)
    if best == reach or (gain < 1 and zero >= min_correlation):
        return Lag(camera, 0, zero, zero, True, "")
    if gain < min_z:
        return unknown("several lags fit about equally well", float(scores[best]), zero)
    if best in (0, 2 * reach):
        return unknown("the best lag is at the end of the search", float(scores[best]), zero)
    return Lag(camera, best - reach, float(scores[best]), zero, True, "")


def _independent_moments(a: np.ndarray, b: np.ndarray) -> float:
    """How many independent samples two smooth series amount to (Bartlett: N / (1 + 2 Σ ρa ρb), up to where ρ first vanishes)."""
    a, b = _standardised(a), _standardised(b)
    product = np.array([np.mean(a[k:] * a[: len(a) - k]) * np.mean(b[k:] * b[: len(b) - k]) for k in range(1, len(a) // 2)])
    gone = np.flatnonzero(product <= 0.01)
    return len(a) / (1 + 2 * float(product[: gone[0] if len(gone) else None].sum()))


def _standardised(values: np.ndarray) -> np.ndarray:
    return (values - values.mean()) / values.std()


def _correlation(own: np.ndarray, reference: np.ndarray, shift: int) -> float:
    """Correlation of own[t + shift] with reference[t] over the frames both have; 0 when one is constant there."""
    a = own[max(shift, 0) : len(own) + min(shift, 0)]
    b = reference[max(-shift, 0) : len(reference) + min(-shift, 0)]
    if a.std() == 0 or b.std() == 0:
        return 0.0
    return float(np.mean(_standardised(a) * _standardised(b)))
