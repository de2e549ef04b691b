# SPDX-License-Identifier: Apache-2.0
"""Reads a network's depth of one camera in its own unit, from ``depth.network`` or a user's file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.exr import read_depth
from studiorecon.footage.stills import read_image
from studiorecon.images.sizes import resample_nearest
from studiorecon.progress import warn
from studiorecon.scene.camera import Camera
from studiorecon.scene.user_files import read_npy, read_npz

if TYPE_CHECKING:
    from jaxtyping import Float

_MILLIMETRES = 1000.0
# A map may differ from the working shape by rounding only.
_SHAPE_TOLERANCE = 0.02


def read_camera_estimate(path: Path, camera: Camera) -> Float[np.ndarray, "H W"]:
    """Float32 numbers of a network for a camera, at its size; 0 = unknown. Raises UserError for another shape."""
    given, sure = read_estimate(path)
    shape = (given.shape[1] / given.shape[0]) / (camera.wh[0] / camera.wh[1])
    if abs(shape - 1) > _SHAPE_TOLERANCE:
        raise UserError(
            f"{path} is {given.shape[1]}×{given.shape[0]}, another shape than camera {camera.name} "
            f"({camera.wh[0]}×{camera.wh[1]}): run the network on the undistorted capture/{camera.name}.mkv"
        )
    return resample_nearest(np.where(sure > 0, given, 0).astype(np.float32), camera.hw)


def read_estimate(path: Path) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """Float32 depth and confidence of an .exr, .npy, .npz or 16-bit .png (mm); 0 = unknown, also where not positive."""
    if not path.is_file():
        raise UserError(f"{path} is missing; depth.precomputed names a folder with <camera>.exr, .npy, .npz or .png")
    if path.suffix == ".exr":
        return read_depth(path)
    if path.suffix == ".png":
        stored = read_image(path, cv2.IMREAD_UNCHANGED)
        if stored.dtype != np.uint16 or stored.ndim != 2:
            raise UserError(f"{path} is {stored.dtype} {stored.shape}; write a 16-bit grey picture of millimetres")
        depth = stored.astype(np.float32) / _MILLIMETRES
    else:
        depth = np.squeeze(_numbers(path))
    if depth.ndim != 2:
        raise UserError(f"{path} holds an array of shape {depth.shape}, and not one depth map (H, W); save one frame")
    if below := int((depth < 0).sum()):
        warn(f"{path}: {below} of {depth.size} depths are below 0 and count as unknown; write depth, not its inverse")
    depth = np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)
    return depth, (depth > 0).astype(np.float32)


def _numbers(path: Path) -> np.ndarray:
    if path.suffix == ".npz":
        held = read_npz(path)
        name = next((n for n in ("depth", "depths", "arr_0") if n in held), None)
        if name is None:
            raise UserError(
                f"{path} holds {', '.join(held) or 'no array'}; depth is looked for as depth, depths or arr_0"
            )
        array = held[name]
    else:
        array = read_npy(path)
    if array.dtype.kind not in "fiu":
        raise UserError(f"{path} holds {array.dtype}, not numbers; save the depth as floats")
    with np.errstate(over="ignore"):  # a double beyond float32 is no depth, and becomes infinite here
        return array.astype(np.float32)
