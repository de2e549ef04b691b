# SPDX-License-Identifier: Apache-2.0
"""Up and the floor from people: they are upright on average, and their lower foot is on the floor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.estimate.factors.poses import ANKLE_HEIGHT_M
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.keypoints.correspondence import ANKLES, SHOULDERS, STABLE_KEYPOINTS
from studiorecon.progress import warn
from studiorecon.rig.correspondences import Observations
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# Feet in an area narrower than this do not determine the floor's slope.
_MIN_FLOOR_M = 0.25
_MAX_TILT_DEG = 12.0
_ROUNDS = 20
# Bodies from ankles to shoulders in fewer frames than this may all be leaning.
_MIN_UPRIGHT = 20


def people_tilt(
    points_m: Num[np.ndarray, "N 3"],
    group: Num[np.ndarray, " N"],
    frame: Num[np.ndarray, " N"],
    keypoint: Num[np.ndarray, " N"],
) -> float | None:
    """Degrees by which people lean against the world's z, in the robust mean; None where too few show ankles and
    shoulders.

    Points as for ``world_from_people``. Up to 12° people may share a lean; beyond that, the world is tilted.
    """
    upright = _upright(points_m, group, frame, keypoint)[1]
    if len(upright) < _MIN_UPRIGHT:
        return None
    up = _robust_direction(upright / np.linalg.norm(upright, axis=-1, keepdims=True))
    return float(np.degrees(np.arctan2(np.hypot(up[0], up[1]), up[2])))


def check_tilt(cameras: Sequence[Camera], seen: Observations, limits: Limits) -> float | None:
    """``people_tilt`` of the cameras' people, with a warning where the world is tilted."""
    if not len(seen.frame):
        return None
    found = triangulate(seen.pixels, seen.confidence, cameras, limits)
    points_m = np.where(found.valid[:, None], found.points_m, np.nan)
    tilt = people_tilt(points_m, seen.group, seen.frame, seen.keypoint)
    if tilt is not None and tilt > _MAX_TILT_DEG:
        warn(
            f"people lean {tilt:.0f}° from the world's vertical: the calibration's floor is "
            "tilted, or another axis points up; set calibration.up (x, -x, y, -y, z or -z), or "
            "add a calibration with a level floor"
        )
    return tilt


def lower_feet(
    points_m: Num[np.ndarray, "N 3"], seen: Observations, counted: Bool[np.ndarray, " N"]
) -> Num[np.ndarray, "B 3"]:
    """The lower of the ``counted`` ankles of every body, by people and frames: that foot is on the floor."""
    of = np.flatnonzero(counted & np.isin(seen.keypoint, ANKLES))
    of = of[np.lexsort([points_m[of, 2], seen.frame[of], seen.group[of]])]
    first = np.unique(np.stack([seen.group[of], seen.frame[of]]), axis=1, return_index=True)[1]
    return points_m[of[first]]


