# SPDX-License-Identifier: Apache-2.0
"""What tests of people fit and their neighbours share."""

from __future__ import annotations

import numpy as np
from studiorecon.scene.camera import Camera

FPS, FRAMES, WH = 30.0, 40, (1280, 704)


def look(name: str, azimuth_deg: float) -> Camera:
    a = np.deg2rad(azimuth_deg)
    centre, target = np.array([4 * np.cos(a), 4 * np.sin(a), 2.2]), np.array([0, 0, 1.0])
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, [0, 0, 1])
    rows = np.stack([right / np.linalg.norm(right), np.cross(forward, right / np.linalg.norm(right)), forward])
    camera_from_world = np.eye(4)
    camera_from_world[:3] = np.column_stack([rows, -rows @ centre])
    return Camera(name, WH, np.array([[900.0, 0, 640], [0, 900, 352], [0, 0, 1]]), camera_from_world)
