# SPDX-License-Identifier: Apache-2.0
"""Silhouettes of triangle meshes: which pixel centres a mesh covers, and its depth there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

from studiorecon.arrays import require
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num


def mesh_depth(
    vertices_m: Num[np.ndarray, "V 3"], faces: Num[np.ndarray, "F 3"], camera: Camera, near_m: float = 0.05
) -> Float[np.ndarray, "H W"]:
    """Float32 z-depth in metres of the nearest triangle at every pixel centre, 0 where there is none.

    Triangles with a corner nearer than ``near_m``, or one that is not finite, are left out: a person who walks through
    the camera has no silhouette. About 2 ms for 27,000 triangles. Raises ValueError for other shapes, or a face with an
    index out of range.
    """
    require("vertices_m", vertices_m, ("V", 3))
    require("faces", faces, ("F", 3))
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(vertices_m)):
        raise ValueError(f"faces name vertices {faces.min()} to {faces.max()}, but vertices_m has {len(vertices_m)}")
    in_camera = vertices_m.astype(np.float64) @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    z = in_camera[:, 2]
    usable = np.isfinite(in_camera).all(axis=1) & (z >= near_m)
    inverse = np.where(usable, 1 / np.where(usable, z, 1.0), 0.0)
    pixels = np.where(usable[:, None], in_camera[:, :2], 0.0) * inverse[:, None] * np.array(camera.focal_px) + np.array(
        camera.principal_px
    )
    nearest = np.zeros(camera.hw, np.float32)
    _fill(pixels, inverse, np.ascontiguousarray(faces, np.int32), nearest)
    return np.where(nearest > 0, 1 / np.where(nearest > 0, nearest, 1), 0).astype(np.float32)


@numba.njit(cache=True, nogil=True)
def _fill(pixels, inverse, faces, nearest):
    """Largest inverse depth per pixel; inverse depth, unlike depth, is linear over a projected triangle."""
    height, width = nearest.shape
    for f in range(len(faces)):
        a, b, c = faces[f]
        if inverse[a] <= 0 or inverse[b] <= 0 or inverse[c] <= 0:
            continue
        ax, ay, bx, by, cx, cy = pixels[a, 0], pixels[a, 1], pixels[b, 0], pixels[b, 1], pixels[c, 0], pixels[c, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0:
            continue
        # Clamp before the conversion: a corner far outside the picture may not fit an integer.
        left = int(np.ceil(max(min(ax, bx, cx) - 0.5, 0.0)))
        right = int(np.floor(min(max(ax, bx, cx) - 0.5, width - 1.0)))
        top = int(np.ceil(max(min(ay, by, cy) - 0.5, 0.0)))
        bottom = int(np.floor(min(max(ay, by, cy) - 0.5, height - 1.0)))
        for y in range(top, bottom + 1):
            py = y + 0.5
            for x in range(left, right + 1):
                px = x + 0.5
                u = ((cx - bx) * (py - by) - (cy - by) * (px - bx)) / area
                v = ((ax - cx) * (py - cy) - (ay - cy) * (px - cx)) / area
                if u >= 0 and v >= 0 and u + v <= 1:
                    value = u * inverse[a] + v * inverse[b] + (1 - u - v) * inverse[c]
                    if value > nearest[y, x]:
                        nearest[y, x] = value


def front_person(depths_m: Num[np.ndarray, "K H W"]) -> Integer[np.ndarray, "H W"]:
    """K + 1 where person k of depths (0 = absent) is in front, the first of equals. Raises ValueError for other
    shapes."""
    require("depths_m", depths_m, ("K", "H", "W"))
    if not len(depths_m):
        return np.zeros(depths_m.shape[1:], np.uint8)
    reach = np.where(depths_m > 0, depths_m, np.inf)
    return np.where(np.isfinite(reach.min(axis=0)), reach.argmin(axis=0) + 1, 0).astype(np.uint8)
