# SPDX-License-Identifier: Apache-2.0
"""The volume that the cameras cover, and directions without a camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float

_GRID = 24
_ROOM_HEIGHT_M = 2.2


def coverage(cameras: Sequence[Camera], middle_m: Float[np.ndarray, " 2"], radius_m: float) -> list[float]:
    """Share of the upright cylinder around ``middle_m``, 2.2 m high, that at least 1, 2, 3, 4 cameras see."""
    x, y, z = np.meshgrid(
        *(np.linspace(-1, 1, _GRID),) * 2, np.linspace(0.05, _ROOM_HEIGHT_M, _GRID // 2), indexing="ij"
    )
    inside = x**2 + y**2 <= 1
    points = np.stack([middle_m[0] + radius_m * x[inside], middle_m[1] + radius_m * y[inside], z[inside]], axis=-1)
    seen = np.zeros(len(points), dtype=int)
    for camera in cameras:
        pixels, depth = camera.project(points)
        seen += (
            (depth > 0.1)
            & (np.nan_to_num(pixels, nan=-1.0) >= 0).all(-1)
            & (np.nan_to_num(pixels, nan=1e9) < camera.wh).all(-1)
        )
    return [float((seen >= n).mean()) for n in (1, 2, 3, 4)]


def blind_sectors(
    cameras: Sequence[Camera], middle_m: Float[np.ndarray, " 2"], least_deg: float = 90.0
) -> list[tuple[float, float]]:
    """(from, to) in degrees, counter-clockwise from x, of sectors around ``middle_m`` without a camera, widest
    first."""
    offsets = np.array([c.centre_m[:2] - middle_m for c in cameras])
    angles = np.sort(np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0])) % 360)
    gaps = [(float(a), float(b)) for a, b in zip(angles, np.append(angles[1:], angles[0] + 360)) if b - a > least_deg]
    return sorted(gaps, key=lambda g: g[0] - g[1])
