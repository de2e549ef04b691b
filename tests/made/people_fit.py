# SPDX-License-Identifier: Apache-2.0
"""What tests of people fit and their neighbours share."""

from __future__ import annotations

import numpy as np
from studiorecon.scene.camera import Camera

from tests.made.cameras import look_at

FPS, FRAMES, WH = 30.0, 40, (1280, 704)


def look(name: str, azimuth_deg: float) -> Camera:
    a = np.deg2rad(azimuth_deg)
    return look_at(name, np.array([4 * np.cos(a), 4 * np.sin(a), 2.2]), np.array([0, 0, 1.0]), WH, 900.0)
