# SPDX-License-Identifier: Apache-2.0
"""Factor of a calibration board's corners, which are where the board's pose of a moment puts them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.estimate.factor import Factor
from studiorecon.estimate.factors.keypoints import project
from studiorecon.estimate.unknowns import PER_CAMERA, Unknowns

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# A few corners are found wrong: on reflections, or interpolated while the board turned back.
_FREEDOM = 4.0


# Standard deviation of k2 of lenses that nobody measured: webcams have -0.5 to 0.1 beside k1 of up to 0.3.
_SECOND_SIGMA = 0.25


@dataclass(frozen=True)
class BoardCorners(Factor):
    """Reprojection errors of corners: columns of a camera, its k2 and delay, and a board's pose.

    Attributes:
        view: camera of each.
        corner_m: place on the board.
        pixels: as found.
        speed_px_s: by which a corner moves in the film, as long as its delay is off.
        sigma_px: standard deviation of each.
    """

    view: Integer[np.ndarray, " M"]
    corner_m: Num[np.ndarray, "M 3"]
    pixels: Num[np.ndarray, "M 2"]
    speed_px_s: Num[np.ndarray, "M 2"]
    sigma_px: Num[np.ndarray, " M"]

    def residuals(self, at: Num[np.ndarray, "M 18"], unknowns: Unknowns) -> Num[np.ndarray, "M 2"]:
        second, delay, axis, place = np.split(at[:, PER_CAMERA:], [1, 2, 5], axis=1)
        # Rodrigues' formula, through which complex steps pass; the angle is never exactly 0.
        squared = (axis**2).sum(1, keepdims=True) + 1e-24
        angle = np.sqrt(squared)
        across = np.cross(axis, self.corner_m)
        world = self.corner_m + np.sin(angle) / angle * across
        world = world + (1 - np.cos(angle)) / squared * np.cross(axis, across) + place
        of_point = np.concatenate([at[:, :PER_CAMERA], world], axis=1)
        found = project(of_point, unknowns.rotations[self.view], 1.0, second[:, 0])
        return (found - self.pixels - delay * self.speed_px_s) / self.sigma_px[:, None]


@dataclass(frozen=True)
class SecondCoefficient(Factor):
    """Prior of k2."""

    def residuals(self, at: Num[np.ndarray, "V 1"], unknowns: Unknowns) -> Num[np.ndarray, "V 1"]:
        return at / _SECOND_SIGMA


def board_factors(
    unknowns: Unknowns,
    pixels: Num[np.ndarray, "V M N 2"],
    speed_px_s: Num[np.ndarray, "V M N 2"],
    corners_m: Num[np.ndarray, "N 3"],
    sigma_px: Num[np.ndarray, " V"],
) -> tuple[BoardCorners, SecondCoefficient]:
    """The factors of corners seen at M moments, NaN where not: ``unknowns`` has the boards' poses as the group
    "boards", k2 of the cameras as "second", and what is added to the films' delays (s) as "delays"."""
    view, moment, corner = np.nonzero(np.isfinite(pixels[..., 0]))
    columns = [
        unknowns.columns("cameras", view, range(PER_CAMERA), PER_CAMERA),
        unknowns.columns("second", view, [0], 1),
        unknowns.columns("delays", view, [0], 1),
        unknowns.columns("boards", moment, range(6), 6),
    ]
    at = view, moment, corner
    found = pixels[at], np.nan_to_num(speed_px_s[at])
    corners = BoardCorners(np.concatenate(columns, axis=1), _FREEDOM, view, corners_m[corner], *found, sigma_px[view])
    return corners, SecondCoefficient(unknowns.columns("second", np.arange(unknowns.views), [0], 1), np.inf)
