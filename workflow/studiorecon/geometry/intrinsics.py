# SPDX-License-Identifier: Apache-2.0
"""The focal length of a camera from the points that a network placed in its own axes (numerics U60: such networks return no K)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from studiorecon.arrays import require

_LEAST_POINTS = 50
_ROUNDS = 100
# Huber's limit in robust standard deviations.
_HUBER = 1.5
# Offsets from the centre smaller than this share of the longer side carry noise and no focal length.
_LEAST_OFFSET = 0.02


@dataclass(frozen=True)
class FittedFocal:
    """Square pixels, principal point in the middle of the picture.

    Attributes:
        focal_px: NaN when undetermined.
        error_px: median distance between a pixel and the projection of its point: more than a pixel or two means that the points do
            not come from a pinhole with these assumptions (a cropped picture, a strong lens).
        used: number of points that took part.
        reason: one clause why the focal length is undetermined; empty when it is determined.
    """

    focal_px: float
    error_px: float
    used: int
    reason: str

    def intrinsics(self, wh: tuple[int, int]) -> np.ndarray:
        """(3, 3) for a picture of ``wh`` pixels, centres at +0.5."""
        return np.array([[self.focal_px, 0, wh[0] / 2], [0, self.focal_px, wh[1] / 2], [0, 0, 1.0]])


def focal_from_points(
    points: np.ndarray, pixels: np.ndarray, confidence: np.ndarray, wh: tuple[int, int], least_confidence: float
) -> FittedFocal:
    """The focal length f in pixel − centre ≈ f · (x, y)/z of ``points`` (..., 3) in camera axes, seen at ``pixels`` (..., 2).

    ``confidence`` (...,) as probabilities (U23: after the sigmoid); points below ``least_confidence``, behind the camera or not finite
    are left out. Robust: the median of |pixel − centre| / |(x, y)/z| as start, then Huber on the two-dimensional residual, cut at
    twice its limit. The unit of length does not matter. Undetermined with fewer than 50 points or with none off the optical axis.
    Raises ValueError that names the argument when shapes do not fit.
    """
    points, pixels = np.asarray(points, dtype=np.float64), np.asarray(pixels, dtype=np.float64)
    require("points", points, (..., 3))
    require("pixels", pixels, (*points.shape[:-1], 2))
    require("confidence", confidence, points.shape[:-1])
    flat, offset = points.reshape(-1, 3), pixels.reshape(-1, 2) - np.array(wh) / 2
    usable = np.isfinite(flat).all(-1) & np.isfinite(offset).all(-1) & (flat[:, 2] > 0) & (np.ravel(confidence) >= least_confidence)
    flat, offset = flat[usable], offset[usable]
    slope = flat[:, :2] / flat[:, 2:]
    away, tangent = np.linalg.norm(offset, axis=-1), np.linalg.norm(slope, axis=-1)
    telling = (away > _LEAST_OFFSET * max(wh)) & (tangent > 0)
    if telling.sum() < _LEAST_POINTS:
        reason = f"only {int(telling.sum())} confident points lie off the optical axis, {_LEAST_POINTS} are needed"
        return FittedFocal(np.nan, np.nan, int(telling.sum()), reason)
    focal = float(np.median(away[telling] / tangent[telling]))
    for _ in range(_ROUNDS):
        error = np.linalg.norm(offset - focal * slope, axis=-1)
        sigma = max(1.4826 * float(np.median(error)), 1e-9)
        # Nothing beyond twice Huber's limit: a point put almost beside the camera has an unbounded slope, and with it unbounded pull.
        weight = np.where(error < 2 * _HUBER * sigma, np.minimum(1.0, _HUBER * sigma / np.maximum(error, 1e-300)), 0.0)
        new = float((weight * (offset * slope).sum(-1)).sum() / (weight * (slope**2).sum(-1)).sum())
        if abs(new - focal) <= 1e-12 * abs(focal):
            break
        focal = new
    if not focal > 0:
        return FittedFocal(
            np.nan, np.nan, len(offset), "the points lie on the wrong side of the optical axis: their axes are not x right, y down"
        )
    return FittedFocal(focal, float(np.median(np.linalg.norm(offset - focal * slope, axis=-1))), len(offset), "")
