# SPDX-License-Identifier: Apache-2.0
"""One estimate of all clocks: every source's likelihoods of lags between two cameras, summed and maximised together.

A source is right about a pair of cameras with heavy-tailed errors, or it is an outlier and says nothing. The share of
outliers of each source is estimated too. Offsets that explain the lags about equally well remain in the interval.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import brentq
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_flow
from scipy.special import expit, gammaln, ndtr

from studiorecon.scene.files import write_json
from studiorecon.scene.schema import ListOf, MappingOf, real, seconds, text, whole
from studiorecon.scene.step_files import read

if TYPE_CHECKING:
    from jaxtyping import Float

# Half of a 95 % interval in standard deviations.
HALF = 1.96
# Wider intervals determine no offset, seconds: a walking foot is put down and lifted meanwhile.
MAX_HALF_S = 0.15
# Offsets are equally likely a priori within this range, seconds: cameras of one take are started within a minute.
_RANGE_S = 60.0
# Degrees of freedom of errors: of lags that are right, one in a hundred is five standard deviations off.
_TAIL = 4.0
# The expected share of outliers counts like so many pairs.
_PRIOR_PAIRS = 5.0
_ITERATIONS = 40


@dataclass(frozen=True)
class Source:
    """A kind of evidence; ``bias_s``: the error of a camera that all its lags share (1 sigma)."""

    name: str
    bias_s: float = 0.0


@dataclass(frozen=True)
class Lag:
    """One source's likelihood of the lag of two cameras: the second one's first frame is ``offset_s`` ± ``sigma_s``
    after the first one's, by a common clock; ``outlier_probability`` is the probability that this says nothing."""

    source: Source
    first: int
    second: int
    offset_s: float
    sigma_s: float
    outlier_probability: float
    drift_ppm: float = 0.0
    drift_sigma_ppm: float = math.inf


_LAGS = {
    "lags": ListOf(
        {
            "source": {"name": text(), "bias_s": seconds(low=0)},
            **dict.fromkeys(("first", "second"), whole(low=0)),
            "offset_s": seconds(),
            "sigma_s": seconds(low=0),
            "outlier_probability": real(low=0, high=1),
            "drift_ppm": real(unit="ppm"),
            "drift_sigma_ppm": real(low=0, gaps=True, unit="ppm"),
        }
    ),
    "without": MappingOf(MappingOf(text())),
}


def write_lags(path: Path, lags: Sequence[Lag], without: Mapping[str, Mapping[int, str]]) -> None:
    """Write lags, and by source the reason for every camera (by its index) without one."""
    write_json(path, {"lags": [asdict(lag) for lag in lags], "without": without})


def read_lags(path: Path) -> tuple[list[Lag], dict[str, dict[int, str]]]:
    """What ``write_lags`` wrote; raises UserError as ``step_files.read`` does."""

    def made(value: dict[str, Any]) -> tuple[list[Lag], dict[str, dict[int, str]]]:
        lags = [
            Lag(**{**one, "source": Source(**one["source"]), "drift_sigma_ppm": one["drift_sigma_ppm"] or math.inf})
            for one in value["lags"]
        ]
        return lags, {name: {int(c): why for c, why in own.items()} for name, own in value["without"].items()}

    return read(path, _LAGS, made)


@dataclass(frozen=True)
class Offset:
    """Estimated offset of one camera from the reference: ``half_s`` is half of its 95 % interval, inf where nothing
    links the two. ``rival_s``: the offset that fits nearly as well and is in the interval, if there is one."""

    seconds: float
    half_s: float
    drift_ppm: float = 0.0
    rival_s: float | None = None


@dataclass(frozen=True)
class _Mode:
    """A local maximum: offsets (cameras,), their variances, responsibility of each lag, and the logarithm of its
    evidence."""

    offset_s: np.ndarray
    variance: np.ndarray
    right: np.ndarray
    evidence: float


def lag_from_gains(
    lags: Float[np.ndarray, " L"], gain: Float[np.ndarray, " L"], reach: float, outlier_probability: float
) -> tuple[float, float, float]:
    """The lag of two series, its sigma, and the probability that it says nothing.

    ``gain``: log-likelihood of every lag against two unrelated series, -inf where the lag is not possible. Lags within
    ``reach`` of the best one are the same peak; the others count as wrong, as do unrelated series
    (``outlier_probability``).
    """
    best = int(np.argmax(gain))
    odds = np.exp(gain - gain[best])
    unrelated = outlier_probability / (1 - outlier_probability) * np.isfinite(gain).sum() * math.exp(-gain[best])
    peak = np.where(np.abs(lags - lags[best]) <= reach, odds, 0.0)
    lag = float(peak @ lags / peak.sum())
    sigma = float(np.sqrt(peak @ (lags - lag) ** 2 / peak.sum()))
    # By the sum of all others: one minus the peak's share is 0 for a clear peak, and has no logarithm.
    others = float(odds[peak == 0].sum() + unrelated)
    return lag, sigma, max(others / (float(peak.sum()) + others), float(np.finfo(float).tiny))


