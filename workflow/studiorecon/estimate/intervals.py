# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of an estimate's cameras, from its covariance: relative to one another, since the world is arbitrary."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.estimate.solver import Solution
from studiorecon.estimate.unknowns import CENTRE, LOG_FOCAL, PER_CAMERA, RADIAL, TURN

if TYPE_CHECKING:
    from jaxtyping import Num

# Draws from the covariance: the 95th percentile of so many is known to 3 % of itself.
_DRAWS = 2000


@dataclass(frozen=True)
class Intervals:
    """Uncertainty of V cameras relative to one another.

    Attributes:
        turn_deg, place_m: (V,) standard deviation of each number of a rotation and a position, without what all cameras
            have in common.
        focal, radial: (V,) of the log focal length and of k1.
        between_deg: half of the 95 % interval of the rotation between the least certain two cameras.
    """

    turn_deg: Num[np.ndarray, " V"]
    place_m: Num[np.ndarray, " V"]
    focal: Num[np.ndarray, " V"]
    radial: Num[np.ndarray, " V"]
    between_deg: float


def camera_intervals(solution: Solution) -> Intervals:
    """The uncertainty that the information of ``solution`` leaves."""
    found, views = solution.unknowns, solution.unknowns.views
    covariance = solution.covariance(PER_CAMERA * views)
    unit = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
    values, axes = np.linalg.eigh(covariance / unit[:, None] / unit[None])
    draws = np.random.default_rng(0).normal(size=(_DRAWS, len(unit))) * np.sqrt(np.maximum(values, 0.0))
    off = (draws @ axes.T * unit).reshape(_DRAWS, views, PER_CAMERA)
    # Turns about the world's axes, and what all cameras have in common removed: a turn, a shift and a scale.
    turns = np.einsum("vji,svj->svi", found.rotations, off[:, :, TURN])
    between = [np.linalg.norm(turns[:, a] - turns[:, b], axis=1) for a, b in combinations(range(views), 2)]
    common = turns.mean(1, keepdims=True)
    centres = found.of_cameras[:, CENTRE] - found.of_cameras[:, CENTRE].mean(0)
    places = off[:, :, CENTRE] - off[:, :, CENTRE].mean(1, keepdims=True) + np.cross(common, centres[None])
    scale = (places * centres).sum((1, 2)) / max(float((centres**2).sum()), 1e-12)
    places -= scale[:, None, None] * centres
    return Intervals(
        np.degrees(np.sqrt(((turns - common) ** 2).mean((0, 2)))),
        np.sqrt((places**2).mean((0, 2))),
        off[:, :, LOG_FOCAL].std(0),
        off[:, :, RADIAL].std(0),
        float(np.degrees(np.quantile(np.max(between, axis=0), 0.95))),
    )
