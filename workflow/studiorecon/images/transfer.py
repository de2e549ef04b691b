# SPDX-License-Identifier: Apache-2.0
"""Residuals of renders at the training cameras (photo - render), carried over to another view.

Every pixel of the view is lifted through its rendered depth and looked up in the training cameras of the same time.
Where a camera sees the same surface, its residual counts, weighted by how similar the viewing directions are. Pixels
that no training camera sees get no correction; corrections fade out towards the borders of the seen area, so that they
leave no seams.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.images.blur import gaussian_blur
from studiorecon.images.lookup import accumulate_samples, find_visible_pixels
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float, Num


@dataclass(frozen=True)
class Transfer:
    """Settings of the transfer.

    Attributes:
        depth_tolerance: relative depth difference up to which a training camera sees the same surface.
        angle_power: a residual is weighted by cos(angle between the two viewing rays) to this power.
        feather_px: distance over which a correction fades in from the border of its camera's seen area.
        smooth_px: sigma of the blur of the residuals, pixels: finer detail is not carried over.
    """

    depth_tolerance: float = 0.03
    angle_power: float = 0.5
    feather_px: float = 12.0
    smooth_px: float = 1.0


@dataclass(frozen=True)
class ResidualSource:
    """One training camera at one time: residual in units of the range, depth in metres with 0 where it is unusable."""

    camera: Camera
    residual: Float[np.ndarray, "H W 3"]
    depth_m: Float[np.ndarray, "H W"]


def residual_source(
    camera: Camera,
    photo: Num[np.ndarray, "H W 3"],
    render: Num[np.ndarray, "h w 3"],
    depth_m: Num[np.ndarray, "h w"],
    transfer: Transfer,
) -> ResidualSource:
    """The residual of one training picture; pixels at depth edges are left out, since they mix two surfaces (C12).

    ``render`` and ``depth_m`` may be larger than ``photo``: the camera's own picture is their top left part.
    """
    render, depth_m = render[: photo.shape[0], : photo.shape[1]], depth_m[: photo.shape[0], : photo.shape[1]]
    residual = photo.astype(np.float32) / 255 - render.astype(np.float32) / 255
    if transfer.smooth_px > 0:
        size = 2 * int(np.ceil(3 * transfer.smooth_px)) + 1
        residual = gaussian_blur(residual, size, transfer.smooth_px)
    # NaN and infinite depth count as unknown; they would spread through the edge test's window.
    depth = np.where(np.isfinite(depth_m) & (depth_m > 0), depth_m, 0).astype(np.float32)
    window = np.ones((3, 3), np.uint8)
    edge = cv2.dilate(depth, window) - cv2.erode(depth, window) > transfer.depth_tolerance * np.maximum(depth, 1e-6)
    return ResidualSource(camera, residual, np.where(edge, 0, depth).astype(np.float32))


def transfer_residual(
    camera: Camera, depth_m: Num[np.ndarray, "H W"], sources: Sequence[ResidualSource], transfer: Transfer
) -> tuple[Float[np.ndarray, "H W 3"], Float[np.ndarray, "H W"]]:
    """Residual that the sources predict for a view (cover-weighted mean), and cover in 0..1.

    Cover is 0 where no source sees the pixel's surface; it falls with the angle between the viewing rays and towards
    the borders of the seen area.
    """
    view = np.ascontiguousarray(depth_m, np.float32)
    world_from_view = camera.world_from_camera[:3, :3] @ np.linalg.inv(camera.intrinsics)
    total = np.zeros((*view.shape, 3), np.float32)
    weights, cover = np.zeros(view.shape, np.float32), np.zeros(view.shape, np.float32)
    for one in sources:
        there = one.camera
        seen, pixels, closeness = find_visible_pixels(
            view,
            world_from_view,
            camera.centre_m,
            one.depth_m,
            np.ascontiguousarray(there.camera_from_world[:3]),
            there.intrinsics,
            there.centre_m,
            transfer.depth_tolerance,
            transfer.angle_power,
        )
        accumulate_samples(one.residual, pixels, _feather(seen, transfer.feather_px) * closeness, total, weights, cover)
    return total / np.maximum(weights, 1e-9)[..., None], cover


def best_strength(
    predicted: Sequence[tuple[Num[np.ndarray, "H W 3"], Num[np.ndarray, "H W"]]],
    actual: Sequence[Num[np.ndarray, "H W 3"]],
) -> tuple[float, float]:
    """Share of the carried-over residual that is worth adding (0..1), and the share of pixels that it was measured on.

    Each pair is the residual of a training camera and the one that the *other* cameras predict for it. The
    least-squares factor between them, weighted by cover, lowers the error most on views that took no part in the
    prediction.
    """
    with_actual = with_itself = covered = pixels = 0.0
    for (residual, cover), own in zip(predicted, actual, strict=True):
        with_actual += float((cover[..., None] * residual * own).sum(dtype=np.float64))
        with_itself += float((cover[..., None] * residual * residual).sum(dtype=np.float64))
        covered += float((cover > 0).sum())
        pixels += cover.size
    strength = with_actual / with_itself if with_itself > 0 else 0.0
    return float(np.clip(strength, 0, 1)), covered / max(pixels, 1.0)


def _feather(seen: np.ndarray, feather_px: float) -> np.ndarray:
    if feather_px <= 0:
        return seen.astype(np.float32)
    # The picture's own border is no seam.
    padded = cv2.copyMakeBorder(seen.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    return np.minimum(cv2.distanceTransform(padded, cv2.DIST_L2, 3)[1:-1, 1:-1] / feather_px, 1)