def choose_reference(lags: Sequence[Lag], cameras: int) -> int:
    """The camera in most lags; the first of several."""
    return int(np.argmax(np.bincount([c for lag in lags for c in (lag.first, lag.second)], minlength=cameras)))


def estimate_offsets(lags: Sequence[Lag], cameras: int, reference: int) -> list[Offset]:
    """The offset of every camera from ``reference`` that maximises the posterior of all ``lags``."""
    if not lags:
        return [Offset(0.0, 0.0 if c == reference else math.inf) for c in range(cameras)]
    model = _Model(lags, cameras, reference)
    modes = [model.maximum(model.start(None))]
    for k, lag in enumerate(lags):
        beside = modes[0].offset_s[lag.second] - modes[0].offset_s[lag.first] - lag.offset_s
        if abs(beside) > HALF * 2 * lag.sigma_s:
            modes.append(model.maximum(model.start(k)))
    best = max(modes, key=lambda mode: mode.evidence)
    distinct = [best]
    for mode in sorted(modes, key=lambda mode: -mode.evidence):
        if all((np.abs(mode.offset_s - m.offset_s) > np.sqrt(m.variance) + 1e-6).any() for m in distinct):
            distinct.append(mode)
    drifts = model.drifts(best)
    return [
        replace(_interval(distinct, c, model.cut_odds(best, c)), drift_ppm=drifts[c])
        if c != reference
        else Offset(0.0, 0.0)
        for c in range(cameras)
    ]


def _interval(modes: Sequence[_Mode], camera: int, loose: float) -> Offset:
    """The interval about the best mode that holds 95 % of all modes; ``loose``: the odds that no lag is right."""
    share = np.exp([mode.evidence - modes[0].evidence for mode in modes])
    centre = np.array([mode.offset_s[camera] for mode in modes])
    sigma = np.sqrt([mode.variance[camera] for mode in modes])
    total = float(share.sum()) + loose

    def missing(half_s: float) -> float:
        inside = ndtr((centre[0] + half_s - centre) / sigma) - ndtr((centre[0] - half_s - centre) / sigma)
        return 0.95 - float(share @ inside) / total

    if missing(_RANGE_S) > 0:
        return Offset(float(centre[0]), math.inf)
    half_s = float(brentq(missing, 0.0, _RANGE_S, xtol=1e-7))
    rivals = [float(c) for c in centre[1:] if MAX_HALF_S < abs(c - centre[0]) <= half_s]
    return Offset(float(centre[0]), half_s, rival_s=rivals[0] if rivals else None)


def _log_tail(off: np.ndarray) -> np.ndarray:
    """Logarithm of Student's density at ``off`` standard deviations."""
    scale = gammaln((_TAIL + 1) / 2) - gammaln(_TAIL / 2) - 0.5 * math.log(_TAIL * math.pi)
    return scale - (_TAIL + 1) / 2 * np.log1p(off**2 / _TAIL)


