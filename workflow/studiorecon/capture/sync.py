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
# A correlation over fewer frames than this is not evidence.
_LEAST_FRAMES = 12


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


def lags(cameras: Sequence[str], energies: Sequence[np.ndarray], search: int, min_correlation: float, min_gain: float) -> list[Lag]:
    """The lag of every camera against the mean of the others, searched over ± ``search`` frames; empty without energies."""
    found = []
    for index, camera in enumerate(cameras[: len(energies)]):
        others = [_standardised(e) for i, e in enumerate(energies) if i != index and e.std() > 0]
        own = energies[index]
        if not others or own.std() == 0:
            found.append(Lag(camera, 0, 0.0, 0.0, False, "nothing moves in its pictures or in the others'"))
            continue
        search_here = min(search, len(own) - _LEAST_FRAMES)
        if search_here < 0:
            found.append(Lag(camera, 0, 0.0, 0.0, False, f"{len(own) + 1} frames are too few"))
            continue
        reference = np.mean(others, axis=0)
        shifts = np.arange(-search_here, search_here + 1)
        scores = np.array([_correlation(own, reference, int(shift)) for shift in shifts])
        best, zero = int(np.argmax(scores)), float(scores[search_here])
        if scores[best] < min_correlation:
            found.append(Lag(camera, 0, float(scores[best]), zero, False, f"its motion correlates at {scores[best]:.2f} only"))
        elif scores[best] - zero < min_gain:
            found.append(Lag(camera, 0, zero, zero, zero >= min_correlation, "several lags fit equally well"))
        elif best in (0, len(shifts) - 1):
            found.append(Lag(camera, 0, float(scores[best]), zero, False, "the best lag is at the end of the search"))
        else:
            found.append(Lag(camera, int(shifts[best]), float(scores[best]), zero, True, ""))
    return found


def _standardised(values: np.ndarray) -> np.ndarray:
    return (values - values.mean()) / values.std()


def _correlation(own: np.ndarray, reference: np.ndarray, shift: int) -> float:
    """Correlation of own[t + shift] with reference[t] over the frames both have; 0 when one is constant there."""
    a = own[max(shift, 0) : len(own) + min(shift, 0)]
    b = reference[max(-shift, 0) : len(reference) + min(-shift, 0)]
    if a.std() == 0 or b.std() == 0:
        return 0.0
    return float(np.mean(_standardised(a) * _standardised(b)))
