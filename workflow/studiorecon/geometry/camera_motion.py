# SPDX-License-Identifier: Apache-2.0
"""Cameras at other poses, and without the drift that they have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Num


@dataclass(frozen=True)
class PoseError:
    """Standard deviations of a camera's given rotation and position.

    The defaults are a calibration's error: people and the room turn a motion-capture system's own by up to 0.35°
    between two cameras (``python -m benchmarks.cameras_stale --takes man``).
    """

    turn_deg: float = 0.18
    move_m: float = 0.018


def move_camera(
    camera: Camera, rotation_camera_from_world: Num[np.ndarray, "3 3"], centre_m: Num[np.ndarray, " 3"]
) -> Camera:
    """The camera at another pose."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_camera_from_world, -rotation_camera_from_world @ centre_m
    return replace(camera, camera_from_world=pose)


def remove_drift(
    adjusted: Sequence[Camera], given: Sequence[Camera], weights: Sequence[float] | None = None
) -> tuple[list[Camera], tuple[Num[np.ndarray, "3 3"], Num[np.ndarray, " 3"], float]]:
    """The adjusted cameras without their common rotation, translation and scale against the given ones; that
    similarity.

    Cameras that were not adjusted (held-out ones) stay consistent with them. The rotation is fitted to centres and
    viewing axes together, which determines it for cameras in a line too. The similarity (rotation, translation, scale)
    maps adjusted world points to given ones: X' = scale · rotation · X + translation. ``weights``: positive; equal by
    default.
    """
    new, old = np.stack([c.centre_m for c in adjusted]), np.stack([c.centre_m for c in given])
    share = np.ones(len(new)) if weights is None else np.asarray(weights, np.float64)
    share = share / share.sum()
    new_middle, old_middle = share @ new, share @ old
    root = np.sqrt(share)[:, None]
    new_off, old_off = root * (new - new_middle), root * (old - old_middle)
    spread = max(float(np.sqrt((old_off**2).sum())), 1e-9) * root[..., None]
    axes = np.concatenate(spread * np.stack([c.camera_from_world[:3, :3] for c in adjusted]))
    old_axes = np.concatenate(spread * np.stack([c.camera_from_world[:3, :3] for c in given]))
    u, _, vt = np.linalg.svd(np.concatenate([old_off, old_axes]).T @ np.concatenate([new_off, axes]))
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    scale = float((old_off * (new_off @ rotation.T)).sum() / max((new_off**2).sum(), 1e-12)) if len(new) > 1 else 1.0
    translation = old_middle - scale * rotation @ new_middle
    back = [
        move_camera(c, c.camera_from_world[:3, :3] @ rotation.T, scale * rotation @ c.centre_m + translation)
        for c in adjusted
    ]
    return back, (rotation, translation, scale)
