# SPDX-License-Identifier: Apache-2.0
"""Agreement of two photos for a surface in a given plane: windowed correlation through the plane's own warp.

The window is warped with the plane, so it slants as the surface does; only this makes cameras 90° apart comparable.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float

# Variance (summed over channels) below which a window counts as flat: flat windows always correlate, so the means
# decide.
_FLAT_VARIANCE = 4e-4
# Least share of the window that both cameras must see.
_MIN_SHARE = 0.35
# Limit of the mean difference's part in the score: beyond it the windows differ anyway.
_MAX_DIFFERENCE = 0.6
UNKNOWN = np.float32(-9)


def plane_inverse_depth(camera: Camera, plane: Float[np.ndarray, " 4"]) -> Float[np.ndarray, " 3"] | None:
    """w with 1/z = w·(column, row, 1) for points of a world plane n·p = o; None when the camera is in the plane."""
    normal = camera.rotation_camera_from_world @ plane[:3]
    offset = plane[3] - plane[:3] @ camera.centre_m
    if abs(offset) < 1e-3:
        return None
    return np.linalg.solve(camera.intrinsics.T, normal) / offset


def plane_depth(
    camera: Camera, plane: Float[np.ndarray, " 4"], near_m: float, far_m: float
) -> Float[np.ndarray, "H W"]:
    """Z-depth of a world plane seen from a camera; 0 where it is not between ``near_m`` and ``far_m``."""
    weights = plane_inverse_depth(camera, plane)
    if weights is None:
        return np.zeros(camera.hw)
    inverse = camera.pixel_centres() @ weights[:2] + weights[2]
    seen = (inverse >= 1 / far_m) & (inverse <= 1 / near_m)
    return np.where(seen, 1 / np.where(seen, inverse, 1.0), 0.0)


def plane_homography(camera: Camera, other: Camera, inverse_depth: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Map of homogeneous pixels through a plane; its third coordinate is the depth in ``other`` over that in
    ``camera``.
    """
    other_from_camera = other.camera_from_world @ camera.world_from_camera
    rays = other_from_camera[:3, :3] @ np.linalg.inv(camera.intrinsics)
    return other.intrinsics @ (rays + np.outer(other_from_camera[:3, 3], inverse_depth))


@njit(cache=True, fastmath=True)
def correlate(a, a_known, b, b_known, h, inverse, half, mean_weight, near_m, far_m, score):
    """Fill ``score`` (H, W), at most 1, of a plane: sample ``b`` through homography ``h``, then running box sums of ten
    moments. It stays as it is where the plane is out of range or outside ``b``, or either picture is not known."""
    height, width = a_known.shape
    b_height, b_width = b_known.shape
    moments = np.zeros((height, width, 10), np.float32)
    top, bottom, left, right = height, -1, width, -1
    for y in range(height):
        v = y + 0.5
        for x in range(width):
            u = x + 0.5
            inv = inverse[0] * u + inverse[1] * v + inverse[2]
            if inv * far_m < 1.0 or inv * near_m > 1.0 or not a_known[y, x]:
                continue
            w = h[2, 0] * u + h[2, 1] * v + h[2, 2]
            if w < near_m * inv:
                continue
            bx = (h[0, 0] * u + h[0, 1] * v + h[0, 2]) / w - 0.5
            by = (h[1, 0] * u + h[1, 1] * v + h[1, 2]) / w - 0.5
            if not (bx >= 0.0 and by >= 0.0 and bx < b_width - 1 and by < b_height - 1):
                continue
            i, j = int(bx), int(by)
            if not (b_known[j, i] and b_known[j, i + 1] and b_known[j + 1, i] and b_known[j + 1, i + 1]):
                continue
            p, q = np.float32(bx - i), np.float32(by - j)
            aa, bb, ab = np.float32(0), np.float32(0), np.float32(0)
            for c in range(3):
                s = (b[j, i, c] * (1 - p) + b[j, i + 1, c] * p) * (1 - q) + (
                    b[j + 1, i, c] * (1 - p) + b[j + 1, i + 1, c] * p
                ) * q
                r = a[y, x, c]
                moments[y, x, 1 + c] = r
                moments[y, x, 4 + c] = s
                aa += r * r
                bb += s * s
                ab += r * s
            moments[y, x, 0] = 1
            moments[y, x, 7] = aa
            moments[y, x, 8] = bb
            moments[y, x, 9] = ab
            top, bottom, left, right = min(top, y), max(bottom, y), min(left, x), max(right, x)
    if bottom < 0:
        return
    # Rows and columns outside the overlap hold zeros, so the sums need only its bounding box.
    n = right - left + 1
    along = np.zeros((bottom - top + 1, n, 10), np.float32)
    for y in range(top, bottom + 1):
        run = np.zeros(10, np.float32)
        for x in range(left, min(left + half, right + 1)):
            for k in range(10):
                run[k] += moments[y, x, k]
        for x in range(left, right + 1):
            if x + half <= right:
                for k in range(10):
                    run[k] += moments[y, x + half, k]
            if x - half - 1 >= left:
                for k in range(10):
                    run[k] -= moments[y, x - half - 1, k]
            for k in range(10):
                along[y - top, x - left, k] = run[k]
    column = np.zeros((n, 10), np.float32)
    for y in range(top, min(top + half, bottom + 1)):
        for x in range(n):
            for k in range(10):
                column[x, k] += along[y - top, x, k]
    for y in range(top, bottom + 1):
        enter, leave = y + half - top, y - half - 1 - top
        rows = min(y + half, height - 1) - max(y - half, 0) + 1
        for x in range(n):
            if enter <= bottom - top:
                for k in range(10):
                    column[x, k] += along[enter, x, k]
            if leave >= 0:
                for k in range(10):
                    column[x, k] -= along[leave, x, k]
            if moments[y, x + left, 0] == 0:
                continue
            columns = min(x + left + half, width - 1) - max(x + left - half, 0) + 1
            count = column[x, 0]
            if count < _MIN_SHARE * rows * columns:
                continue
            scale = 1 / count
            va, vb, cov, difference = column[x, 7] * scale, column[x, 8] * scale, column[x, 9] * scale, np.float32(0)
            for c in range(3):
                ma, mb = column[x, 1 + c] * scale, column[x, 4 + c] * scale
                va -= ma * ma
                vb -= mb * mb
                cov -= ma * mb
                difference += abs(ma - mb)
            spread = np.sqrt((max(va, np.float32(0)) + _FLAT_VARIANCE) * (max(vb, np.float32(0)) + _FLAT_VARIANCE))
            score[y, x + left] = (cov + _FLAT_VARIANCE) / spread - mean_weight * min(difference, _MAX_DIFFERENCE)
