# SPDX-License-Identifier: Apache-2.0
"""Differences between cameras in the colour of the surfaces that they share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.statistics import SIGMA_OF_MAD
from studiorecon.images.exposure import Overlap, compare_colours, solve_gains
from studiorecon.images.warp import sample
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Stride in pixels between compared surface points: neighbours share their errors, and count as one.
_STRIDE = 4
# Common surface points that two cameras need. A difference is certain beyond five standard errors; the interval has
# two.
MIN_PIXELS, CERTAIN, INTERVAL = 50, 5.0, 2.0


@dataclass(frozen=True)
class ExposureView:
    """One camera's clean plate: rgb in [0, 1], where it is measured, and the empty room's depth, 0 = unknown."""

    camera: Camera
    rgb: Float[np.ndarray, "H W 3"]
    measured: Bool[np.ndarray, "H W"]
    depth_m: Float[np.ndarray, "H W"]

    def surface(self) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
        """Measured surface points, metres, on every fourth pixel, and their colours."""
        pixels = self.camera.pixel_centres()[::_STRIDE, ::_STRIDE].reshape(-1, 2)
        depth_m = self.depth_m[::_STRIDE, ::_STRIDE].reshape(-1)
        known = np.isfinite(depth_m) & (depth_m > 0) & self.measured[::_STRIDE, ::_STRIDE].reshape(-1)
        points_m = self.camera.unproject(pixels[known], depth_m[known])
        return points_m, self.rgb[::_STRIDE, ::_STRIDE].reshape(-1, 3)[known]


def camera_overlaps(
    views: Sequence[ExposureView], tolerance: float, least_pixels: int
) -> tuple[list[Overlap], list[float]]:
    """Colour ratios of every pair of cameras on surfaces of depths equal to ``tolerance``, and standard errors."""
    found, errors = [], []
    for i, first in enumerate(views):
        points, colours = first.surface()
        for j, second in enumerate(views):
            if i == j or not len(points):
                continue
            there, z = second.camera.project(points)
            surface, inside = sample(second.depth_m, there[None], "nearest")
            rgb, within = sample(second.rgb, there[None])
            measured, _ = sample(second.measured, there[None], "nearest")
            same = inside[0] & within[0] & measured[0] & (z > 0) & (np.abs(surface[0] - z) <= tolerance * z)
            overlap = compare_colours(i, j, colours[same], rgb[0][same], least_pixels)
            if overlap is not None:
                found.append(overlap)
                errors.append(_standard_error(colours[same], rgb[0][same], overlap))
    return found, errors


def gain_disagreement(
    cameras: int, found: Sequence[Overlap], errors: Sequence[float]
) -> tuple[float, float, Float[np.ndarray, "V 3"]]:
    """Largest |gain − 1| over cameras and channels, that camera's standard error, and the gains (cameras, 3)."""
    gains = solve_gains(cameras, found)
    worst = int(np.abs(gains - 1).max(axis=1).argmax())
    # Covariance of the least-squares gains, with their common factor fixed at 1.
    design = np.zeros((len(found), cameras))
    for row, overlap in enumerate(found):
        design[row, overlap.first], design[row, overlap.second] = 1, -1
    information = design.T @ (design / np.maximum(np.array(errors), 1e-6)[:, None] ** 2)
    error = float(np.sqrt(max(np.linalg.pinv(information, rcond=1e-9)[worst, worst], 0.0)))
    return float(np.abs(gains - 1).max()), error, gains


def _standard_error(first: np.ndarray, second: np.ndarray, overlap: Overlap) -> float:
    """Standard error of the median log ratio: 1.25 robust deviations over the root of the count."""
    ratio = np.log(np.maximum(first, 1e-3)) - np.log(np.maximum(second, 1e-3)) - overlap.log_ratio
    deviation = SIGMA_OF_MAD * float(np.median(np.abs(ratio)))
    return 1.25 * deviation / np.sqrt(overlap.pixels)
