# SPDX-License-Identifier: Apache-2.0
"""How well one epipolar geometry fits two cameras' keypoints at every lag.

A keypoint seen by two static cameras at one moment fulfils x_b' F x_a = 0, with the same F for all moments. The 9 × 9
matrix of that least-squares problem holds sums over time of products of one camera's coordinates with the other's: for
all lags at once they are cross-correlations, a few Fourier transforms. F is free, or near that of a calibration.
Keypoints are never interpolated: that would average their noise away between frames and make half a frame look right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.rotations import cross_matrix, exp

if TYPE_CHECKING:
    from jaxtyping import Float

# Error of a detector's keypoint (1 sigma), body heights, and how long it lasts: frames within that time are one moment.
NOISE, MOMENT_S = 0.015, 0.2
# A calibrated camera's pose where people are (1 sigma): tripods are knocked and mounts sag by about so much.
_POSE_RAD, _POSE_M = np.radians(1.0), 0.05
_PAIRS = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
# Indices of the six products of three coordinates in their 3 × 3 matrix.
_SQUARE = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
# Parts of the clip that are left out in turn for the scatter of a lag, and frames to either side of it that are fitted.
_BLOCKS, _BESIDE = 10, 2
# Tracks join whose median error is at most so many times that of the first pair.
_ROUNDS, _CLIP, _JOINS = 4, 3.0, 2.0


@dataclass(frozen=True)
class Meeting:
    """Tracks of one person in two cameras, and the number of rows by which the second begins later."""

    first: Float[np.ndarray, "T J 3"]
    second: Float[np.ndarray, "t J 3"]
    later: int


@dataclass(frozen=True)
class Geometry:
    """Normal prior of the nine entries of F: ``mean`` (9,), and its change ``per_sigma`` (9, K) by K unknowns."""

    mean: Float[np.ndarray, " 9"]
    per_sigma: Float[np.ndarray, "9 K"]

    @staticmethod
    def of(
        first: Float[np.ndarray, "4 4"],
        second: Float[np.ndarray, "4 4"],
        to_first: Float[np.ndarray, "3 3"],
        to_second: Float[np.ndarray, "3 3"],
    ) -> Geometry:
        """The prior of two ``camera_from_world``; ``to_first`` and ``to_second`` map keypoint coordinates to rays."""

        def form(a: np.ndarray, b: np.ndarray) -> np.ndarray:
            between = b @ np.linalg.inv(a)
            return (to_second.T @ cross_matrix(between[:3, 3]) @ between[:3, :3] @ to_first).reshape(9)

        mean = form(first, second)
        steps = np.diag([_POSE_RAD] * 3 + [_POSE_M] * 3)
        changes = [form(_moved(first, s), second) for s in steps] + [form(first, _moved(second, s)) for s in steps]
        return Geometry(mean, np.stack(changes, axis=1) - mean[:, None])


def _moved(pose: np.ndarray, step: np.ndarray) -> np.ndarray:
    change = np.eye(4)
    change[:3, :3], change[:3, 3] = exp(step[:3]), step[3:]
    return change @ pose


@dataclass(frozen=True)
class LagFit:
    """Per lag: ``error`` mean squared distance of keypoints from their epipolar lines, body heights squared, and
    ``penalty``, squared standard deviations by which the geometry leaves its prior."""

    form: Float[np.ndarray, "L 9"]
    error: Float[np.ndarray, " L"]
    penalty: Float[np.ndarray, " L"]


def fit_lags(matrices: Float[np.ndarray, "L 9 9"], moments: Float[np.ndarray, " L"], prior: Geometry | None) -> LagFit:
    """The best F of every lag, from sums over keypoints of ``lag_matrices`` that count as ``moments`` observations."""
    gradients = _gradients(matrices)
    if prior is None:
        # The least ratio of error to gradient: a generalised eigenvalue problem.
        ridge = 1e-9 * np.trace(matrices, axis1=1, axis2=2)[:, None, None] * np.eye(9) + 1e-12 * np.eye(9)
        whiten = np.linalg.inv(np.linalg.cholesky(matrices + ridge))
        largest, vectors = np.linalg.eigh(whiten @ gradients @ whiten.transpose(0, 2, 1))
        form = np.einsum("lji,lj->li", whiten, vectors[:, :, -1])
        return LagFit(form, 1 / np.maximum(largest[:, -1], 1e-18), np.zeros(len(matrices)))
    mean, basis = prior.mean, prior.per_sigma
    # Cameras in one place have no epipolar lines: no keypoint weighs more than the geometry's digits allow.
    digits = 1e-9 * np.trace(gradients, axis1=1, axis2=2) * (mean @ mean) + 1e-18
    steepness = np.maximum(np.einsum("i,lij,j->l", mean, gradients, mean), digits)
    scale = (moments / steepness / NOISE**2)[:, None]
    values, vectors = np.linalg.eigh(basis.T @ matrices @ basis)
    along = np.einsum("lji,lj->li", vectors, matrices @ mean @ basis)
    change = -np.einsum("lij,lj->li", vectors, scale * along / (scale * np.maximum(values, 0) + 1))
    form = mean + change @ basis.T
    return LagFit(form, np.einsum("li,lij,lj->l", form, matrices, form) / steepness, (change**2).sum(-1))


def squared_error(form: Float[np.ndarray, "L 9"], matrices: Float[np.ndarray, "L 9 9"]) -> Float[np.ndarray, " L"]:
    """Squared distances from epipolar lines (Sampson) under the F of each lag."""
    gradients = _gradients(matrices)
    return np.einsum("li,lij,lj->l", form, matrices, form) / np.maximum(
        np.einsum("li,lij,lj->l", form, gradients, form), 1e-18
    )


def _gradients(matrices: np.ndarray) -> np.ndarray:
    """(L, 9, 9) sums of the squared gradients of x_b' F x_a by both keypoints' coordinates, as forms of F."""
    blocks = matrices.reshape(-1, 3, 3, 3, 3)  # l, bi, aj, bk, am
    found = np.zeros_like(blocks)
    for i in (0, 1):
        found[:, i, :, i, :] += blocks[:, 2, :, 2, :]
        found[:, :, i, :, i] += blocks[:, :, 2, :, 2]
    return found.reshape(-1, 9, 9)


def lag_matrices(
    first: Float[np.ndarray, "T J 3"], second: Float[np.ndarray, "t J 3"]
) -> tuple[Float[np.ndarray, " L"], Float[np.ndarray, "L 9 9"], Float[np.ndarray, " L"]]:
    """Lags (L,), sums (L, 9, 9) over time and keypoints of m m' with m = vec(x_b x_a'), and their numbers (L,)."""
    lags = np.arange(-len(first) + 1, len(second))
    size = 1 << int(np.ceil(np.log2(len(first) + len(second))))
    spectra = []
    for track in (first, second):
        known = np.isfinite(track).all(-1)
        track = np.where(known[..., None], track, 0.0)
        parts = [track[..., i] * track[..., k] for i, k in _PAIRS] + [known.astype(float)]
        spectra.append(np.fft.rfft(np.stack(parts, -1), size, axis=0))  # (size, J, 7)
    cross = np.einsum("fjp,fjq->fpq", np.conj(spectra[0]), spectra[1])
    place = lags % size
    sums = np.fft.irfft(cross[:, :6, :6], size, axis=0)[place]  # [lag, pair of a, pair of b]
    count = np.fft.irfft(cross[:, 6, 6], size)[place]
    spread = sums[:, _SQUARE][:, :, :, _SQUARE]  # lag, ai, ak, bi, bk
    return lags, spread.transpose(0, 3, 1, 4, 2).reshape(len(lags), 9, 9), np.round(count)


def lag_between_frames(
    tracks: Sequence[Meeting], lag: int, rate: float, prior: Geometry | None
) -> tuple[float, float] | None:
    """The lag between frames of several pairs of tracks under one geometry, and its sigma.

    The first pair shows one person; the others count if they fit the same geometry. Fractions come from the parabola
    through the errors about ``lag``, sigma from the scatter between parts of the clip and, with a prior, from its
    freedom. None where they do not determine it.
    """
    product, known, of, block = _products(tracks, lag)
    if not (of == 0).any():
        return None
    moments = np.full(len(product), known.any(1).sum() / (rate * MOMENT_S))
    weight = known * (of == 0)[:, None].astype(float)
    for _ in range(_ROUNDS):
        each = np.stack(
            [
                np.einsum("tj,ltji,ltjk->lik", weight[block == k], *[product[:, block == k]] * 2, optimize=True)
                for k in range(_BLOCKS)
            ]
        )
        form = fit_lags(each.sum(0), moments, prior).form[_BESIDE]
        miss = np.where(known, np.abs(product[_BESIDE] @ form), np.nan)
        medians = [np.nanmedian(miss[of == k]) if known[of == k].any() else np.inf for k in range(of.max() + 1)]
        joins = known & (np.array(medians) <= _JOINS * medians[0])[of][:, None]
        scale = 1.4826 * np.median(miss[joins]) + 1e-12
        weight = joins / np.maximum(np.nan_to_num(miss) / (_CLIP * scale), 1.0) ** 2
    whole = _vertex(each.sum(0), moments, prior)
    parts = [_vertex(each.sum(0) - part, moments * (1 - 1 / _BLOCKS), prior) for part in each]
    scattered = np.array([part[0] for part in parts if part is not None])
    if whole is None or len(scattered) < _BLOCKS:
        return None
    variance = (_BLOCKS - 1) / _BLOCKS * float(((scattered - scattered.mean()) ** 2).sum())
    return lag + whole[0], float(np.sqrt(variance + (whole[1] if prior is not None else 0.0)))


def _products(tracks: Sequence[Meeting], lag: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Products (L, N, J, 9) of all frames that overlap at all lags about ``lag``, which are known (N, J), and the pair
    of tracks and the part of the clip (N,) of each frame."""
    found = []
    for k, track in enumerate(tracks):
        first, second = track.first, track.second
        shifts = np.arange(-_BESIDE, _BESIDE + 1) + lag - track.later
        low, high = max(0, *(-shifts)), min(len(first), *(len(second) - shifts))
        if high - low >= _BLOCKS:
            beside = np.stack([second[low + s : high + s] for s in shifts])
            product = np.einsum("ltji,tjk->ltjik", beside, first[low:high]).reshape(len(shifts), high - low, -1, 9)
            found.append((product, np.full(high - low, k), np.arange(high - low) * _BLOCKS // (high - low)))
    if not found:
        nothing = np.zeros(0, int)
        return np.zeros((2 * _BESIDE + 1, 0, 0, 9)), np.zeros((0, 0), bool), nothing, nothing
    product = np.concatenate([f[0] for f in found], axis=1)
    known = np.isfinite(product).all((0, 3))
    of, block = (np.concatenate([f[i] for f in found]) for i in (1, 2))
    return np.where(known[None, :, :, None], product, 0.0), known, of, block


def _vertex(matrices: np.ndarray, moments: np.ndarray, prior: Geometry | None) -> tuple[float, float] | None:
    """The fractional minimum of the misfit over the lags about the middle one, and its variance; None at an end."""
    fit = fit_lags(matrices, moments, prior)
    cost = moments * fit.error / NOISE**2 + fit.penalty
    best = int(np.argmin(cost))
    if not 1 <= best <= 2 * _BESIDE - 1:
        return None
    before, at, after = cost[best - 1 : best + 2]
    bend = max(before - 2 * at + after, 1e-12)
    return best - _BESIDE + 0.5 * (before - after) / bend, 2 / bend
