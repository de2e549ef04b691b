# SPDX-License-Identifier: Apache-2.0
"""What tests of flow and their neighbours share."""

from __future__ import annotations

import cv2
import numpy as np


def textured(shape: tuple[int, int], seed: int, sigma_px: float = 2.0) -> np.ndarray:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).random(shape).astype(np.float32), (0, 0), sigma_px)
    return np.rint(255 * (noise - noise.min()) / np.ptp(noise)).astype(np.uint8)
