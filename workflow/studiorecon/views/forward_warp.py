# SPDX-License-Identifier: Apache-2.0
"""Warps a photo to another camera: each pixel by its depth, nearest surface first; holes stay holes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numba import njit

from studiorecon.geometry.depth_surface import depth_breaks
from studiorecon.images.blur import gaussian_blur
from studiorecon.scene.camera import Camera
from studiorecon.splatting.seeds import SAME_SURFACE

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Nothing nearer than this is drawn: one pixel would cover a view inside a surface.
_NEAR_M = 0.1
# Detail is a picture minus its local mean over this window of the view: side and standard deviation.
_BLUR_PX, _DETAIL_PX = 11, 2.0
# More samples of a photo in a pixel than this add no detail; a smaller mean than the second counts as none.
_MAX_SAMPLES, _MIN_MEAN = 4.0, 1e-6


@dataclass(frozen=True)
class WarpSource:
    """A photo with depth: camera, float32 RGB, depth in metres, and the pixels that may be warped."""

    camera: Camera
    rgb: Float[np.ndarray, "H W 3"]
    depth_m: Float[np.ndarray, "H W"]
    usable: Bool[np.ndarray, "H W"]


def warp_source(
    camera: Camera,
    rgb: Float[np.ndarray, "H W 3"],
    measured: Bool[np.ndarray, "H W"],
    depth_m: Float[np.ndarray, "H W"],
    jump: float,
) -> WarpSource:
    """A source without pixels of unmeasured colour, of unknown depth, or near a jump in depth."""
    return WarpSource(
        camera, rgb.astype(np.float32), depth_m.astype(np.float64), measured & ~depth_breaks(depth_m, jump)
    )


def warp_photo(
    photo: WarpSource, camera: Camera, oversampling: int, z_tolerance: float
) -> tuple[Float[np.ndarray, "H W 3"], Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """Colour, depth (inf in holes) and samples per pixel of a photo in another camera.

    Every usable pixel becomes ``oversampling``² samples, with colour and 1/z interpolated to the neighbours that
    continue the surface; a pixel is the mean of the samples within ``z_tolerance`` of its nearest.
    """
    target_from_source = camera.camera_from_world @ photo.camera.world_from_camera
    pixel_map = camera.intrinsics @ target_from_source[:3, :3] @ np.linalg.inv(photo.camera.intrinsics)
    shift = camera.intrinsics @ target_from_source[:3, 3]
    nearest = np.full(camera.hw, np.inf)
    total = np.zeros((*camera.hw, 3))
    count = np.zeros(camera.hw)
    for gather in (False, True):
        _splat(
            photo.rgb,
            photo.depth_m,
            photo.usable,
            pixel_map,
            shift,
            oversampling,
            z_tolerance,
            gather,
            nearest,
            total,
            count,
        )
    return close_pinholes(total / np.maximum(count, 1)[..., None], nearest, count)


def close_pinholes(
    rgb: Float[np.ndarray, "H W 3"], depth_m: Float[np.ndarray, "H W"], count: Float[np.ndarray, "H W"]
) -> tuple[Float[np.ndarray, "H W 3"], Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """The view with pixels between the samples of one surface filled; each counts half a sample.

    A pixel is such a pinhole when at least five of its eight neighbours are covered and have one depth; the edge of a
    true hole has neighbours missing on one side or a nearer surface on the other.
    """
    covered = count > 0
    ones = np.ones((3, 3))
    around = cv2.filter2D(covered.astype(np.float64), -1, ones, borderType=cv2.BORDER_CONSTANT)
    inverse = np.where(covered, 1 / np.where(covered, depth_m, 1.0), 0)
    nearest = cv2.dilate(inverse, ones, borderType=cv2.BORDER_REPLICATE)
    farthest = -cv2.dilate(np.where(covered, -inverse, -np.inf), ones, borderType=cv2.BORDER_REPLICATE)
    pinhole = ~covered & (around >= 5) & (nearest < farthest * (1 + 2 * SAME_SURFACE))
    share = np.maximum(around, 1)
    mean_rgb = (
        cv2.filter2D(np.where(covered[..., None], rgb, 0), -1, ones, borderType=cv2.BORDER_CONSTANT) / share[..., None]
    )
    mean_inverse = cv2.filter2D(inverse, -1, ones, borderType=cv2.BORDER_CONSTANT) / share
    return (
        np.where(pinhole[..., None], mean_rgb, rgb),
        np.where(pinhole, 1 / np.where(pinhole, mean_inverse, 1.0), depth_m),
        np.where(pinhole, 0.5, count),
    )


@njit(cache=True)
def _splat(rgb, depth, usable, pixel_map, shift, oversampling, tolerance, gather, nearest, total, count):
    """First call: depth of the nearest sample per target pixel. Second: sum of the colours of all samples near it."""
    height, width = depth.shape
    target_height, target_width = nearest.shape
    colour = np.zeros(3)
    for y in range(height):
        for x in range(width):
            if not usable[y, x]:
                continue
            here = 1.0 / depth[y, x]
            for sy in range(oversampling):
                q = (sy + 0.5) / oversampling - 0.5
                j = min(max(y + (1 if q > 0 else -1), 0), height - 1)
                for sx in range(oversampling):
                    p = (sx + 0.5) / oversampling - 0.5
                    i = min(max(x + (1 if p > 0 else -1), 0), width - 1)
                    # Next to a dropped neighbour the surface is continued by its own pixel, never mixed with the other
                    # side.
                    smooth = usable[y, i] and usable[j, x] and usable[j, i]
                    a, b = (abs(p), abs(q)) if smooth else (0.0, 0.0)
                    inverse = (
                        (1 - b) * ((1 - a) * here + a / depth[y, i]) + b * ((1 - a) / depth[j, x] + a / depth[j, i])
                        if smooth
                        else here
                    )
                    z_source = 1.0 / inverse
                    u, v = x + 0.5 + p, y + 0.5 + q
                    w = z_source * (pixel_map[2, 0] * u + pixel_map[2, 1] * v + pixel_map[2, 2]) + shift[2]
                    if w < _NEAR_M:
                        continue
                    tx = (z_source * (pixel_map[0, 0] * u + pixel_map[0, 1] * v + pixel_map[0, 2]) + shift[0]) / w
                    ty = (z_source * (pixel_map[1, 0] * u + pixel_map[1, 1] * v + pixel_map[1, 2]) + shift[1]) / w
                    if not (tx >= 0 and ty >= 0 and tx < target_width and ty < target_height):
                        continue
                    column, row = int(tx), int(ty)
                    if not gather:
                        nearest[row, column] = min(nearest[row, column], w)
                    elif w <= nearest[row, column] * (1 + tolerance):
                        for c in range(3):
                            colour[c] = (1 - b) * ((1 - a) * rgb[y, x, c] + a * rgb[y, i, c]) + b * (
                                (1 - a) * rgb[j, x, c] + a * rgb[j, i, c]
                            )
                            total[row, column, c] += colour[c]
                        count[row, column] += 1


def ray_angles_rad(
    camera: Camera, depth_m: Float[np.ndarray, "H W"], other_centre_m: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "H W"]:
    """Angle at the visible point between the directions to this camera and to another; NaN where there is no point."""
    points = camera.unproject(camera.pixel_centres(), np.where(np.isfinite(depth_m), depth_m, np.nan))
    here, there = camera.centre_m - points, other_centre_m - points
    return np.arctan2(np.linalg.norm(np.cross(here, there), axis=-1), (here * there).sum(axis=-1))


def blend_photos(
    camera: Camera, sources: Sequence[WarpSource], oversampling: int, z_tolerance: float, fade_rad: float
) -> tuple[Float[np.ndarray, "H W 3"], Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """Float32 colour, float32 support in [0, 1] and depth (0 in holes) of several photos in one camera.

    The nearest surface wins. Coarse colours are averages of the photos that show it with weight exp(-angle/fade):
    colours change with the direction, and depth errors matter least for near directions. Detail finer than a few pixels
    is averaged with the square of the samples per pixel: a floor at a grazing angle in one camera is sharp in another.
    Support is 1 where some photo shows the pixel at no less than half its resolution, falls with thinner sampling, and
    is 0 in holes.
    """
    carried = [warp_photo(photo, camera, oversampling, z_tolerance) for photo in sources]
    nearest = np.min([depth_m for _, depth_m, _ in carried], axis=0)
    coarse, weight, support = np.zeros((*camera.hw, 3)), np.zeros(camera.hw), np.zeros(camera.hw)
    fine, sharpness = np.zeros((*camera.hw, 3)), np.zeros(camera.hw)
    for photo, (rgb, depth_m, count) in zip(sources, carried):
        shows = np.isfinite(depth_m) & (depth_m <= nearest * (1 + SAME_SURFACE))
        smooth = _local_mean(rgb, shows)
        angle = ray_angles_rad(camera, depth_m, photo.camera.centre_m)
        # A lower bound of the weights keeps the only photo of a surface, however oblique.
        share = np.where(shows, np.exp(-np.nan_to_num(angle) / fade_rad) + 1e-6, 0)
        coarse, weight = coarse + share[..., None] * smooth, weight + share
        density = np.minimum(count / oversampling**2, _MAX_SAMPLES)
        share = np.where(shows, density**2 + 1e-6, 0)
        fine, sharpness = fine + share[..., None] * (rgb - smooth), sharpness + share
        support = np.maximum(support, np.where(shows, np.minimum(4 * count / oversampling**2, 1), 0))
    seen = weight > 0
    rgb = coarse / np.where(seen, weight, 1)[..., None] + fine / np.where(seen, sharpness, 1)[..., None]
    rgb = np.clip(rgb, 0, 1)
    return rgb.astype(np.float32), support.astype(np.float32), np.where(seen, nearest, 0).astype(np.float32)


def _local_mean(rgb: Float[np.ndarray, "H W 3"], shows: Bool[np.ndarray, "H W"]) -> Float[np.ndarray, "H W 3"]:
    """Gaussian means of the visible pixels; 0 far from any."""
    share, total = (gaussian_blur(x, _BLUR_PX, _DETAIL_PX) for x in (shows, rgb * shows[..., None]))
    return total / np.maximum(share, _MIN_MEAN)[..., None]
