# SPDX-License-Identifier: Apache-2.0
"""The lag between two cameras' keypoints: at the right lag one epipolar geometry fits all of them.

A keypoint seen by two static cameras at one moment fulfils x_b' F x_a = 0, with the same F for all moments. So F is
fitted to all keypoints of two tracks at every lag (or known, where the cameras are calibrated), and the lag of the
smallest residual counts. The 9 × 9 matrix of that least-squares problem holds sums over time of products of one
camera's coordinates with the other's: for all lags at once they are cross-correlations, a few Fourier transforms.
Keypoints are never interpolated here: that would average their noise away between frames and make half a frame look
right (V07).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float

_PAIRS = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
# Indices of the six products of three coordinates in their 3 × 3 matrix.
_SQUARE = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
_MIN_OVERLAP_S, _MIN_SHARE = 1.0, 0.3
# One body of twelve joints at 10 frames per second has 120 in a second.
_MIN_POINTS = 100
# Another lag further off than this must fit worse by this factor (squared residual), and so must lags this far off
# under the same F.
_APART_S, _MIN_RATIO = 0.3, 2.0
# Share of a track's usual motion above which a part of it counts as moving.
_MOVES = 0.2
_BLOCKS = 10
_ROUNDS, _CLIP = 3, 3.0
# Tracks join others whose epipolar geometry they miss by at most this factor, with so many points.
_JOINS, _MIN_JOINING = 1.5, 60

Meeting = tuple[np.ndarray, np.ndarray, int]
"""Two tracks (T, J, 3) and (T', J, 3) of two cameras, and by how many rows the second begins later than the first."""


@dataclass(frozen=True)
class PeopleLag:
    """Rows (frames at ``rate``) by which the second track lags the first; ``ratio``: how much worse the second best lag
    fits."""

    rows: float
    sigma_rows: float
    ratio: float
    points: int


def track_lag(
    first: Float[np.ndarray, "T J 3"],
    second: Float[np.ndarray, "t J 3"],
    rate: float,
    known: Float[np.ndarray, "3 3"] | None = None,
) -> PeopleLag | None:
    """The lag of two tracks (T, J, 3) and (T', J, 3) of one person's keypoints, homogeneous or rays, NaN where missing.

    Row t of the first is the moment of row t + lag of the second. ``known``: the 3 × 3 F with x_second' F x_first = 0;
    None: fitted at every lag. None when the tracks are too short, or no lag is clearly best, because nobody moves or
    these are two people.
    """
    a, b = (first, second) if known is not None else (_conditioned(first), _conditioned(second))
    lags, matrices, count = _matrices(a, b)
    seconds = _overlap(len(a), len(b), lags) / rate
    least = max(_MIN_OVERLAP_S, _MIN_SHARE * min(len(a), len(b)) / rate)
    usable = (count >= _MIN_POINTS) & (seconds >= least)
    reach = max(2, round(_APART_S * rate))
    if usable.sum() < 2 * reach + 3:
        return None
    matrices = matrices / np.maximum(count, 1)[:, None, None]
    if known is not None:
        form = np.broadcast_to(known.reshape(9) / np.linalg.norm(known), (len(lags), 9))
    else:
        form = np.linalg.eigh(matrices)[1][:, :, 0]
    cost = np.where(usable, np.einsum("li,lij,lj->l", form, matrices, form), np.inf)
    # How much worse neighbouring lags fit under a lag's own F: near 1 without motion.
    beside = np.full(len(lags), np.inf)
    for step in (-reach, reach):
        other = np.clip(np.arange(len(lags)) + step, 0, len(lags) - 1)
        there = np.einsum("li,lij,lj->l", form, matrices[other], form)
        beside = np.minimum(beside, np.where(usable[other], there, np.inf))
    sharp = np.isfinite(cost) & np.isfinite(beside) & (beside > _MIN_RATIO * np.where(np.isfinite(cost), cost, 1.0))
    if not sharp.any():
        return None
    best = int(np.argmin(np.where(sharp, cost, np.inf)))
    rivals = usable & (sharp | _moving(a, b, lags, reach)) & (np.abs(lags - lags[best]) > reach)
    ratio = float(cost[rivals].min() / max(cost[best], 1e-18)) if rivals.any() else 100.0
    if ratio < _MIN_RATIO or best in (0, len(lags) - 1):
        return None
    return _refined(a, b, int(lags[best]), known, ratio)


def _refined(a: np.ndarray, b: np.ndarray, start: int, known: np.ndarray | None, ratio: float) -> PeopleLag | None:
    """The lag between frames from the parabola through the residuals about ``start``, and its scatter between parts of
    the clip."""
    met = _met(a, b, start)
    return None if met is None else _between_frames(*met, start, known, ratio)


def joint_lag(tracks: Sequence[Meeting], others: Sequence[Meeting], lag: int) -> PeopleLag | None:
    """The lag between frames of several pairs of tracks under one epipolar geometry, which all people of two cameras
    determine better.

    ``tracks`` agree on about ``lag`` rows; ``others`` may be of two people, or overlap too briefly: those that fit the
    same geometry join. None where the parts of the clip do not determine it.
    """
    of_first = _conditioning([first for first, _, _ in tracks])
    of_second = _conditioning([second for _, second, _ in tracks])
    met = [
        [
            m
            for first, second, later in group
            if (m := _met(_conditioned(first, of_first), _conditioned(second, of_second), lag - later)) is not None
        ]
        for group in (tracks, others)
    ]
    if not met[0]:
        return None
    product = np.concatenate([_products(x, y[2:3])[0].reshape(-1, 9) for x, y in met[0]])
    product = product[np.isfinite(product).all(1)]
    form = np.linalg.eigh(product.T @ product)[1][:, 0]
    usual = _JOINS * float(np.median(np.abs(product @ form)))
    joining = [(x, y) for x, y in met[1] if _misses(x, y, form) <= usual]
    x, y = (np.concatenate([m[k] for m in met[0] + joining], axis=k) for k in (0, 1))
    return _between_frames(x, y, lag, None, 1.0)


def _misses(x: np.ndarray, y: np.ndarray, form: np.ndarray) -> float:
    """The median residual of the overlap at the middle lag; infinite where it is too short."""
    rest = np.abs(_products(x, y[2:3])[0] @ form)
    rest = rest[np.isfinite(rest)]
    return float(np.median(rest)) if len(rest) >= _MIN_JOINING else np.inf


def _products(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(L, N, J, 9) the products of x (N, J, 3) and y (L, N, J, 3) whose sum with F is the residual."""
    return np.einsum("ltji,tjk->ltjik", y, x).reshape(len(y), *x.shape[:2], 9)


def _met(a: np.ndarray, b: np.ndarray, start: int) -> tuple[np.ndarray, np.ndarray] | None:
    """(N, J, 3) the rows of ``a``, and (5, N, J, 3) those of ``b`` that overlap them at five lags about ``start``.

    None where there is almost no overlap.
    """
    shifts = np.arange(start - 2, start + 3)
    low, high = max(0, *(-shifts)), min(len(a), *(len(b) - shifts))
    if high - low < _BLOCKS:
        return None
    return a[low:high], np.stack([b[low + s : high + s] for s in shifts])


def _between_frames(
    x: np.ndarray, y: np.ndarray, start: int, known: np.ndarray | None, ratio: float
) -> PeopleLag | None:
    count = len(x)
    product = _products(x, y)
    there = np.isfinite(product).all((0, 3))
    product = np.where(there[None, :, :, None], product, 0.0)
    weight = there.astype(float)
    block = np.minimum(np.arange(count) * _BLOCKS // count, _BLOCKS - 1)
    for _ in range(_ROUNDS):
        total = _summed(weight, product)
        form = known.reshape(9) / np.linalg.norm(known) if known is not None else np.linalg.eigh(total[2])[1][:, 0]
        rest = np.abs(product[2] @ form)
        scale = 1.4826 * np.median(rest[there]) + 1e-12
        weight = there / np.maximum(rest / (_CLIP * scale), 1.0) ** 2
    each = np.stack([_summed(weight[block == k], product[:, block == k]) for k in range(_BLOCKS)])
    whole = _vertex(each.sum(0), known)
    if whole is None:
        return None
    without_one = [_vertex(each.sum(0) - part, known) for part in each]
    parts = np.array([p for p in without_one if p is not None])
    if len(parts) < _BLOCKS:
        return None
    sigma = float(np.sqrt((_BLOCKS - 1) / _BLOCKS * ((parts - parts.mean()) ** 2).sum()))
    return PeopleLag(start + whole, sigma, ratio, int(there.sum()))


def _summed(weight: np.ndarray, product: np.ndarray) -> np.ndarray:
    """(5, 9, 9) sums of m m' over products m (5, T, J, 9) with weights (T, J)."""
    return np.einsum("tj,ltji,ltjk->lik", weight, product, product, optimize=True)


def _vertex(total: np.ndarray, known: np.ndarray | None) -> float | None:
    """The fractional minimum of the residual over the five lags of ``total`` (5, 9, 9); None unless among the inner
    three."""
    if known is not None:
        form = np.broadcast_to(known.reshape(9) / np.linalg.norm(known), (5, 9))
    else:
        form = np.linalg.eigh(total)[1][:, :, 0]
    cost = np.einsum("li,lij,lj->l", form, total, form)
    best = int(np.argmin(cost))
    if not 1 <= best <= 3:
        return None
    before, at, after = cost[best - 1 : best + 2]
    return best - 2 + 0.5 * (before - after) / max(before - 2 * at + after, 1e-18)


def _conditioned(track: np.ndarray, by: tuple[np.ndarray, float] | None = None) -> np.ndarray:
    """Homogeneous coordinates about their mean, of unit spread (Hartley, In defense of the eight-point algorithm,
    1997).

    ``by``: the mean and spread of several tracks instead.
    """
    middle, spread = _conditioning([track]) if by is None else by
    points = track[..., :2] / track[..., 2:]
    return np.concatenate([(points - middle) / spread, np.where(np.isfinite(points[..., :1]), 1.0, np.nan)], -1)


def _conditioning(tracks: Sequence[np.ndarray]) -> tuple[np.ndarray, float]:
    points = np.concatenate([(track[..., :2] / track[..., 2:]).reshape(-1, 2) for track in tracks])
    middle = np.nanmean(points, axis=0)
    return middle, float(np.sqrt(np.nanmean((points - middle) ** 2)) + 1e-12)


def _moving(a: np.ndarray, b: np.ndarray, lags: np.ndarray, reach: int) -> np.ndarray:
    """(L,) lags at which the overlapping parts of both tracks move at least a little as much as the whole.

    A person who walks evenly fits their own walk at many lags (F absorbs the rest), so a lag without distinctive motion
    is no better.
    """
    found = np.ones(len(lags), bool)
    for track, first in ((a, np.maximum(0, -lags)), (b, np.maximum(0, lags))):
        moved = ((track[reach:] - track[:-reach]) ** 2).sum(-1)
        step = np.where(np.isfinite(moved), moved, 0.0).sum(-1) / np.maximum(np.isfinite(moved).sum(-1), 1)
        total = np.concatenate([[0.0], np.cumsum(step)])
        begin = np.clip(first, 0, len(step))
        end = np.clip(first + _overlap(len(a), len(b), lags) - reach, begin, len(step))
        here = (total[end] - total[begin]) / np.maximum(end - begin, 1)
        found &= here >= _MOVES * total[-1] / len(step)
    return found


def _overlap(first: int, second: int, lags: np.ndarray) -> np.ndarray:
    return np.minimum(first, second - lags) - np.maximum(0, -lags)


def _matrices(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lags (L,), sums (L, 9, 9) over time and keypoints of m m' with m = vec(x_b x_a'), and how many went into each
    (L,)."""
    lags = np.arange(-len(a) + 1, len(b))
    size = 1 << int(np.ceil(np.log2(len(a) + len(b))))
    spectra = []
    for track in (a, b):
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
