# SPDX-License-Identifier: Apache-2.0
"""The views of one gap: photos warped by their depth, with holes painted in the picture and marked in the mask.

Writes ``views/<segment>.mkv`` (RGB, holes inpainted) and ``views/<segment>.mask.mkv`` (255 supported by a photo … 0
hole). Colours are those of the photos, at the rig's mean exposure if the survey turned exposure correction on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.camera_files.colmap import read_model
from studiorecon.errors import UserError
from studiorecon.footage.exr import read_depth
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import to_bytes, write_lossless
from studiorecon.progress import progress, say
from studiorecon.scene.camera import Camera
from studiorecon.scene.factors import read_factors
from studiorecon.scene.files import require_one_each
from studiorecon.scene.path import read_path
from studiorecon.scene.support import support_levels
from studiorecon.signature import Written
from studiorecon.views.forward_warp import WarpSource, blend_photos, warp_source
from studiorecon.views.warp_settings import Warping

if TYPE_CHECKING:
    from jaxtyping import Float, Integer


@dataclass(frozen=True)
class Settings(Warping):
    """Settings of warping and blending."""


def paint_holes(
    rgb: Float[np.ndarray, "H W 3"], support: Float[np.ndarray, "H W"], radius: int
) -> Integer[np.ndarray, "H W 3"]:
    """Picture whose pixels without support are painted from the rim of their hole (Telea)."""
    return cv2.inpaint(to_bytes(rgb), (support <= 0).astype(np.uint8), radius, cv2.INPAINT_TELEA)


def synthesize_views(
    cameras: list[Camera], photos: list[WarpSource], settings: Settings
) -> Iterator[tuple[Integer[np.ndarray, "H W 3"], Integer[np.ndarray, "H W"]]]:
    """(H, W, 3) uint8 picture and (H, W) uint8 support of every camera."""
    for camera in progress(cameras, "views"):
        rgb, support, _ = blend_photos(
            camera, photos, settings.oversampling, settings.z_tolerance, np.radians(settings.fade_deg)
        )
        yield paint_holes(rgb, support, settings.inpaint_radius), support_levels(support)


def read_photos(
    model: Path, plates: list[Path], depths: list[Path], gains: list[Path], depth_jump: float
) -> list[WarpSource]:
    """The training cameras' plates divided by the ``gains``, with depth; raises UserError for a missing one."""
    cameras = read_model(model.parent)
    require_one_each(cameras, plates=plates, depth_maps=depths)
    factors = read_factors(gains)
    photos = []
    for camera, plate, depth_path in zip(cameras, plates, depths):
        rgb, measured = read_plate(plate, camera.wh)
        depth_m, _ = read_depth(depth_path, camera.wh)
        photos.append(warp_source(camera, factors.normalise(camera.name, rgb), measured, depth_m, depth_jump))
    return photos


def read_segment(path: Path, segment: str) -> tuple[list[Camera], float]:
    """The cameras of one segment of a path, and its frame rate; raises UserError when there is no such segment."""
    steps, fps = read_path(path)
    wanted = [step.camera for step in steps if step.segment == segment]
    if not wanted:
        raise UserError(f"{path} has no segment {segment}; it holds {', '.join(sorted({s.segment for s in steps}))}")
    return wanted, fps


def run(
    settings: Settings,
    segment: str,
    path: Path,
    model: Path,
    plates: list[Path],
    depths: list[Path],
    gains: list[Path],
    views: Written,
    support: Written,
) -> None:
    """Write the pictures and the support of one segment's views."""
    photos = read_photos(model, plates, depths, gains, settings.depth_jump)
    wanted, fps = read_segment(path, segment)
    made = list(synthesize_views(wanted, photos, settings))
    holes = np.mean([mask == 0 for _, mask in made])
    say(f"segment {segment}: {holes:.1%} of the pixels of {len(made)} views are holes, inpainted and 0 in the mask")
    write_lossless(views, (picture for picture, _ in made), fps)
    write_lossless(support, (mask for _, mask in made), fps)
