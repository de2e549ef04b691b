# SPDX-License-Identifier: Apache-2.0
"""Colours of a person's Gaussians in pictures: which are in view, and their initial colours."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.humans.crops import PERSON, Crop

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

# A Gaussian this far behind the nearest rendered surface is hidden.
_HIDDEN_M = 0.04
# A Gaussian facing away more than this (cosine) is not judged.
_GRAZING = 0.2


def visible_gaussians(
    crop: Crop,
    means_m: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    nearest_m: Float[np.ndarray, "h w"],
) -> tuple[Integer[np.ndarray, " M"], Float[np.ndarray, "M 2"], Float[np.ndarray, " M"]]:
    """Indices, float32 pixels and weights of the Gaussians that a picture shows.

    ``nearest_m`` is the depth of the person's own surface in the crop. A Gaussian counts where the pixel is the
    person's, it is not behind that surface, and it faces the camera; frontal and near views weigh more.
    """
    pixels, depth_m = crop.camera.project(means_m)
    width, height = crop.camera.wh
    inside = np.all((pixels >= 0) & (pixels < [width, height]), axis=1)
    index = np.flatnonzero(inside)
    column, row = np.floor(pixels[index]).astype(np.int64).T
    ray = means_m[index] - crop.camera.centre_m
    facing = -np.sum(normals[index] * ray, axis=1) / np.linalg.norm(ray, axis=1)
    good = (
        (crop.verdict[row, column] == PERSON)
        & (depth_m[index] < nearest_m[row, column] + _HIDDEN_M)
        & (facing > _GRAZING)
    )
    index, facing = index[good], facing[good]
    return index, pixels[index].astype(np.float32), facing**2 * np.mean(crop.camera.focal_px) / depth_m[index]


def sample_colours(picture: Num[np.ndarray, "h w C"], pixels: Float[np.ndarray, "M 2"]) -> Float[np.ndarray, "M C"]:
    """Float64 values of a picture at ``pixels``, linear between pixel centres."""
    if len(pixels) == 0:
        return np.zeros((0, picture.shape[2]))
    at = pixels - np.float32(0.5)  # cv2.remap counts pixel centres as integers
    found = cv2.remap(picture, at[None, :, 0], at[None, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]
    return found.reshape(len(pixels), -1).astype(np.float64)


def add_evidence(
    crop: Crop,
    means_m: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    nearest_m: Float[np.ndarray, "h w"],
    colour_sums: Float[np.ndarray, "N 3"],
    weight_sums: Float[np.ndarray, " N"],
) -> None:
    """Add one picture's evidence to ``colour_sums`` and ``weight_sums``; see ``visible_gaussians``."""
    index, pixels, weight = visible_gaussians(crop, means_m, normals, nearest_m)
    np.add.at(colour_sums, index, sample_colours(crop.rgb, pixels) / 255 * weight[:, None])
    np.add.at(weight_sums, index, weight)


def nearest_surface(
    pixels: Float[np.ndarray, "N 2"], depth_m: Float[np.ndarray, " N"], hw: tuple[int, int], reach_px: int
) -> Float[np.ndarray, "H W"]:
    """Depth of the nearest point around every pixel, infinite for none: points splatted as squares of ``reach_px``."""
    surface = np.full(hw, np.inf)
    known = np.flatnonzero(np.isfinite(pixels).all(axis=1))
    at = np.floor(pixels[known]).astype(np.int64)
    inside = np.all((at >= 0) & (at < [hw[1], hw[0]]), axis=1)
    np.minimum.at(surface, (at[inside, 1], at[inside, 0]), depth_m[known[inside]])
    # Grey erosion takes the minimum over the square.
    return cv2.erode(surface, np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8)) if reach_px > 0 else surface