def _upright(
    points_m: np.ndarray, group: np.ndarray, frame: np.ndarray, keypoint: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(B, 12, 3) keypoints of every body in every frame, NaN unknown, and (U, 3) from ankles to shoulders where both
    are known."""
    _, body = np.unique(np.stack([group, frame], axis=1), axis=0, return_inverse=True)
    body = body.reshape(-1)
    grid = np.full((int(body.max(initial=-1)) + 1, len(STABLE_KEYPOINTS), 3), np.nan)
    grid[body, keypoint] = points_m
    upright = grid[:, SHOULDERS].mean(1) - grid[:, ANKLES].mean(1)
    return grid, upright[np.isfinite(upright).all(-1)]


def world_from_people(
    points_m: Num[np.ndarray, "N 3"],
    group: Num[np.ndarray, " N"],
    frame: Num[np.ndarray, " N"],
    keypoint: Num[np.ndarray, " N"],
    room: Num[np.ndarray, "3 3"] | None = None,
) -> tuple[Num[np.ndarray, "4 4"], str] | None:
    """Rigid transform to z up with the floor at z = 0 below people's middle, and its method; None without bodies.

    ``points_m``, NaN unknown, belong to ``group``, ``frame`` and ``keypoint``. The robust mean of all directions from
    ankles to shoulders is right up to a lean that people share. The plane of the lower ankles replaces it where feet
    were in an area, not on a line, and the two agree within 12°. Of the ``room``'s directions (columns) the one within
    12° of that is up: walls are more upright than people.
    """
    grid, upright = _upright(points_m, group, frame, keypoint)
    if not len(upright):
        return None
    up = _robust_direction(upright / np.linalg.norm(upright, axis=-1, keepdims=True))
    ankles = grid[:, ANKLES]
    both = np.isfinite(ankles).all((1, 2))
    lower = ankles[both][np.arange(both.sum()), (ankles[both] @ up).argmin(1)]
    normal, spread_m = _plane(lower, up)
    tilt = np.degrees(np.arctan2(np.linalg.norm(np.cross(normal, up)), normal @ up))
    how = (
        f"up is the mean of {len(upright)} upright bodies; their feet were within {spread_m:.2f} "
        "m, too little to show the floor"
    )
    if spread_m >= _MIN_FLOOR_M and tilt <= _MAX_TILT_DEG:
        how = f"up is the normal of the floor under {len(lower)} steps, {tilt:.1f}° from the mean of upright bodies"
        up = normal
    elif spread_m >= _MIN_FLOOR_M:
        how = (
            f"up is the mean of {len(upright)} upright bodies; the plane of their feet leans "
            f"{tilt:.0f}° against it and is not used"
        )
    if room is not None:
        along = room.T @ up
        vertical = room[:, np.abs(along).argmax()] * np.sign(along[np.abs(along).argmax()])
        off = np.degrees(np.arctan2(np.linalg.norm(np.cross(vertical, up)), vertical @ up))
        if off <= _MAX_TILT_DEG:
            up, how = vertical, f"up is the vertical of the room's edges, {off:.1f}° from people's"
    right = np.cross(np.eye(3)[int(np.argmin(np.abs(up)))], up)
    right /= np.linalg.norm(right)
    transform = np.eye(4)
    transform[:3, :3] = np.stack([right, np.cross(up, right), up])
    middle = np.nanmedian(points_m, axis=0)
    floor = float(np.median(lower @ up)) - ANKLE_HEIGHT_M
    transform[:3, 3] = -transform[:3, :3] @ middle
    transform[2, 3] = -floor
    return transform, how


def _robust_direction(directions: np.ndarray) -> np.ndarray:
    """(3,) unit vector with the smallest summed angle-like distance to unit vectors (N, 3), so that people who bend or
    sit are outliers."""
    mean = np.median(directions, axis=0)
    for _ in range(_ROUNDS):
        weight = 1 / np.maximum(np.linalg.norm(directions - mean, axis=-1), 0.02)
        mean = (weight[:, None] * directions).sum(0) / weight.sum()
        mean /= np.linalg.norm(mean)
    return mean


def _plane(points: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, float]:
    """(3,) normal of the plane of points (N, 3) on the side of ``up``, and their spread across their narrow direction,
    metres.

    The plane is a height over the directions across ``up``, so that a foot in the air is an error along ``up`` which a
    Cauchy weight can reject.
    """
    across = np.linalg.svd(up[None])[2][1:]
    flat, height = points @ across.T, points @ up
    flat = flat - flat.mean(0)
    spread = float(np.sqrt(max(np.linalg.eigvalsh(flat.T @ flat / max(len(flat), 1))[0], 0.0)))
    design = np.column_stack([flat, np.ones(len(flat))])
    weight = np.ones(len(flat))
    slope = np.zeros(3)
    for _ in range(_ROUNDS):
        slope = np.linalg.lstsq(design * weight[:, None], height * weight, rcond=None)[0]
        error = height - design @ slope
        weight = np.sqrt(1 / (1 + (error / 0.03) ** 2))
    normal = up - slope[0] * across[0] - slope[1] * across[1]
    return normal / np.linalg.norm(normal), spread
