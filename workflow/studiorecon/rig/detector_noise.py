# SPDX-License-Identifier: Apache-2.0
"""A detector's errors: those of one frame, and those that it repeats while a body is seen from the same side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.estimate.factors.keypoints import SHARED_M, viewing_sides
from studiorecon.estimate.unknowns import PER_CAMERA
from studiorecon.geometry.statistics import SIGMA_OF_MAD
from studiorecon.geometry.triangulation import Limits, unit_px
from studiorecon.keypoints.correspondence import SHOULDERS
from studiorecon.rig.correspondences import Observations
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# Least noise of a detector, as a share of the longer side: half a pixel of 960. Real ones are worse.
_MIN_NOISE = 0.0005


@dataclass(frozen=True)
class DetectorNoise:
    """Standard deviations of keypoints: ``frame_px`` (V,), independent in every frame, and ``shared_m``, across the
    line of sight, constant while a body is seen from one side."""

    frame_px: Num[np.ndarray, " V"]
    shared_m: float

    @classmethod
    def typical(cls, cameras: Sequence[Camera], limits: Limits) -> DetectorNoise:
        """The usual noise, for a detector that has not been measured."""
        return cls(unit_px(cameras, limits) / 2, SHARED_M)


def shared_cells(
    seen: Observations,
    points_m: Num[np.ndarray, "N 3"],
    cameras: Sequence[Camera],
    place: Integer[np.ndarray, "P T K"],
    view: Integer[np.ndarray, " M"],
    point: Integer[np.ndarray, " M"],
) -> tuple[Integer[np.ndarray, " M"], Num[np.ndarray, " M"]]:
    """The cell of each observation, within which errors are shared, and pixels per metre at each.

    ``place``: the point of every person, moment and keypoint, -1 where there is none.
    """
    time = np.unique(seen.frame, return_inverse=True)[1]
    person = np.unique(seen.group, return_inverse=True)[1]
    ends = place[person, time][:, SHOULDERS]
    across = np.where((ends >= 0).all(axis=1, keepdims=True), points_m[ends[:, 0]] - points_m[ends[:, 1]], np.nan)
    rotations = np.stack([c.camera_from_world[:3, :3] for c in cameras])
    side = viewing_sides((rotations[view] @ across[point][..., None])[..., 0])
    key = np.stack([view, person[point], seen.keypoint[point], side], axis=1)
    cell = np.unique(key, axis=0, return_inverse=True)[1].reshape(-1)
    depth = np.stack([c.project(points_m)[1] for c in cameras])[view, point]
    return cell, np.array([c.focal_px[0] for c in cameras])[view] / np.maximum(depth, 0.3)


def measure_detector_noise(
    off: Num[np.ndarray, "M 2"],
    view: Integer[np.ndarray, " M"],
    cell: Integer[np.ndarray, " M"],
    px_per_m: Num[np.ndarray, " M"],
    cameras: Sequence[Camera],
) -> DetectorNoise:
    """The noise of ``off``, residuals in pixels, corrected for the freedom of points and cameras.

    Scatter within a cell is the noise of single frames; the cells' means show the shared error.
    """
    views, count = max(len(cameras), 2), np.bincount(cell)
    taken = np.sqrt(2 * views / (2 * views - 3))
    means = np.stack([np.bincount(cell, o) / count for o in off.T], axis=1)
    frame_px = []
    for v, camera in enumerate(cameras):
        own = np.abs(off - means[cell])[(view == v) & (count[cell] > 1)]
        spread = SIGMA_OF_MAD * float(np.median(own)) if own.size else 0.0
        frame_px.append(max(taken * spread, _MIN_NOISE * max(camera.wh)))
    # Of cells that are the mean of some frames; half of a two-dimensional normal's squares are below 2 ln 2.
    metres = means * (count / np.bincount(cell, px_per_m))[:, None]
    of_frames = np.bincount(cell, np.array(frame_px)[view] / px_per_m) / count / np.sqrt(count)
    squared = np.maximum(((metres**2).sum(1) / 2), 0.0)
    left = 2 * len(count) / max(2 * len(count) - PER_CAMERA * views, 0.2 * len(count))
    variance = taken**2 * left * np.median(squared) / np.log(2) - float(np.median(of_frames**2))
    return DetectorNoise(np.array(frame_px), float(np.sqrt(max(variance, SHARED_M**2))))
