# SPDX-License-Identifier: Apache-2.0
"""What tests of enhance limits and their neighbours share."""

from __future__ import annotations

import cv2
import numpy as np
from studiorecon.recursive.flows import DisFlow
from studiorecon.recursive.injection import Injection

PAPER = Injection(
    history=3,
    strength=0.3,
    moving_strength=0.3,
    decay=0.5,
    error_threshold=30.0,
    blur_px=11,
    blur_sigma_px=2.0,
    form="residual",
    whole_levels=False,
    check=True,
    cut_share=0.1,
)


SEARCH = DisFlow("medium")


def textured(shape: tuple[int, int], seed: int, sigma_px: float = 2.0) -> np.ndarray:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).random(shape).astype(np.float32), (0, 0), sigma_px)
    return np.rint(255 * (noise - noise.min()) / np.ptp(noise)).astype(np.uint8)
