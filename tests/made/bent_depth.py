# SPDX-License-Identifier: Apache-2.0
"""True depth bent as a depth network errs: slow scale, blurred edges, thin things missing, in a unit of its own."""

from __future__ import annotations

import cv2
import numpy as np


def bent(
    truth_m: np.ndarray, rng: np.random.Generator, slow: float = 0.1, blur_px: float = 2.0, inverse: bool = False
) -> np.ndarray:
    """(H, W) float32 numbers of a planted network for depth (H, W), all known.

    Scale errs by ``slow`` at most, over half a picture; edges are blurred by ``blur_px`` of 320; what is thinner than
    seven pixels of 320 is missing. Depth is in a unit of its own with a shift, or its inverse is.
    """
    height, width = truth_m.shape
    size = width / 320
    near = (1 / np.maximum(truth_m, 1e-3)).astype(np.float32)
    thick = cv2.morphologyEx(near, cv2.MORPH_OPEN, np.ones((2 * round(3 * size) + 1,) * 2))
    blurred = cv2.GaussianBlur(thick, (0, 0), blur_px * size)
    waves = rng.normal(size=(max(3, round(5 * height / width)), 5)).astype(np.float32)
    waves = cv2.resize(waves, (width, height), interpolation=cv2.INTER_CUBIC)
    waves -= waves.mean()
    depth = np.exp(slow * waves / np.abs(waves).max()) / blurred
    return (0.7 / depth + 0.05 if inverse else (depth - 0.3) / 1.7).astype(np.float32)
