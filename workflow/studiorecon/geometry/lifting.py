# SPDX-License-Identifier: Apache-2.0
"""Lifts a pixel with a depth map to a world point, without averaging two surfaces and without inventing depth.

Depth is z in metres; 0, negative, not finite or masked means unknown, and unknown depth gives no point.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# A depth map shows the skin; the pelvis joint is this far behind it along the ray (C11, U26).
SURFACE_TO_PELVIS_M = 0.13


def patch_depth(
    depth_m: Num[np.ndarray, "H W"],
    valid_mask: Bool[np.ndarray, "... H W"],
    pixels: Num[np.ndarray, "D 2"],
    patch_px: int,
    near_m: float,
) -> tuple[Num[np.ndarray, " D"], Bool[np.ndarray, " D"]]:
    """Median depth of the valid pixels of a square patch around each of ``pixels``, and whether there is any.

    ``valid_mask`` is where the depth is measured and the person is. The lower of two middle values is taken, never
    their mean, which may be on neither surface (C12). Depths that are not finite or not past ``near_m`` do not vote
    (C04). Raises ValueError for other shapes or an even ``patch_px``.
    """
    sizes = require("depth_m", depth_m, ("H", "W"))
    sizes = require("pixels", pixels, ("D", 2), sizes)
    mask = np.asarray(valid_mask, dtype=bool)
    require("valid_mask", mask, ("H", "W") if mask.ndim == 2 else ("D", "H", "W"), sizes)
    if patch_px < 1 or patch_px % 2 == 0:
        raise ValueError(f"patch_px must be odd and positive, not {patch_px}")
    height, width = sizes["H"], sizes["W"]
    finite = np.isfinite(pixels).all(-1)
    # Clipped because 1e30 does not fit an integer.
    centre = np.floor(np.clip(np.where(finite[:, None], pixels, -1e6), -1e6, 1e6)).astype(np.intp)
    offset = np.arange(patch_px) - patch_px // 2
    row = (centre[:, 1, None, None] + offset[:, None]) + 0 * offset  # (D, P, P)
    column = (centre[:, 0, None, None] + offset) + 0 * offset[:, None]
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    row, column = np.where(inside, row, 0), np.where(inside, column, 0)
    read = np.asarray(depth_m, dtype=np.float64)[row, column]
    masked = mask[row, column] if mask.ndim == 2 else mask[np.arange(len(centre))[:, None, None], row, column]
    usable = (inside & masked & np.isfinite(read) & (read > near_m)).reshape(len(centre), -1)
    ordered = np.sort(np.where(usable, read.reshape(usable.shape), np.inf), axis=-1)
    middle = np.maximum((usable.sum(-1) - 1) // 2, 0)
    valid = usable.any(-1)
    return np.where(valid, np.take_along_axis(ordered, middle[:, None], axis=-1)[:, 0], np.nan), valid


def lift_pelvis(
    depth_m: Num[np.ndarray, "H W"],
    valid_mask: Bool[np.ndarray, "... H W"],
    pixels: Num[np.ndarray, "... 2"],
    camera: Camera,
    *,
    surface_to_joint_m: float = SURFACE_TO_PELVIS_M,
    patch_px: int = 9,
    near_m: float = 0.1,
) -> tuple[Num[np.ndarray, "... 3"], Bool[np.ndarray, " ..."]]:
    """World pelvises, NaN where undetermined, and whether each is determined.

    The paper's p_world = Rᵀ(d K⁻¹p − t), with d from ``patch_depth`` and ``surface_to_joint_m`` added along the ray,
    not in z: the skin seen from two sides is up to 0.34 m apart (C11, U26). Raises ValueError as ``patch_depth`` does,
    and when the depth map has another size than the camera.
    """
    require("depth_m", depth_m, camera.hw)
    one = np.ndim(pixels) == 1
    many = np.atleast_2d(np.asarray(pixels, dtype=np.float64))
    depth, valid = patch_depth(depth_m, valid_mask, many, patch_px, near_m)
    points = lift_joint(depth, many, camera, surface_to_joint_m)
    return (points[0], valid[0]) if one else (points, valid)


def lift_joint(
    surface_depth_m: Num[np.ndarray, " ..."],
    pixels: Num[np.ndarray, "... 2"],
    camera: Camera,
    surface_to_joint_m: float,
) -> Num[np.ndarray, "... 3"]:
    """World points ``surface_to_joint_m`` behind the surface seen at ``pixels`` at a z-depth, NaN if unknown (C04).

    Raises ValueError for other shapes.
    """
    pixels, depth = np.asarray(pixels, dtype=np.float64), np.asarray(surface_depth_m, dtype=np.float64)
    require("pixels", pixels, (*depth.shape, 2))
    valid = np.isfinite(depth) & (depth > 0) & np.isfinite(pixels).all(-1)
    surface = camera.unproject(np.where(valid[..., None], pixels, 0.0), np.where(valid, depth, 1.0))
    ray = surface - camera.centre_m
    joint = surface + surface_to_joint_m * ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    return np.where(valid[..., None], joint, np.nan)
