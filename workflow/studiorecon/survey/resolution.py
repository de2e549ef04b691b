# SPDX-License-Identifier: Apache-2.0
"""How much of a body the pictures resolve, hands and faces; and how deep the room is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require
from studiorecon.geometry.statistics import NOTHING, Estimate, median, share
from studiorecon.geometry.triangulation import Limits
from studiorecon.rig.body_points import Tracks, in_world
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float

# Metres from wrist to fingertips, and from chin to crown, of a mean adult.
HAND_M, HEAD_M = 0.19, 0.22
# A view is sure of a keypoint above this confidence; two sure views must look from this far apart, in this share of the
# frames.
_SURE, _APART_DEG, _FRAMES_SHARE = 0.5, 10.0, 0.3
_LEAST = 20
# Keypoints of successive frames err together.
_TOGETHER = 4


def resolved_px(
    points_m: Float[np.ndarray, "N 3"], confidence: Float[np.ndarray, "V N"], cameras: Sequence[Camera], size_m: float
) -> tuple[Estimate, Estimate]:
    """Height in pixels of a part of ``size_m`` in its best view, and the share of frames in which two views are sure of
    it.

    ``points_m`` (N, 3) where the part is, frame by frame, NaN unknown; ``confidence`` (V, N) of its keypoint, 0 where
    missing. "Two views" means surer than one half, and looking from directions more than 10 degrees apart. Nothing when
    it is known in fewer than twenty frames.
    """
    require("confidence", confidence, (len(cameras), len(points_m)))
    known = np.isfinite(points_m).all(-1)
    if known.sum() < _LEAST:
        return NOTHING, NOTHING
    points, sure = points_m[known], confidence[:, known] > _SURE
    depth = np.stack([c.project(points)[1] for c in cameras])
    focal = np.array([c.focal_px[1] for c in cameras])[:, None]
    height = np.where(sure & (depth > 0), focal * size_m / np.where(depth > 0, depth, 1.0), np.nan)
    seen = np.isfinite(height).any(axis=0)
    best = np.nanmax(height[:, seen], axis=0) if seen.any() else np.zeros(0)
    rays = np.stack([points - c.centre_m for c in cameras])
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    apart = np.zeros(len(points), bool)
    for i in range(len(cameras)):
        for j in range(i):
            apart |= sure[i] & sure[j] & ((rays[i] * rays[j]).sum(-1) < np.cos(np.radians(_APART_DEG)))
    return median(best, _LEAST), share(int(apart.sum()), len(apart), len(apart) / _TOGETHER)


def part_height(
    tracks: Tracks,
    names: Sequence[str],
    cameras: Sequence[Camera],
    size_m: float,
    part: str,
    limits: Limits,
    threshold_px: float,
) -> tuple[float | None, tuple[float, float] | None, str]:
    """Height in px of the ``part`` at keypoints of ``names`` in its best view, its interval, and a sentence.

    Size does not help what is rarely seen: where two views are sure of it in few frames, the height is lowered to the
    multiple of ``threshold_px`` that this share of frames is of the least one.
    """
    points, confidence = in_world(tracks, names, cameras, limits)
    # Left and right, and everybody, one after the other: frames in which some hand is seen.
    height, sure = resolved_px(points.reshape(-1, 3), confidence.reshape(len(cameras), -1), cameras, size_m)
    reason = f"{part} is seen by two sure views too rarely to be measured"
    if not points.size:
        reason = f"no keypoints named {' or '.join(names)} are there"
    value, interval = height.value, height.interval
    if value is not None and interval is not None and sure.value is not None and sure.interval is not None:
        reason = (
            f"{part} is {value:.0f} px high in its best view, and two views are sure of "
            f"it in {sure.value:.0%} of the frames"
        )
        if sure.value < _FRAMES_SHARE:
            by_views = [threshold_px * s / _FRAMES_SHARE for s in (sure.interval[0], sure.value, sure.interval[1])]
            low, value, high = (min(a, b) for a, b in zip(by_views, (interval[0], value, interval[1])))
            interval = (low, high)
        reason += "; the body here has neither fingers nor a face, so this only says what is lost"
    return value, interval, reason


def depth_spread(depth_m: Float[np.ndarray, "H W"]) -> Estimate:
    """Robust spread (1.48 MAD) of known static depths over their median, with the scatter of that between quarters of
    the picture."""
    known = np.isfinite(depth_m) & (depth_m > 0)
    if known.sum() < 10 * _LEAST:
        return NOTHING
    # Four interleaved quarters see the same room: their scatter is the sampling error alone.
    quarters = [depth_m[i::2, j::2][known[i::2, j::2]] for i in (0, 1) for j in (0, 1)]
    value = _spread(depth_m[known])
    error = float(np.std([_spread(q) for q in quarters if len(q)]) / 2)
    return Estimate(value, (value - 2 * error, value + 2 * error))


def _spread(values: np.ndarray) -> float:
    middle = np.median(values)
    return float(1.4826 * np.median(np.abs(values - middle)) / middle)
