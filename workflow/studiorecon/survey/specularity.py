# SPDX-License-Identifier: Apache-2.0
"""Change of surfaces' colour with the direction of view."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np
import scipy

from studiorecon.arrays import require
from studiorecon.geometry.statistics import NOTHING, Estimate, share_estimate
from studiorecon.images.channels import channel_sum
from studiorecon.images.exposure import BRIGHTEST, DARKEST
from studiorecon.images.warp import sample
from studiorecon.survey.exposures import ExposureView

if TYPE_CHECKING:
    from jaxtyping import Float

_LIMIT = 0.99
_MIN_POINTS = 200
# Depth and calibration misplace a sample by about this much; where colours change within it, they do not show
# specularity.
_MISPLACED_PX = 1.5
# The gains are estimates, and lenses darken towards the corners: smaller differences than this are not specular.
_FLOOR = 0.01


def specular_share(colours: Float[np.ndarray, "V N 3"], noise: Float[np.ndarray, "V N"]) -> Estimate:
    """Share of points whose brightness varies between views more than its noise allows in one case out of a hundred.

    ``colours`` after exposure correction, NaN where a view does not see the point; ``noise``: standard deviation of the
    mean over channels. Points need two views. The expected share without specularity is 1 %.
    """
    require("colours", colours, ("V", "N", 3))
    require("noise", noise, colours.shape[:2])
    level = colours.mean(axis=-1)
    known = np.isfinite(level) & np.isfinite(noise) & (noise > 0)
    count = known.sum(axis=0)
    enough = count >= 2
    if enough.sum() < _MIN_POINTS:
        return NOTHING
    weight = np.where(known, 1 / np.where(known, noise, 1.0) ** 2, 0.0)[:, enough]
    value = np.where(known, level, 0.0)[:, enough]
    mean = (weight * value).sum(axis=0) / weight.sum(axis=0)
    statistic = (weight * (value - mean) ** 2).sum(axis=0)
    varies = statistic > scipy.special.chdtri(count[enough] - 1, 1 - _LIMIT)
    return share_estimate(int(varies.sum()), int(enough.sum()), enough.sum() / 4)


def covisible_colours(
    views: Sequence[ExposureView], gains: Float[np.ndarray, "V 3"], noise: float, tolerance: float
) -> tuple[Float[np.ndarray, "V N 3"], Float[np.ndarray, "V N"]]:
    """Colours of static points that several views see, divided by ``gains``, and their noise.

    ``noise``, a plate's temporal deviation, grows with the gradient of colours within ``_MISPLACED_PX``.
    """
    colours, errors = [], []
    slopes = [_slope(v.rgb) for v in views]
    for first in views:
        points, _ = first.surface()
        seen, error = np.full((len(views), len(points), 3), np.nan), np.full((len(views), len(points)), np.nan)
        for k, other in enumerate(views if len(points) else ()):
            there, z = other.camera.project(points)
            surface, inside = sample(other.depth_m, there[None], "nearest")
            measured, _ = sample(other.measured, there[None], "nearest")
            rgb, within = sample(other.rgb, there[None])
            slope, _ = sample(slopes[k], there[None], "nearest")
            same = inside[0] & within[0] & measured[0] & (z > 0) & (np.abs(surface[0] - z) <= tolerance * z)
            same &= (rgb[0] > DARKEST).all(-1) & (rgb[0] < BRIGHTEST).all(-1)
            seen[k, same] = (rgb[0] / gains[k])[same]
            error[k, same] = np.sqrt(
                noise**2 + (_MISPLACED_PX * slope[0][same]) ** 2 + (_FLOOR * rgb[0][same].mean(-1)) ** 2
            )
        colours.append(seen)
        errors.append(error)
    return np.concatenate(colours, axis=1), np.concatenate(errors, axis=1)


def _slope(rgb: np.ndarray) -> np.ndarray:
    """(H, W) float32 largest change of brightness per pixel in the neighbourhood."""
    grey = cv2.GaussianBlur(channel_sum(rgb.astype(np.float32)) / 3, (0, 0), 0.7)
    slope = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=1 / 8), cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=1 / 8))
    return cv2.dilate(slope, np.ones((3, 3), np.uint8))
