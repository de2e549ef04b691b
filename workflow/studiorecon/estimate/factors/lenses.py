# SPDX-License-Identifier: Apache-2.0
"""Factors of lenses: prior knowledge, and similarity of cameras of one make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.estimate.factor import Factor
from studiorecon.estimate.unknowns import LOG_FOCAL, PER_CAMERA, PRINCIPAL, RADIAL, Unknowns

if TYPE_CHECKING:
    from jaxtyping import Num

# Standard deviation of k1 of lenses that nobody measured: webcams -0.35 to 0.18, action cameras -0.3, phones 0.05.
RADIAL_SIGMA = 0.15
# Distance of the principal point from the middle, as a share of the longer side: lenses of a motion-capture system and
# of a checkerboard calibration.
PRINCIPAL_SHARE = 0.006
# Two cameras of one make at one setting differ by this in log focal length and in k1; a heavy tail releases a camera
# that is zoomed otherwise, or of another make with pictures of the same size.
SIMILAR_FOCAL, SIMILAR_RADIAL = 0.01, 0.02
_FREEDOM = 1.0
_LENS = [LOG_FOCAL, RADIAL, PRINCIPAL.start, PRINCIPAL.start + 1]


@dataclass(frozen=True)
class KnownLens(Factor):
    """Lenses about ``expected`` (V, 4): log focal length, k1 and principal point; ``sigma`` (V, 4), 0 where it is
    fixed."""

    expected: Num[np.ndarray, "V 4"]
    sigma: Num[np.ndarray, "V 4"]

    def residuals(self, at: Num[np.ndarray, "V 4"], unknowns: Unknowns) -> Num[np.ndarray, "V 4"]:
        return (at - self.expected) / np.where(self.sigma > 0, self.sigma, 1.0)


@dataclass(frozen=True)
class SimilarLenses(Factor):
    """Differences of one number between pairs of cameras.

    ``sigma`` (M,) is that of a camera about the mean of its make, times the root of the number of cameras: all pairs
    together then carry as much information as an unknown mean would.
    """

    sigma: Num[np.ndarray, " M"]

    def residuals(self, at: Num[np.ndarray, "M 2"], unknowns: Unknowns) -> Num[np.ndarray, "M 1"]:
        return (at[:, :1] - at[:, 1:]) / self.sigma[:, None]


def known_lenses(unknowns: Unknowns, expected: Num[np.ndarray, "V 4"], sigma: Num[np.ndarray, "V 4"]) -> KnownLens:
    """The factor of ``expected`` lenses."""
    views = np.arange(unknowns.views)
    return KnownLens(unknowns.columns("cameras", views, _LENS, PER_CAMERA), np.inf, expected, sigma)


def similar_lenses(unknowns: Unknowns, makes: Sequence[object]) -> list[Factor]:
    """The factors of cameras whose entries in ``makes`` are equal."""
    pairs = np.array([p for p in combinations(range(len(makes)), 2) if makes[p[0]] == makes[p[1]]]).reshape(-1, 2)
    if not len(pairs):
        return []
    others = np.bincount(pairs.ravel(), minlength=len(makes))
    found: list[Factor] = []
    for number, sigma in ((LOG_FOCAL, SIMILAR_FOCAL), (RADIAL, SIMILAR_RADIAL)):
        columns = np.stack([unknowns.columns("cameras", v, [number], PER_CAMERA)[:, 0] for v in pairs.T], axis=1)
        found.append(SimilarLenses(columns, _FREEDOM, sigma * np.sqrt(others[pairs[:, 0]] + 1)))
    return found


def similarity_gain(makes: Sequence[object], sigma: Num[np.ndarray, "V 4"]) -> float:
    """Twice the logarithm by which equal lenses are likelier if cameras with equal ``makes`` are of one make, than if
    each lens was drawn alone with ``sigma`` (log focal length and k1 first)."""
    repeated = [v for v, make in enumerate(makes) if make in makes[:v]]
    odds = sigma[repeated, :2] * np.sqrt(2 / np.pi) / [SIMILAR_FOCAL, SIMILAR_RADIAL]
    return float(2 * np.log(np.maximum(odds, 1.0)).sum())
