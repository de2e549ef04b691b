# SPDX-License-Identifier: Apache-2.0
"""Smoothing of vectors and rotations as in the paper's appendix: exponential forwards and backwards, then Gaussian.

The two exponential passes are a cascade (U40), whose response is α/(2−α) (1−α)^|d|. Together with the Gaussian that is
one symmetric kernel, truncated where it has faded and renormalised at the ends, so that constants stay and the first
frame has no more weight than others (F03, F06, F08). Rotations are smoothed on SO(3), in the tangent space of each
window's own frame (F01, F02, F09). ``remaining_motion`` is the share that remains: with α = 0.5, σ = 1 a motion of 8
frames' period keeps 0.34, of 15 0.68, of 30 0.90.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.arrays import require
from studiorecon.configuration.setting import setting
from studiorecon.geometry import rotations

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# Where the kernel is truncated, relative to its centre; and the Gaussian's reach in sigmas (U41).
_FADED = 1e-4
_GAUSS_REACH = 4.0


@dataclass(frozen=True)
class Smoothing:
    """Strength of the smoothing."""

    forget_s: float = setting(
        0.0277,
        "Time constant of the recursive filter (1/e); 0 = none.",
        unit="s",
        minimum=0,
        paper="0.5 per frame at 30 fps; U40",
        paper_value=0.0481,
    )
    sigma_s: float = setting(
        0.0233,
        "Standard deviation of the Gaussian filter; 0 = none.",
        unit="s",
        minimum=0,
        paper="1 frame at 30 fps; U41",
        paper_value=0.0333,
    )
    smooth_in: Literal["rotations", "axis_angles"] = setting(
        "rotations",
        "rotations on SO(3), or axis_angles, which break near half a turn (U42).",
        paper="pose parameters, appendix B; U42",
        paper_value="axis_angles",
    )

    def smooth_body(
        self, local: Num[np.ndarray, "T J 3 3"], trans_m: Num[np.ndarray, "T 3"], fps: float
    ) -> tuple[Num[np.ndarray, "T J 3 3"], Num[np.ndarray, "T 3"]]:
        """Joints' rotations, root first, and pelvis positions, smoothed with these settings.

        Raises ValueError for other shapes, values that are not finite, and a frame rate that is not positive.
        """
        sizes = require("local", local, ("T", "J", 3, 3), finite=True)
        require("trans_m", trans_m, ("T", 3), sizes, finite=True)
        alpha, sigma = at_frame_rate(self, fps)
        if self.smooth_in == "axis_angles":
            turns = rotations.exp(smooth_vectors(rotations.log(local), alpha, sigma))
        else:
            turns = smooth_rotations(local, alpha, sigma)
        return turns, smooth_vectors(trans_m, alpha, sigma)


def at_frame_rate(smoothing: Smoothing, fps: float) -> tuple[float, float]:
    """(α, σ in frames) at ``fps``: α is the share that an exponential of ``forget_s`` forgets in one frame.

    Raises ValueError for a frame rate that is not positive.
    """
    if not fps > 0:
        raise ValueError(f"fps must be positive, not {fps}")
    forgotten = 1.0 - np.exp(-1.0 / (fps * smoothing.forget_s)) if smoothing.forget_s > 0 else 1.0
    return float(forgotten), smoothing.sigma_s * fps


def smoothing_kernel(alpha: float, sigma_frames: float) -> Num[np.ndarray, " W"]:
    """Weights that sum to 1: exponential passes (U40), then a Gaussian cut at four deviations (U41).

    The second pass runs over the first one's result. Raises ValueError for α outside (0, 1] and a negative σ.
    """
    if not 0 < alpha <= 1 or sigma_frames < 0:
        raise ValueError(f"alpha must be in (0, 1] and sigma ≥ 0, not {alpha} and {sigma_frames}")
    reach = 0 if alpha == 1 else int(np.ceil(np.log(_FADED) / np.log(1 - alpha)))
    both = (1 - alpha) ** np.abs(np.arange(-reach, reach + 1)) if reach else np.ones(1)
    # A narrower Gaussian gives neighbours no weight; dividing by it would only overflow.
    wide = int(np.ceil(_GAUSS_REACH * sigma_frames)) if sigma_frames > 1e-3 else 0
    gauss = np.exp(-0.5 * (np.arange(-wide, wide + 1) / sigma_frames) ** 2) if wide else np.ones(1)
    both = np.convolve(both, gauss)
    return both / both.sum()


def remaining_motion(alpha: float, sigma_frames: float, period_frames: float) -> float:
    """Share of a sinusoidal motion of that period that survives (F07); raises as ``smoothing_kernel``."""
    weights = smoothing_kernel(alpha, sigma_frames)
    reach = len(weights) // 2
    return float(weights @ np.cos(2 * np.pi * np.arange(-reach, reach + 1) / period_frames))


def fill_vectors(values: Num[np.ndarray, "T ..."], valid: Bool[np.ndarray, " T"]) -> Num[np.ndarray, "T ..."]:
    """``values`` with invalid frames on straight lines between valid ones, beyond the ends those of the nearest.

    Raises ValueError when no frame is valid or the shapes do not fit.
    """
    require("valid", valid, (len(values),))
    before, after, share = _neighbours(valid)
    share = share.reshape(-1, *(1,) * (values.ndim - 1))
    return (1 - share) * values[before] + share * values[after]


def fill_rotations(values: Num[np.ndarray, "T ... 3 3"], valid: Bool[np.ndarray, " T"]) -> Num[np.ndarray, "T ... 3 3"]:
    """``values`` with invalid frames replaced by slerps between valid ones; raises as ``fill_vectors`` does (F05)."""
    require("values", values, ("T", ..., 3, 3))
    require("valid", valid, (len(values),))
    before, after, share = _neighbours(valid)
    filled = rotations.slerp(
        values[before], values[after], np.broadcast_to(share.reshape(-1, *(1,) * (values.ndim - 3)), values.shape[:-2])
    )
    # Measured frames keep their bits.
    return np.where(valid.reshape(-1, *(1,) * (values.ndim - 1)), values, filled)


def smooth_vectors(values: Num[np.ndarray, "T ..."], alpha: float, sigma_frames: float) -> Num[np.ndarray, "T ..."]:
    """Smoothed along the first axis; fewer than three frames pass through (F04).

    Raises ValueError for values that are not finite: one would spread over the whole clip (F05); fill gaps first.
    """
    values = np.asarray(values, dtype=np.float64)
    require("values", values, ("T", ...), finite=True)
    if len(values) < 3:
        return values.copy()
    shifts, weights = _windows(len(values), smoothing_kernel(alpha, sigma_frames))
    out = np.zeros_like(values)
    for shift, weight in zip(shifts, weights):
        out += weight.reshape(-1, *(1,) * (values.ndim - 1)) * values[_shift_frames(len(values), shift)]
    return out


def smooth_rotations(
    values: Num[np.ndarray, "T ... 3 3"], alpha: float, sigma_frames: float
) -> Num[np.ndarray, "T ... 3 3"]:
    """Smoothed along the first axis on SO(3): weighted Karcher mean of each window, two steps from the mean quaternion.

    Differences are taken from the frame at the window's centre; within one window (± 17 frames at the paper's values)
    the body must not turn by more than half a turn. Fewer than three frames pass through (F04). Raises ValueError for
    other shapes and values that are not finite.
    """
    values = np.asarray(values, dtype=np.float64)
    require("values", values, ("T", ..., 3, 3), finite=True)
    if len(values) < 3:
        return values.copy()
    shifts, weights = _windows(len(values), smoothing_kernel(alpha, sigma_frames))
    quaternions = np.moveaxis(rotations.to_quaternion(values).reshape(len(values), -1, 4), -1, 0)  # (4, T, N)
    reach = len(shifts) // 2
    padded = np.pad(quaternions, ((0, 0), (reach, reach), (0, 0)), mode="edge")
    window = [(padded[:, reach + shift :][:, : len(values)], weight[:, None]) for shift, weight in zip(shifts, weights)]
    # Initial value: the windows' mean quaternions, with signs continued from the frame itself.
    centre = np.zeros_like(quaternions)
    for other, weight in window:
        centre += np.copysign(weight, _dot(quaternions, other)) * other
    centre /= np.sqrt((centre**2).sum(0))
    for _ in range(2):
        total = np.zeros_like(centre)
        for other, weight in window:
            total += weight * _turn_per_vector(_dot(centre, other)) * other
        centre = _rotate_quaternions(centre, _vector(centre, total))
    return rotations.from_quaternion(np.moveaxis(centre, 0, -1)).reshape(values.shape)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(T, N) products of quaternions (4, T, N), components first for long inner loops."""
    out = a[0] * b[0]
    for i in (1, 2, 3):
        out += a[i] * b[i]
    return out


