# SPDX-License-Identifier: Apache-2.0
"""Smoothing over time as in the paper's appendix: exponential forwards and backwards, then Gaussian; vectors and rotations.

The two exponential passes are a cascade (numerics U40), whose response is α/(2−α) (1−α)^|d|; together with the Gaussian that
is one symmetric kernel, cut where it has faded and renormalised at the ends, so that constants stay and the first frame has no
more say than others (F03, F06, F08). Rotations are smoothed on SO(3), in the tangent space of each window's own frame (F01, F02,
F09). What it costs in motion is ``gain``: with α = 0.5, σ = 1 a motion of 8 frames' period keeps 0.34, of 15 0.68, of 30 0.90.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from studiorecon.geometry import rotations

# Where the kernel is cut, relative to its centre; and the Gaussian's reach in deviations (numerics U41).
_FADED = 1e-4
_GAUSS_REACH = 4.0
_MEAN_STEPS = 3


@dataclass(frozen=True)
class Smoothing:
    """How strongly to smooth.

    Attributes:
        alpha: share of the new sample in each exponential pass, in (0, 1]; 1 = no exponential smoothing (paper: 0.5).
        sigma_frames: deviation of the Gaussian in frames; 0 = none (paper: 1).
        reference_fps: frame rate the two refer to; at other rates the smoothing keeps its length in seconds. 0 = never scaled.
    """

    alpha: float
    sigma_frames: float
    reference_fps: float


def at_frame_rate(smoothing: Smoothing, fps: float) -> tuple[float, float]:
    """(α, σ in frames) with the same decay per second at ``fps`` as ``smoothing`` has at its reference rate."""
    ratio = smoothing.reference_fps / fps if smoothing.reference_fps > 0 else 1.0
    return 1.0 - (1.0 - smoothing.alpha) ** ratio, smoothing.sigma_frames / ratio


def kernel(alpha: float, sigma_frames: float) -> np.ndarray:
    """(2R + 1,) weights that sum to 1: exponential cascade, then Gaussian."""
    if not 0 < alpha <= 1 or sigma_frames < 0:
        raise ValueError(f"alpha must be in (0, 1] and sigma ≥ 0, not {alpha} and {sigma_frames}")
    reach = 0 if alpha == 1 else int(np.ceil(np.log(_FADED) / np.log(1 - alpha)))
    passes = (1 - alpha) ** np.abs(np.arange(-reach, reach + 1)) if reach else np.ones(1)
    # A Gaussian narrower than this leaves its neighbours nothing; dividing by it would only overflow.
    wide = int(np.ceil(_GAUSS_REACH * sigma_frames)) if sigma_frames > 1e-3 else 0
    gauss = np.exp(-0.5 * (np.arange(-wide, wide + 1) / sigma_frames) ** 2) if wide else np.ones(1)
    both = np.convolve(passes, gauss)
    return both / both.sum()


def gain(alpha: float, sigma_frames: float, period_frames: float) -> float:
    """Share of a sinusoidal motion of that period that survives (F07)."""
    weights = kernel(alpha, sigma_frames)
    reach = len(weights) // 2
    return float(weights @ np.cos(2 * np.pi * np.arange(-reach, reach + 1) / period_frames))


def fill_vectors(values: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """(T, ...) with invalid frames replaced by straight lines between valid ones, and by the nearest one beyond the ends.

    Raises ValueError when no frame is valid.
    """
    before, after, share = _neighbours(valid)
    share = share.reshape(-1, *(1,) * (values.ndim - 1))
    return (1 - share) * values[before] + share * values[after]


def fill_rotations(values: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """(T, ..., 3, 3) with invalid frames replaced by slerps between valid ones; see ``fill_vectors`` (F05)."""
    before, after, share = _neighbours(valid)
    filled = rotations.slerp(
        values[before], values[after], np.broadcast_to(share.reshape(-1, *(1,) * (values.ndim - 3)), values.shape[:-2])
    )
    # Measured frames keep their bits.
    return np.where(valid.reshape(-1, *(1,) * (values.ndim - 1)), values, filled)


def smooth_vectors(values: np.ndarray, alpha: float, sigma_frames: float) -> np.ndarray:
    """(T, ...) smoothed along the first axis; fewer than three frames pass through (F04). No NaN: fill gaps first."""
    values = np.asarray(values, dtype=np.float64)
    if len(values) < 3:
        return values.copy()
    shifts, weights = _windows(len(values), kernel(alpha, sigma_frames))
    out = np.zeros_like(values)
    for shift, weight in zip(shifts, weights):
        out += weight.reshape(-1, *(1,) * (values.ndim - 1)) * values[_shifted(len(values), shift)]
    return out


def smooth_rotations(values: np.ndarray, alpha: float, sigma_frames: float) -> np.ndarray:
    """(T, ..., 3, 3) smoothed along the first axis on SO(3): weighted Karcher mean of each window, three steps.

    Differences are taken from the frame at the window's centre, so turns of any size pass; within one window (± 17 frames at
    the paper's values) the body must not turn by more than half a turn. Fewer than three frames pass through (F04).
    """
    values = np.asarray(values, dtype=np.float64)
    if len(values) < 3:
        return values.copy()
    shifts, weights = _windows(len(values), kernel(alpha, sigma_frames))
    centre = values
    for _ in range(_MEAN_STEPS):
        back = np.swapaxes(centre, -1, -2)
        turn = np.zeros(values.shape[:-1])
        for shift, weight in zip(shifts, weights):
            difference = rotations.log(back @ values[_shifted(len(values), shift)])
            turn += weight.reshape(-1, *(1,) * (values.ndim - 2)) * difference
        centre = centre @ rotations.exp(turn)
    return centre


def _shifted(frames: int, shift: int) -> np.ndarray:
    return np.clip(np.arange(frames) + shift, 0, frames - 1)


def _windows(frames: int, weights: np.ndarray) -> tuple[range, np.ndarray]:
    """Shifts and (shifts, T) weights, 0 outside the clip and renormalised to 1 per frame."""
    reach = len(weights) // 2
    shifts = range(-reach, reach + 1)
    target = np.arange(frames)[None] + np.array(shifts)[:, None]
    inside = weights[:, None] * ((target >= 0) & (target < frames))
    return shifts, inside / inside.sum(0)


def _neighbours(valid: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(T,) last valid frame at or before, first valid frame at or after, and the share of the way between them."""
    at = np.flatnonzero(valid)
    if not len(at):
        raise ValueError("no valid frame to fill from")
    frames = np.arange(len(valid))
    after = at[np.minimum(np.searchsorted(at, frames, side="left"), len(at) - 1)]
    before = at[np.maximum(np.searchsorted(at, frames, side="right") - 1, 0)]
    after, before = np.where(frames > at[-1], at[-1], after), np.where(frames < at[0], at[0], before)
    share = (frames - before) / np.maximum(after - before, 1)
    return before, after, np.where(after > before, share, 0.0)
