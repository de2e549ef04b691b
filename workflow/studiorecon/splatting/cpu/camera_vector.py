# SPDX-License-Identifier: Apache-2.0
"""A camera in the numbers that the projection kernels take."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.scene.camera import Camera
from studiorecon.splatting.conventions import CAMERA_FLOATS, COMPENSATED, FRAME_MARGIN, LIMITS

if TYPE_CHECKING:
    from jaxtyping import Float


def camera_vector(camera: Camera, near_m: float, antialias: bool = False) -> Float[np.ndarray, " 27"]:
    """The camera as kernels take it, (27,) float32; the centre is computed in float64."""
    (fx, fy), (cx, cy), (width, height) = camera.focal_px, camera.principal_px, camera.wh
    margin_x, margin_y = float(FRAME_MARGIN) * width / fx, float(FRAME_MARGIN) * height / fy
    vector = np.empty(CAMERA_FLOATS, np.float64)
    vector[0:9] = camera.rotation_camera_from_world.ravel()
    vector[9:12] = camera.camera_from_world[:3, 3]
    vector[12:14], vector[14:16], vector[16:18] = (fx, fy), (cx, cy), (width, height)
    vector[18], vector[19:22] = near_m, camera.centre_m
    vector[LIMITS : LIMITS + 4] = (
        -cx / fx - margin_x,
        (width - cx) / fx + margin_x,
        -cy / fy - margin_y,
        (height - cy) / fy + margin_y,
    )
    vector[COMPENSATED] = antialias
    return vector.astype(np.float32)