def _turn_per_vector(dot: np.ndarray) -> np.ndarray:
    """θ / sin(θ/2) of the shorter turn θ between unit quaternions, from their product ``dot``.

    Turns of a window then add up before the one product with the centre. Near equality the ratio, 2 in the limit, is
    exact to rounding; a negative product is the longer way round (R03).
    """
    cosine = np.minimum(np.abs(dot), 1 - 1e-15)
    sine = np.sqrt((1 - cosine) * (1 + cosine))
    return np.copysign(2 * np.arctan2(sine, cosine) / sine, dot)


def _vector(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(3, T, N) vector part of the products a⁻¹ b of quaternions (4, T, N)."""
    out = np.empty((3, *a.shape[1:]))
    for i, j, k in ((1, 2, 3), (2, 3, 1), (3, 1, 2)):
        out[i - 1] = a[0] * b[i] - b[0] * a[i] - (a[j] * b[k] - a[k] * b[j])
    return out


def _rotate_quaternions(a: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """(4, T, N) unit quaternions a times those of axis-angles (3, T, N)."""
    half = 0.5 * np.sqrt((turn**2).sum(0))
    w, (x, y, z) = np.cos(half), 0.5 * np.sinc(half / np.pi) * turn
    out = np.stack(
        [
            a[0] * w - a[1] * x - a[2] * y - a[3] * z,
            a[0] * x + a[1] * w + a[2] * z - a[3] * y,
            a[0] * y - a[1] * z + a[2] * w + a[3] * x,
            a[0] * z + a[1] * y - a[2] * x + a[3] * w,
        ]
    )
    return out / np.sqrt((out**2).sum(0))


def _shift_frames(frames: int, shift: int) -> np.ndarray:
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
