# SPDX-License-Identifier: Apache-2.0
"""Pictures made for the page: differences, depth in colour, masks over photos, truth maps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.images.channels import channel_sum
from studiorecon.images.palette import NOBODY, UNASSIGNED, person_colour

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# measured, inferred, invented.
_TRUTH_RGB = {255: (70, 130, 180), 128: (240, 200, 80), 0: (200, 80, 70)}


def difference(
    picture: Integer[np.ndarray, "H W 3"], photo: Integer[np.ndarray, "H W 3"], gain: float = 3.0
) -> Integer[np.ndarray, "H W 3"]:
    """Absolute difference, mean over channels, amplified, dark = equal."""
    error = channel_sum(np.abs(picture.astype(np.float32) - photo.astype(np.float32))) / 3
    return cv2.applyColorMap(np.clip(error * gain, 0, 255).astype(np.uint8), cv2.COLORMAP_INFERNO)[..., ::-1]


def depth_picture(
    depth_m: Float[np.ndarray, "H W"], confidence: Float[np.ndarray, "H W"] | None = None
) -> tuple[Integer[np.ndarray, "H W 3"], tuple[float, float]]:
    """A picture, near bright, far dark, unknown black, doubtful pale; and the depth range shown, metres."""
    known = depth_m > 0
    if not known.any():
        return np.zeros((*depth_m.shape, 3), np.uint8), (0.0, 0.0)
    near, far = (float(v) for v in np.percentile(depth_m[known], (1, 99)))
    inverse = (1 / np.clip(depth_m, near, far) - 1 / far) / max(1 / near - 1 / far, 1e-9)
    colour = cv2.applyColorMap((255 * np.clip(inverse, 0, 1)).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[..., ::-1]
    if confidence is not None:
        trust = np.clip(confidence, 0, 1)[..., None]
        colour = (colour * (0.35 + 0.65 * trust) + 255 * (0.65 - 0.65 * trust) * 0.35).astype(np.uint8)
    return np.where(known[..., None], colour, 0).astype(np.uint8), (near, far)


def mask_picture(photo: Integer[np.ndarray, "H W 3"], mask: Integer[np.ndarray, "H W"]) -> Integer[np.ndarray, "H W 3"]:
    """The photo with each person tinted; ``mask`` is 0 background, k+1 person k, 255 unassigned."""
    tinted = photo.astype(np.float32)
    for label in np.unique(mask[mask > 0]):
        colour = NOBODY if label == UNASSIGNED else person_colour(int(label) - 1)
        tinted[mask == label] = 0.45 * tinted[mask == label] + 0.55 * np.array(colour)
    return tinted.astype(np.uint8)


def truth_picture(
    truth: Integer[np.ndarray, "H W"], picture: Integer[np.ndarray, "H W 3"]
) -> Integer[np.ndarray, "H W 3"]:
    """The picture tinted blue where measured, yellow where inferred, red where invented."""
    tint = np.zeros((*truth.shape, 3), np.float32)
    for level, colour in _TRUTH_RGB.items():
        tint[truth == level] = colour
    grey = picture.astype(np.float32).mean(axis=-1, keepdims=True)
    return (0.5 * grey + 0.5 * tint).astype(np.uint8)


def truth_shares(truth: Integer[np.ndarray, " ..."]) -> dict[str, float]:
    """Share of a truth map (any shape) that is measured, inferred, invented."""
    return {
        name: float((truth == level).mean()) for name, level in (("measured", 255), ("inferred", 128), ("invented", 0))
    }
