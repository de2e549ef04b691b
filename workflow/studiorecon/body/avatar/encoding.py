# SPDX-License-Identifier: Apache-2.0
"""The temporal network's input: position and time as sines of rising frequency (paper, appendix: 63 + 21 inputs).

The identity is part of the code (3 + 3·2·10 = 63, 1 + 2·10 = 21). Frequencies are 2^k without π, as the predecessor's
code has them (U47).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Num

BANDS = 10


def in_body_box(
    points_m: Num[np.ndarray, "N 3"], low_m: Num[np.ndarray, " 3"], high_m: Num[np.ndarray, " 3"]
) -> Float[np.ndarray, "N 3"]:
    """Points, float64, with the box from ``low_m`` to ``high_m`` scaled to [−1, 1]; an empty box counts as a metre.

    In metres far from the origin, sines of 2⁹ x lose all digits (O01); inside the box they never do.
    """
    low, high = np.asarray(low_m, np.float64), np.asarray(high_m, np.float64)
    half = np.where(high > low, (high - low) / 2, 0.5)
    return (np.asarray(points_m, np.float64) - (low + high) / 2) / half


def encode_position(normalised: Num[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 63"]:
    """Normalised points → float32: the point, then sine and cosine of every band. No float16 anywhere (O01)."""
    return _encode(np.asarray(normalised, np.float64), BANDS)


def encode_time(frame: float, frames: int, use_all_bands: bool = False) -> Float[np.ndarray, " 21"]:
    """Float32 code of 0-based ``frame`` of ``frames``; it may be fractional, and time runs from 0 to 1.

    With a single frame time is 0 (O03). Bands above half a cycle per frame are 0, because they would be aliased to
    noise in the frame number (O02). ``use_all_bands`` keeps all bands, as the paper's network has them.
    """
    code = _encode(np.array([[frame / max(frames - 1, 1)]]), BANDS)[0]
    if not use_all_bands:
        code[1:].reshape(BANDS, 2)[time_bands(frames) :] = 0
    return code


def time_bands(frames: int) -> int:
    """Number of bands, from the slowest, that turn by at most half a cycle between two of ``frames`` frames."""
    per_frame = 2.0 ** np.arange(BANDS) / max(frames - 1, 1) / (2 * np.pi)
    return int(np.count_nonzero(per_frame <= 0.5))


def _encode(values: np.ndarray, bands: int) -> np.ndarray:
    """(N, D) float64 → (N, D (1 + 2 bands)) float32; the sines' argument is float64, to keep its rounding out of them.

    Each band is twice the one before it, by the double-angle formulas: sines are slow, and nine doublings lose three
    digits of sixteen. Points run along the last axis: three at a time would cost five times as much.
    """
    waves = np.empty((bands, 2, values.shape[1], len(values)))
    angle = np.ascontiguousarray(values.T)
    np.sin(angle, out=waves[0, 0])
    np.cos(angle, out=waves[0, 1])
    for k in range(1, bands):
        sine, cosine = waves[k - 1]
        waves[k] = 2 * sine * cosine, (cosine - sine) * (cosine + sine)
    code = np.empty((len(values), values.shape[1] * (1 + 2 * bands)), np.float32)
    code[:, : values.shape[1]] = values
    code[:, values.shape[1] :] = waves.reshape(-1, len(values)).T
    return code
