# SPDX-License-Identifier: Apache-2.0
"""How much a picture differs from a clean plate beyond what a shadow explains."""

from __future__ import annotations

import cv2
import numpy as np


def plate_difference(
    rgb: np.ndarray, plate_rgb: np.ndarray, *, chroma_weight: float, shadow: float
) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) float32 squared difference of a picture from the plate, CIELAB units, and (H, W) the light that is left
    there.

    Both pictures are (H, W, 3) float32 in [0, 1]. A shadow darkens all channels by one factor: the best such factor,
    between ``shadow`` and 1, is taken out first. Colour differences count ``chroma_weight`` times as much as lightness.
    """
    left = np.clip((rgb * plate_rgb).sum(axis=2) / np.maximum((plate_rgb * plate_rgb).sum(axis=2), 1e-4), shadow, 1.0)
    lab = cv2.cvtColor(rgb, cv2.COLOR_RGB2Lab) - cv2.cvtColor(plate_rgb * left[..., None], cv2.COLOR_RGB2Lab)
    return np.square(lab[..., 0]) + chroma_weight**2 * np.square(lab[..., 1:]).sum(axis=2), left
