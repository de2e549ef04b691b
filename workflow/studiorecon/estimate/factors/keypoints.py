# SPDX-License-Identifier: Apache-2.0
"""Factor of people's joints in the pictures.

A detector's error of a joint is partly new in every frame, and partly the same while the body is seen from the same
side. So the variance of a joint's pixels is that of the frame's noise, plus the shared one times the number of frames
that share it: their mean then has the right uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.estimate.factor import Factor
from studiorecon.estimate.unknowns import CENTRE, LOG_FOCAL, PER_CAMERA, PRINCIPAL, RADIAL, TURN, Unknowns

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# Least standard deviation of the shared error across the line of sight, metres. Joints of BlazePose and OpenPose on a
# real man differ by 1 to 2 cm between views; with less, intervals of cameras around him did not hold the truth.
SHARED_M = 0.015
# The shared error is another one when a body is seen from this much further round.
SIDES = 6
# A point behind its camera counts as this near before it, metres: a step may not divide by 0.
_NEAR_M = 0.05


@dataclass(frozen=True)
class Keypoints(Factor):
    """Reprojection errors of points.

    Attributes:
        view: camera of each.
        pixels: distorted pixels.
        sigma_px: standard deviations.
        aspect: height of a pixel's focal length over its width.
    """

    view: Integer[np.ndarray, " M"]
    pixels: Num[np.ndarray, "M 2"]
    sigma_px: Num[np.ndarray, " M"]
    aspect: Num[np.ndarray, " M"]

    def residuals(self, at: Num[np.ndarray, "M 13"], unknowns: Unknowns) -> Num[np.ndarray, "M 2"]:
        found = project(at, unknowns.rotations[self.view], self.aspect)
        return (found - self.pixels) / self.sigma_px[:, None]


def keypoint_factor(
    unknowns: Unknowns,
    view: Integer[np.ndarray, " M"],
    point: Integer[np.ndarray, " M"],
    pixels: Num[np.ndarray, "M 2"],
    sigma_px: Num[np.ndarray, " M"],
    aspect: Num[np.ndarray, " V"],
) -> Keypoints:
    """The factor of observations of ``point`` by ``view``."""
    # A few per cent of joints are elsewhere.
    return Keypoints(point_columns(unknowns, view, point), 4.0, view, pixels, sigma_px, aspect[view])


def viewing_sides(across: Num[np.ndarray, "M 3"]) -> Integer[np.ndarray, " M"]:
    """Side from which each body is seen, 0 … ``SIDES`` - 1, by the direction of its shoulders in the camera's axes; -1
    unknown."""
    side = np.floor((np.arctan2(across[:, 2], across[:, 0]) + np.pi) / (2 * np.pi) * SIDES)
    return np.where(np.isfinite(side), np.clip(np.nan_to_num(side), 0, SIDES - 1), -1).astype(int)


def point_columns(
    unknowns: Unknowns, view: Integer[np.ndarray, " M"], point: Integer[np.ndarray, " M"]
) -> Integer[np.ndarray, "M 13"]:
    """Columns of a camera and a point."""
    return np.concatenate(
        [
            unknowns.columns("cameras", view, range(PER_CAMERA), PER_CAMERA),
            unknowns.columns("points", point, range(3), 3),
        ],
        axis=1,
    )


def project(
    at: Num[np.ndarray, "M 13"],
    rotations: Num[np.ndarray, "M 3 3"],
    aspect: Num[np.ndarray, " M"] | float,
    second: Num[np.ndarray, " M"] | float = 0.0,
) -> Num[np.ndarray, "M 2"]:
    """Distorted pixels of points, by k1 and ``second`` = k2; one behind its camera counts as just before it."""
    from_centre = at[:, PER_CAMERA:] - at[:, CENTRE]
    x, y, z = np.moveaxis((rotations @ from_centre[..., None])[..., 0], -1, 0)
    turn = at[:, TURN]
    x, y, z = (
        x + turn[:, 1] * z - turn[:, 2] * y,
        y + turn[:, 2] * x - turn[:, 0] * z,
        z + turn[:, 0] * y - turn[:, 1] * x,
    )
    z = np.where(z.real > _NEAR_M, z, _NEAR_M)
    x, y = x / z, y / z
    off = x * x + y * y
    bent = np.exp(at[:, LOG_FOCAL]) * (1 + off * (at[:, RADIAL] + off * second))
    return np.stack([x * bent, y * bent * aspect], axis=-1) + at[:, PRINCIPAL]
