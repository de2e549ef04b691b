# SPDX-License-Identifier: Apache-2.0
"""Inputs and outputs of both rasterisers: sets of Gaussians, rendered views, gradients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.cpu.blocks import BlockedGaussians

if TYPE_CHECKING:
    from jaxtyping import Float, Num

Drawable = Gaussians | BlockedGaussians
"""A set, or one that is in blocks already."""


@dataclass(frozen=True)
class Rendering:
    """One rendered view, all float32.

    Attributes:
        rgb: over the background; not clamped above.
        alpha: 1 − transmittance.
        depth_m: expected z-depth (the blended depth over alpha), 0 where alpha is below 1e-4.
        normals: unit, in the world, 0 where nothing is drawn: the Gaussians' shortest axes, turned towards the camera
            and blended like colours. None unless requested.
        values: the caller's values of the Gaussians blended like colours. None unless given.
    """

    rgb: Float[np.ndarray, "H W 3"]
    alpha: Float[np.ndarray, "H W"]
    depth_m: Float[np.ndarray, "H W"]
    normals: Float[np.ndarray, "H W 3"] | None = None
    values: Float[np.ndarray, "H W C"] | None = None


@dataclass(frozen=True)
class GaussianGradients:
    """Gradients by the stored form of N Gaussians (log scales, logit opacities); 0 for the invisible.

    Attributes:
        screen: length of the gradient by the projected centre, per pixel. 3DGS' densification threshold is for
            normalised coordinates: multiply by half the image width.
        background_rgb: gradient by the colour behind the Gaussians.
    """

    means_m: Float[np.ndarray, "N 3"]
    quaternions: Float[np.ndarray, "N 4"]
    log_scales: Float[np.ndarray, "N 3"]
    logit_opacities: Float[np.ndarray, " N"]
    sh: Float[np.ndarray, "N B 3"]
    screen: Float[np.ndarray, " N"]
    background_rgb: Float[np.ndarray, " 3"]


def facing_normals(
    means_m: Float[np.ndarray, "N 3"],
    quaternions: Float[np.ndarray, "N 4"],
    scales: Float[np.ndarray, "N 3"],
    centre_m: Float[np.ndarray, " 3"],
) -> Float[np.ndarray, "N 3"]:
    """Float32 unit shortest axes in the world, turned towards a camera at ``centre_m``."""
    with np.errstate(invalid="ignore", over="ignore"):
        q = quaternions.astype(np.float64)
        w, x, y, z = (q / np.maximum(np.linalg.norm(q, axis=1, keepdims=True), 1e-12)).T
        columns = np.stack(
            [
                np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1),
                np.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)], axis=1),
                np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1),
            ]
        )
        axes = columns[np.argmin(scales, axis=1), np.arange(len(scales))]
        away = np.einsum("ni,ni->n", axes, means_m - centre_m) > 0
    return np.where(away[:, None], -axes, axes).astype(np.float32)


def check_values(values: Num[np.ndarray, "N C"], count: int) -> Num[np.ndarray, "N C"]:
    """The values as given. Raises ValueError unless they are (count, C)."""
    if values.ndim != 2 or len(values) != count:
        raise ValueError(f"values of shape {values.shape} do not fit {count} Gaussians")
    return values


def split_channels(
    blended: Float[np.ndarray, "H W C"], channels: int, normals: bool
) -> tuple[Float[np.ndarray, "H W 3"] | None, Float[np.ndarray, "H W c"] | None]:
    """Normals and values of a ``Rendering``, split from its blended channels: the caller's ``channels`` come first."""
    return (
        unit_or_zero(blended[..., channels:]) if normals else None,
        blended[..., :channels] if channels else None,
    )


def unit_or_zero(normals: Float[np.ndarray, "H W 3"]) -> Float[np.ndarray, "H W 3"]:
    """Vectors at unit length; those shorter than 1e-4 become 0."""
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    return np.where(length < 1e-4, 0, normals / np.maximum(length, 1e-4)).astype(np.float32)
