# SPDX-License-Identifier: Apache-2.0
"""Inner loops of the residual transfer: which surfaces of a new view a camera sees, and the values that it adds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Num


@numba.njit(cache=True, nogil=True)
def find_visible_pixels(
    depth_m: Num[np.ndarray, "H W"],
    ray_from_pixel: Num[np.ndarray, "3 3"],
    eye_m: Num[np.ndarray, " 3"],
    source_depth_m: Num[np.ndarray, "h w"],
    source_from_world: Num[np.ndarray, "3 4"],
    source_intrinsics: Num[np.ndarray, "3 3"],
    source_eye_m: Num[np.ndarray, " 3"],
    tolerance: float,
    power: float,
) -> tuple[Bool[np.ndarray, "H W"], Float[np.ndarray, "H W 2"], Float[np.ndarray, "H W"]]:
    """Per pixel of a view: whether a source sees its surface, at which pixel, and cos^power of the angle, float32.

    ``depth_m`` has 0 or NaN for unknown; ``ray_from_pixel`` maps (x, y, 1) at pixel centres +0.5 to the world direction
    of one metre of depth. Seen: the source's depth at the nearest pixel differs by at most ``tolerance`` of the
    distance.
    """
    height, width = depth_m.shape
    rows, columns = source_depth_m.shape
    seen = np.zeros((height, width), np.bool_)
    pixels = np.zeros((height, width, 2), np.float32)
    closeness = np.zeros((height, width), np.float32)
    for i in range(height):
        for j in range(width):
            depth = np.float64(depth_m[i, j])
            if not (depth > 0 and depth < np.inf):
                continue
            x, y = j + 0.5, i + 0.5
            rx = depth * (ray_from_pixel[0, 0] * x + ray_from_pixel[0, 1] * y + ray_from_pixel[0, 2])
            ry = depth * (ray_from_pixel[1, 0] * x + ray_from_pixel[1, 1] * y + ray_from_pixel[1, 2])
            rz = depth * (ray_from_pixel[2, 0] * x + ray_from_pixel[2, 1] * y + ray_from_pixel[2, 2])
            px, py, pz = eye_m[0] + rx, eye_m[1] + ry, eye_m[2] + rz
            m = source_from_world
            distance = m[2, 0] * px + m[2, 1] * py + m[2, 2] * pz + m[2, 3]
            if distance <= 0:
                continue
            cx = m[0, 0] * px + m[0, 1] * py + m[0, 2] * pz + m[0, 3]
            cy = m[1, 0] * px + m[1, 1] * py + m[1, 2] * pz + m[1, 3]
            u = (source_intrinsics[0, 0] * cx + source_intrinsics[0, 1] * cy) / distance + source_intrinsics[0, 2]
            v = source_intrinsics[1, 1] * cy / distance + source_intrinsics[1, 2]
            # Written so that NaN fails the test.
            if not (u >= 0 and v >= 0 and u < columns and v < rows):
                continue
            found = np.float64(source_depth_m[int(v), int(u)])
            if not (found > 0 and abs(found - distance) <= tolerance * distance):
                continue
            ox, oy, oz = px - source_eye_m[0], py - source_eye_m[1], pz - source_eye_m[2]
            lengths = np.sqrt((rx * rx + ry * ry + rz * rz) * (ox * ox + oy * oy + oz * oz))
            cosine = (rx * ox + ry * oy + rz * oz) / max(lengths, 1e-12)
            if cosine <= 0:
                continue
            seen[i, j] = True
            pixels[i, j, 0], pixels[i, j, 1] = u, v
            closeness[i, j] = min(cosine, 1.0) ** power
    return seen, pixels, closeness


@numba.njit(cache=True, nogil=True)
def accumulate_samples(
    picture: Num[np.ndarray, "h w 3"],
    pixels: Num[np.ndarray, "H W 2"],
    weight: Num[np.ndarray, "H W"],
    total: Num[np.ndarray, "H W 3"],
    weights: Num[np.ndarray, "H W"],
    cover: Num[np.ndarray, "H W"],
) -> None:
    """Add weight × picture, read bilinearly at ``pixels``, to ``total``, and the weight to ``weights``.

    ``cover`` keeps the largest weight. Pixels beyond the outermost centres read the border.
    """
    rows, columns = picture.shape[:2]
    for i in range(weight.shape[0]):
        for j in range(weight.shape[1]):
            share = weight[i, j]
            if share <= 0:
                continue
            x = min(max(pixels[i, j, 0] - np.float32(0.5), np.float32(0)), np.float32(columns - 1))
            y = min(max(pixels[i, j, 1] - np.float32(0.5), np.float32(0)), np.float32(rows - 1))
            left, top = min(int(x), columns - 2), min(int(y), rows - 2)
            fx, fy = x - left, y - top
            for c in range(3):
                above = (1 - fx) * picture[top, left, c] + fx * picture[top, left + 1, c]
                below = (1 - fx) * picture[top + 1, left, c] + fx * picture[top + 1, left + 1, c]
                total[i, j, c] += share * ((1 - fy) * above + fy * below)
            weights[i, j] += share
            cover[i, j] = max(cover[i, j], share)
