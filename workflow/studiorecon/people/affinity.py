# SPDX-License-Identifier: Apache-2.0
"""Affinity of detections that come with a monocular body: position and pose, as in the paper, with every unit stated.

affinity = exp(-(d / sigma_p)²/2) · exp(-(θ / sigma_θ)²/2), d between pelvises in metres, θ the mean angle of the body joints
without the root (numerics U27). The pelvis is lifted by depth and moved inside the body (U26, C11).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studiorecon.geometry.rotations import angle
from studiorecon.scene.camera import Camera

# A depth map shows the skin; the pelvis joint lies this far behind it along the ray (numerics C11).
PELVIS_DEPTH_M = 0.13


def lift_pelvis(camera: Camera, pixels: np.ndarray, depth_patches_m: np.ndarray, near_m: float) -> tuple[np.ndarray, np.ndarray]:
    """World pelvises (D, 3) of pixels (D, 2), NaN and valid=False where no depth of its patch (D, P) is finite and past ``near_m``.

    The depth is the median of the usable patch depths (C04); 0.13 m are added along the ray, not in z.
    """
    usable = np.isfinite(depth_patches_m) & (depth_patches_m > near_m)
    ordered = np.sort(np.where(usable, depth_patches_m, np.inf), axis=-1)
    middle = np.take_along_axis(ordered, np.maximum((usable.sum(-1) - 1) // 2, 0)[:, None], axis=-1)[:, 0]
    valid = usable.any(-1) & np.isfinite(pixels).all(-1)
    surface = camera.unproject(np.where(valid[:, None], pixels, 0.0), np.where(valid, middle, 1.0))
    ray = surface - camera.centre_m
    pelvis = surface + PELVIS_DEPTH_M * ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    return np.where(valid[:, None], pelvis, np.nan), valid


def pose_distances(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(A, B) mean angle in radians over joints of body rotations (A, J, 3, 3) and (B, J, 3, 3), the root not among them (A06-A08)."""
    return angle(first[:, None], second[None]).mean(-1)


def affinities(distance_m: np.ndarray, pose_rad: np.ndarray | None, gate_m: float, sigma_m: float, sigma_rad: float) -> np.ndarray:
    """Affinity in [0, 1] of distances, 0 where past the gate or not finite, so that neither is ever assigned (A02, A03, A13)."""
    with np.errstate(invalid="ignore"):
        inside = np.isfinite(distance_m) & (distance_m < gate_m)
    value = np.exp(-0.5 * (np.where(inside, distance_m, 0.0) / sigma_m) ** 2)
    if pose_rad is not None:
        inside &= np.isfinite(pose_rad)
        value = value * np.exp(-0.5 * (np.where(inside, pose_rad, 0.0) / sigma_rad) ** 2)
    return np.where(inside, value, 0.0)


def window_distances(positions_m: Sequence[np.ndarray]) -> np.ndarray:
    """(M, M) distance of M tracks' positions (T, 3), NaN where unseen, averaged over the frames they share (A11); NaN where none.

    Averaging before the norm lets independent depth errors cancel; averaging distances would keep them.
    """
    count = len(positions_m)
    distance = np.full((count, count), np.nan)
    for i in range(count):
        for j in range(i + 1, count):
            shared = np.isfinite(positions_m[i]).all(-1) & np.isfinite(positions_m[j]).all(-1)
            if shared.any():
                offset = (positions_m[i][shared] - positions_m[j][shared]).mean(0)
                distance[i, j] = distance[j, i] = np.linalg.norm(offset)
    return distance


def margin(affinity: np.ndarray) -> np.ndarray:
    """(A,) best minus second best of every row of (A, B): below 0.05 the row is undecided and needs more frames (A12)."""
    if affinity.shape[1] < 2:
        return affinity.max(-1, initial=0.0)
    ordered = np.sort(affinity, axis=-1)
    return ordered[:, -1] - ordered[:, -2]