class _Model:
    """The lags as arrays. Unknowns: offset of every camera, then the error that each source shares, camera by
    camera."""

    def __init__(self, lags: Sequence[Lag], cameras: int, reference: int) -> None:
        self.lags, self.cameras, self.reference = lags, cameras, reference
        self.sources = list(dict.fromkeys(lag.source for lag in lags))
        self.of = np.array([self.sources.index(lag.source) for lag in lags])
        self.seconds = np.array([lag.offset_s for lag in lags])
        self.sigma = np.array([lag.sigma_s for lag in lags])
        self.columns = np.zeros((len(lags), cameras * (1 + len(self.sources))))
        for row, lag in enumerate(lags):
            for block in (0, cameras * (1 + self.of[row])):
                self.columns[row, [block + lag.first, block + lag.second]] = -1, 1
        bias = np.repeat([max(source.bias_s, 1e-6) for source in self.sources], cameras)
        self.precision = np.concatenate([np.full(cameras, _RANGE_S**-2), bias**-2])
        self.precision[reference] = 1e12

    def start(self, forced: int | None) -> np.ndarray:
        """Unknowns along the sharpest chain of lags from the reference, through lag ``forced`` if given."""
        order = sorted(range(len(self.lags)), key=lambda k: (k != forced, self.sigma[k]))
        tree = {c: {c: 0.0} for c in range(self.cameras)}
        for k in order:
            lag = self.lags[k]
            one, other = tree[lag.first], tree[lag.second]
            if one is not other:
                shift = one[lag.first] + lag.offset_s - other[lag.second]
                one.update({c: at + shift for c, at in other.items()})
                tree.update(dict.fromkeys(other, one))
        known = tree[self.reference]
        offsets = [known.get(c, 0.0) - known[self.reference] for c in range(self.cameras)]
        return np.concatenate([offsets, np.zeros(self.columns.shape[1] - self.cameras)])

    def maximum(self, unknowns: np.ndarray) -> _Mode:
        """The local maximum of the posterior from a start, by expectation and maximisation."""
        usual = np.array([lag.outlier_probability for lag in self.lags])
        outliers, of_source = usual, np.bincount(self.of)[self.of]
        for _ in range(_ITERATIONS):
            off = (self.seconds - self.columns @ unknowns) / self.sigma
            heard = np.log1p(-outliers) + _log_tail(off) - np.log(self.sigma)
            silent = np.log(outliers) - math.log(_RANGE_S)
            right = expit(heard - silent)
            wrong = np.bincount(self.of, 1 - right)[self.of]
            shares, outliers = outliers, (_PRIOR_PAIRS * usual + wrong) / (_PRIOR_PAIRS + of_source)
            weight = right * (_TAIL + 1) / (_TAIL + off**2) / self.sigma**2
            information = (self.columns * weight[:, None]).T @ self.columns + np.diag(self.precision)
            covariance = np.linalg.inv(information)
            before, unknowns = unknowns, covariance @ (self.columns.T @ (weight * self.seconds))
            if np.abs(unknowns - before).max() < 1e-7 and np.abs(outliers - shares).max() < 1e-3:
                break
        # Lags that contradict each other by more than their errors have larger ones.
        loops = max(float(right.sum()) - (self.cameras - 1), 1.0)
        stretch = max(1.0, float((right > 0.5) @ ((self.seconds - self.columns @ unknowns) / self.sigma) ** 2) / loops)
        mine = stretch * covariance[: self.cameras, : self.cameras]
        evidence = (
            float(np.logaddexp(heard, silent).sum() - 0.5 * self.precision @ unknowns**2)
            + 0.5 * np.linalg.slogdet(covariance)[1]
            + _PRIOR_PAIRS * float(((usual * np.log(outliers) + (1 - usual) * np.log1p(-outliers)) / of_source).sum())
        )
        return _Mode(unknowns[: self.cameras], np.diag(mine), heard - silent, evidence)

    def cut_odds(self, mode: _Mode, camera: int) -> float:
        """The odds that every chain of lags from the reference to ``camera`` is broken: the cheapest set of lags that
        would all have to be wrong (a minimal cut), against ``mode``."""
        gain = np.zeros((self.cameras, self.cameras))
        for lag, right in zip(self.lags, np.logaddexp(mode.right, 0.0)):
            gain[[lag.first, lag.second], [lag.second, lag.first]] += right
        # The flow is in whole thousandths.
        cut = maximum_flow(csr_array((1000 * gain).astype(np.int32)), self.reference, camera).flow_value / 1000
        width = math.sqrt(2 * math.pi * mode.variance[camera])
        return math.exp(min(-cut - math.log(width / _RANGE_S), 50.0))

    def drifts(self, mode: _Mode) -> np.ndarray:
        """(cameras,) drifts in ppm, 0 where they are within three standard deviations."""
        sigma = np.array([lag.drift_sigma_ppm for lag in self.lags])
        weight = expit(mode.right) / sigma**2
        columns = self.columns[:, : self.cameras]
        # 1e3 ppm: no crystal is worse, so that a camera without a lag keeps a finite variance.
        prior = np.full(self.cameras, 1e-6)
        prior[self.reference] = 1e12
        covariance = np.linalg.inv((columns * weight[:, None]).T @ columns + np.diag(prior))
        found = covariance @ (columns.T @ (weight * [lag.drift_ppm for lag in self.lags]))
        return np.where(np.abs(found) > 3 * np.sqrt(np.diag(covariance)), found, 0.0)
