# SPDX-License-Identifier: Apache-2.0
"""The surface that a depth map measures: points, normals, and where the surface breaks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Num


def depth_breaks(depth_m: Num[np.ndarray, "H W"], jump: float) -> Bool[np.ndarray, "H W"]:
    """Pixels next to a jump in depth or next to unknown depth. Raises ValueError for a ``depth_m`` that is no map.

    The measure is the second difference of 1/z times z: it is 0 on a plane, however slanted, because 1/z is linear in
    pixels on a plane; a step from z to z(1 + ``jump``) has about ``jump``. Sampling must not interpolate there (C12).
    """
    require("depth_m", depth_m, ("H", "W"))
    known = np.isfinite(depth_m) & (depth_m > 0)
    depth_m = np.where(known, depth_m, 1.0)
    inverse = np.where(known, 1.0 / depth_m, 0.0)
    padded = np.pad(inverse, 1, mode="edge")
    bends = [
        np.abs(padded[1:-1, 2:] - 2 * inverse + padded[1:-1, :-2]),
        np.abs(padded[2:, 1:-1] - 2 * inverse + padded[:-2, 1:-1]),
    ]
    # At the image border the replicated neighbour turns a slope into a bend, which is no evidence of a break.
    bends[0][:, [0, -1]] = 0
    bends[1][[0, -1], :] = 0
    broken = np.maximum(*bends) * depth_m > jump
    unknown_near = cv2.dilate((~known).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return broken | unknown_near


def points_and_normals(
    depth_m: Num[np.ndarray, "H W"], camera: Camera, jump: float = np.inf
) -> tuple[Num[np.ndarray, "H W 3"], Num[np.ndarray, "H W 3"], Bool[np.ndarray, "H W"]]:
    """World points, unit normals towards the camera, and where both are measured.

    Normals come from central differences in 1/z, exact on planes. Not measured are unknown depth, its neighbours, and,
    with ``jump``, pixels of ``depth_breaks``; their depth is set to 1 m. Raises ValueError for a map that is not of the
    camera's size.
    """
    require("depth_m", depth_m, camera.hw)
    height, width = camera.hw
    known = np.isfinite(depth_m) & (depth_m > 0)
    inverse = np.where(known, 1.0 / np.where(known, depth_m, 1.0), 1.0).astype(np.float64)
    points = camera.unproject(camera.pixel_centres(), 1.0 / inverse)
    # On the plane n·X = o in camera axes, 1/z = n·ray/o is affine in the pixel: its gradient and value give n up to
    # length.
    along_row, along_column = np.gradient(inverse, axis=1), np.gradient(inverse, axis=0)
    (fx, fy), (cx, cy) = camera.focal_px, camera.principal_px
    columns, rows = np.meshgrid(np.arange(width) + 0.5 - cx, np.arange(height) + 0.5 - cy)
    normal = np.stack([along_row * fx, along_column * fy, inverse - along_row * columns - along_column * rows], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    # n·ray/o = 1/z > 0 makes this n point away from the camera.
    normals = -(normal @ camera.rotation_camera_from_world)
    valid = known & ~depth_breaks(depth_m, jump)
    return points, normals, valid
