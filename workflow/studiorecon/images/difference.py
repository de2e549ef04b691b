# SPDX-License-Identifier: Apache-2.0
"""Difference between a picture and a clean plate, with shadows removed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.images.channels import channel_sum

if TYPE_CHECKING:
    from jaxtyping import Float


def plate_difference(
    rgb: Float[np.ndarray, "H W 3"], plate_rgb: Float[np.ndarray, "H W 3"], *, chroma_weight: float, shadow: float
) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """Squared difference, float32, of a picture from the plate, CIELAB units, and the remaining share of light.

    A shadow darkens all channels by one factor: the best such factor, between ``shadow`` and 1, is removed first.
    Colour differences count ``chroma_weight`` times as much as lightness.
    """
    left = np.clip(channel_sum(rgb * plate_rgb) / np.maximum(channel_sum(plate_rgb * plate_rgb), 1e-4), shadow, 1.0)
    lab = cv2.cvtColor(rgb, cv2.COLOR_RGB2Lab) - cv2.cvtColor(plate_rgb * left[..., None], cv2.COLOR_RGB2Lab)
    return np.square(lab[..., 0]) + chroma_weight**2 * channel_sum(np.square(lab[..., 1:])), left
