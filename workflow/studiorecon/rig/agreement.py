# SPDX-License-Identifier: Apache-2.0
"""How well cameras agree with the people they see, and how well they must."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.camera_motion import PoseError
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.rig.correspondences import Observations
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Num

# Multiple of the usual outlier distance within which errors are counted: cameras that are off show larger ones.
_LOOSE = 3.0


@dataclass(frozen=True)
class AgreementLimits:
    """When cameras agree with people; a setting of every step that judges or moves cameras on people.

    A calibration is refused when people's keypoints are off by more than ``max_error_share`` of the longer image side,
    and by more than ``max_error_m`` at their distance.
    Tracks of two cameras may be one person when their rays pass within ``gate_m``, a wide gate, since poses may be off.
    """

    # The worst real calibration that refinement could still use was 0.7 % off, a shuffled one 1.2 %.
    max_error_share: float = 0.01
    # A right calibration of webcams 1 m from a seated man left 19 mm: detectors mark another point of a joint in every
    # view. Beyond about 2 m the share above is larger.
    max_error_m: float = 0.03
    gate_m: float = 0.25
    limits: Limits = Limits()

    def limit_px(self, cameras: Sequence[Camera], points_m: Num[np.ndarray, "N 3"]) -> float:
        """The largest median error of people's keypoints at ``points_m`` that is allowed, pixels."""
        of_picture = self.max_error_share * max(max(c.wh) for c in cameras)
        return max(of_picture, self.max_error_m / metres_per_px(cameras, points_m)) if len(points_m) else of_picture


def metres_per_px(cameras: Sequence[Camera], points_m: Num[np.ndarray, "N 3"]) -> float:
    """Size of a pixel of the median camera at its median point, metres."""
    return float(np.median([np.median(c.project(points_m)[1]) / np.mean(c.focal_px) for c in cameras]))


@dataclass(frozen=True)
class CalibrationPrior:
    """The prior of the given cameras' poses, for refinement on people."""

    pose_error: PoseError = PoseError()


@dataclass(frozen=True)
class RefinementLimits(AgreementLimits, CalibrationPrior):
    """What refinement on people needs: when cameras agree, and how far the given ones may be off."""


def error_medians(
    cameras: Sequence[Camera], seen: Observations, limits: Limits
) -> tuple[float, list[float | None], Num[np.ndarray, "N 3"]]:
    """Median reprojection error in pixels over all views and per camera (None: nothing seen), and the points valid
    there.

    Points need three views where there are three cameras: the residual of a pair proves nothing (T13).
    """
    found = triangulate(
        seen.pixels, seen.confidence, cameras, replace(limits, outlier_units=limits.outlier_units * _LOOSE)
    )
    counted = found.verified if len(cameras) > 2 else found.valid
    error = np.where(counted, found.error_px, np.nan)
    per_camera = [float(np.median(row[np.isfinite(row)])) if np.isfinite(row).any() else None for row in error]
    pooled = error[np.isfinite(error)]
    return (float(np.median(pooled)) if len(pooled) else float("nan")), per_camera, found.points_m[counted]


def contradicted_share(
    cameras: Sequence[Camera], seen: Observations, detections: Sequence[Detections], limits: Limits
) -> float:
    """Share of the points of two views that are in a third one's picture, which detected people in that frame, but not
    there."""
    found = triangulate(
        seen.pixels, seen.confidence, cameras, replace(limits, outlier_units=limits.outlier_units * _LOOSE)
    )
    elsewhere = np.zeros(len(seen.frame), dtype=bool)
    for v, (camera, d) in enumerate(zip(cameras, detections)):
        pixels, depth = camera.project(np.where(found.valid[:, None], found.points_m, np.nan))
        inside = (
            (np.nan_to_num(depth) > 0)
            & (np.nan_to_num(pixels, nan=-1.0) >= 0).all(-1)
            & (np.nan_to_num(pixels) < camera.wh).all(-1)
        )
        elsewhere |= inside & np.isin(seen.frame, d.frame) & ~found.inliers[v]
    return float(elsewhere[found.valid].mean()) if found.valid.any() else 0.0
