# SPDX-License-Identifier: Apache-2.0
"""Angles between the training cameras, a measure of their overlap as in the paper's table of camera configurations."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from studiorecon.geometry.camera_path import azimuths_rad, scene_centre
from studiorecon.scene.camera import Camera


def overlap(cameras: Sequence[Camera]) -> dict[str, Any]:
    """``training_cameras``, ``position_deg`` and ``viewing_deg``; the angles are None for a single camera.

    ``position_deg`` is the mean angle between every two cameras about the middle of the scene (U56), ``viewing_deg``
    that of a camera's optical axis with the nearest other one's. Four on an even level ring: 120 and 90.
    """
    if len(cameras) < 2:
        return {"training_cameras": len(cameras), "position_deg": None, "viewing_deg": None}
    azimuth = azimuths_rad(cameras, scene_centre(cameras))
    apart = np.array([np.abs(np.angle(np.exp(1j * (a - b)))) for a, b in combinations(azimuth, 2)])
    axes = np.array([camera.forward / np.linalg.norm(camera.forward) for camera in cameras])
    # By atan2: the arccosine of nearly parallel axes loses all digits.
    sine = np.linalg.norm(np.cross(axes[:, None], axes[None]), axis=-1)
    between = np.arctan2(sine, axes @ axes.T) + np.where(np.eye(len(cameras)), np.inf, 0)
    return {
        "training_cameras": len(cameras),
        "position_deg": float(np.degrees(apart.mean())),
        "viewing_deg": float(np.degrees(between.min(axis=1).mean())),
    }
