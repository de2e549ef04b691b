# SPDX-License-Identifier: Apache-2.0
"""The user's depth map (metres, OpenEXR), fitted to the working size and checked; it replaces ``depth.refine``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.camera_files.colmap import camera_named, read_model
from studiorecon.depth.sweep_settings import NearLimit
from studiorecon.errors import UserError
from studiorecon.footage.exr import read_depth, write_depth
from studiorecon.images.warp import sample
from studiorecon.progress import say, warn
from studiorecon.scene.camera import Camera
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Float, Num

# A map may differ from the working shape by rounding only.
_SHAPE_TOLERANCE = 0.02
_MIN_KNOWN = 0.05


@dataclass(frozen=True)
class Settings(NearLimit):
    """The range of valid depth."""


def fit_given_depth(
    depth_m: Num[np.ndarray, "h w"], confidence: Num[np.ndarray, "h w"], camera: Camera, near_m: float
) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """Depth and confidence at the camera's size by nearest sampling: averages across edges are on no surface (C12).

    Values that are not finite or nearer than ``near_m`` become unknown (0, confidence 0).
    """
    rows, columns = depth_m.shape
    pixels = camera.pixel_centres() * np.array([columns / camera.wh[0], rows / camera.wh[1]])
    resized, sure = sample(depth_m, pixels, "nearest")[0], sample(confidence, pixels, "nearest")[0]
    known = np.isfinite(resized) & (resized >= near_m)
    certain = np.clip(np.nan_to_num(sure, nan=0.0, posinf=1.0, neginf=0.0), 0, 1)
    return np.where(known, resized, 0).astype(np.float32), np.where(known, certain, 0).astype(np.float32)


def run(settings: Settings, camera: str, model: Path, source: Path, depth: Written) -> None:
    """Write the given depth of one camera at the working size; refuses maps of another shape or nearly empty ones."""
    own = camera_named(read_model(model.parent), camera, model)
    given_m, certain = read_depth(source)
    shape = (given_m.shape[1] / given_m.shape[0]) / (own.wh[0] / own.wh[1])
    if abs(shape - 1) > _SHAPE_TOLERANCE:
        raise UserError(
            f"{source} is {given_m.shape[1]}×{given_m.shape[0]}, another shape than camera "
            f"{camera} ({own.wh[0]}×{own.wh[1]}): make it of the undistorted capture/{camera}.mkv"
        )
    depth_m, certain = fit_given_depth(given_m, certain, own, settings.near_m)
    known = depth_m > 0
    if known.mean() < _MIN_KNOWN:
        raise UserError(
            f"{source} has depth for {known.mean():.1%} of its pixels; it must be "
            "z-depth in metres, 0 or NaN where unknown"
        )
    below = own.unproject(own.pixel_centres(), np.where(known, depth_m, 1.0))[..., 2][known]
    lowest_m = float(np.percentile(below, 2))
    say(f"depth of {camera} from your file: {known.mean():.0%} known, median {np.median(depth_m[known]):.2f} m")
    if abs(lowest_m) > 0.5:
        warn(
            f"its lowest points are at z = {lowest_m:.2f} m, not near the floor at 0: is it z-depth in metres of this "
            "camera?"
        )
    write_depth(depth, depth_m, certain)
