# SPDX-License-Identifier: Apache-2.0
"""Factors of a calibration: the places of its cameras, its scale, and its floor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.estimate.factor import Factor
from studiorecon.estimate.unknowns import PER_CAMERA, Unknowns
from studiorecon.geometry.rotations import log

if TYPE_CHECKING:
    from jaxtyping import Num

# Standard deviations of a calibrated floor: its slopes, and the height of ankles above it, metres. A heavy tail,
# because people also stand on platforms.
_FLOOR_SIGMA = np.array([0.005, 0.005, 0.02])
# Standard deviation of the cameras' distances from one another, as a share: people do not show lengths, but would
# shrink with their errors.
_SCALE_SIGMA = 0.005
ANKLE_HEIGHT_M = 0.08
"""Height of ankles above the floor."""


@dataclass(frozen=True)
class KnownPoses(Factor):
    """Turns (rad) and moves (m) of cameras from the given ``rotations`` and ``centres_m``; ``sigma`` (V, 6), 0 where
    one is fixed."""

    rotations: Num[np.ndarray, "V 3 3"]
    centres_m: Num[np.ndarray, "V 3"]
    sigma: Num[np.ndarray, "V 6"]

    def residuals(self, at: Num[np.ndarray, "V 6"], unknowns: Unknowns) -> Num[np.ndarray, "V 6"]:
        turned = log(unknowns.rotations @ np.swapaxes(self.rotations, 1, 2)) + at[:, :3]
        off = np.concatenate([turned, at[:, 3:] - self.centres_m], axis=1)
        return off / np.where(self.sigma > 0, self.sigma, 1.0)


@dataclass(frozen=True)
class KnownFloor(Factor):
    """The floor under people's ankles, in the group "floor", from z = 0 of the calibration."""

    def residuals(self, at: Num[np.ndarray, "1 3"], unknowns: Unknowns) -> Num[np.ndarray, "1 3"]:
        return (at - np.array([0.0, 0.0, ANKLE_HEIGHT_M])) / _FLOOR_SIGMA


@dataclass(frozen=True)
class KnownScale(Factor):
    """The distances of all V cameras from their middle, as a share of the given ``spread_m``."""

    spread_m: float

    def residuals(self, at: Num[np.ndarray, "1 3*V"], unknowns: Unknowns) -> Num[np.ndarray, "1 1"]:
        centres_m = at.reshape(-1, 3)
        spread = ((centres_m - centres_m.mean(0)) ** 2).sum()
        return (np.log(spread / self.spread_m**2) / 2 / _SCALE_SIGMA).reshape(1, 1)


def known_poses(
    unknowns: Unknowns,
    rotations: Num[np.ndarray, "V 3 3"],
    centres_m: Num[np.ndarray, "V 3"],
    sigma: Num[np.ndarray, "V 6"],
) -> list[Factor]:
    """The factors of calibrated poses, their scale and their floor."""
    columns = unknowns.columns("cameras", np.arange(unknowns.views), range(6), PER_CAMERA)
    floor = unknowns.columns("floor", 0, range(3), 3)
    spread_m = float(np.sqrt(((centres_m - centres_m.mean(0)) ** 2).sum()))
    return [
        KnownPoses(columns, np.inf, rotations, centres_m, sigma),
        KnownFloor(floor, 1.0),
        KnownScale(columns[:, 3:].reshape(1, -1), np.inf, spread_m),
    ]
