# SPDX-License-Identifier: Apache-2.0
"""Factors of bones: their length is constant while people move, and near a mean adult's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.estimate.factor import Factor
from studiorecon.estimate.unknowns import Unknowns

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# Standard deviation of a bone's length between a detector's joints over time, metres: a hip is not a point.
BONE_M = 0.015
# Adults' limbs differ from the mean body's by this share, sizes included.
LENGTH_SHARE = 0.07
_FREEDOM = 4.0


@dataclass(frozen=True)
class ConstantBones(Factor):
    """Distances of two points from a length that is unknown: columns of two points and a log length.

    Attributes:
        repeats: number of bones that share this one's error, because the body is in the same place and posture.
    """

    repeats: Num[np.ndarray, " M"]

    def residuals(self, at: Num[np.ndarray, "M 7"], unknowns: Unknowns) -> Num[np.ndarray, "M 1"]:
        length = np.sqrt(((at[:, :3] - at[:, 3:6]) ** 2).sum(1) + 1e-12)
        return ((length - np.exp(at[:, 6])) / BONE_M / np.sqrt(self.repeats))[:, None]


@dataclass(frozen=True)
class MeanLengths(Factor):
    """Differences of log lengths from ``log_lengths``, those of a mean adult."""

    log_lengths: Num[np.ndarray, " M"]

    def residuals(self, at: Num[np.ndarray, "M 1"], unknowns: Unknowns) -> Num[np.ndarray, "M 1"]:
        return (at - self.log_lengths[:, None]) / LENGTH_SHARE


def bone_factors(
    unknowns: Unknowns,
    first: Integer[np.ndarray, " M"],
    second: Integer[np.ndarray, " M"],
    kind: Integer[np.ndarray, " M"],
    repeats: Num[np.ndarray, " M"],
    usual_m: Num[np.ndarray, " B"],
) -> list[Factor]:
    """The factors of bones between points ``first`` and ``second``, of the unknown length ``kind`` in the group
    "bones", of B lengths that are ``usual_m``; ``repeats`` as for ``ConstantBones``."""
    of_ends = [unknowns.columns("points", ends, range(3), 3) for ends in (first, second)]
    columns = np.concatenate([*of_ends, unknowns.columns("bones", kind, [0], 1)], axis=1)
    lengths = unknowns.columns("bones", np.arange(len(usual_m)), [0], 1)
    return [ConstantBones(columns, _FREEDOM, repeats), MeanLengths(lengths, np.inf, np.log(usual_m))]
