# SPDX-License-Identifier: Apache-2.0
"""Clips for an enhancer, and what comes of them."""

from __future__ import annotations

import cv2
import numpy as np
from studiorecon.recursive.sequence import enhance_sequence
from studiorecon.scene.path import PathStep

from tests.made.enhance_limits import PAPER, SEARCH
from tests.made.scene import ring

VIEW = ring([0], "view", wh=(96, 64))[0]


def panning(count: int, seed: int = 3, noise: float = 4.0) -> list[np.ndarray]:
    """A texture that moves 1.5 px per picture, with fresh noise in every one."""
    rng = np.random.default_rng(seed)
    texture = cv2.GaussianBlur(rng.random((64, 96 + 2 * count, 3)).astype(np.float32), (0, 0), 2.0)
    texture = 255 * (texture - texture.min()) / np.ptp(texture)
    rows, columns = np.mgrid[:64, :96].astype(np.float32)
    moved = [cv2.remap(texture, columns + np.float32(1.5 * k), rows, cv2.INTER_LINEAR) for k in range(count)]
    return [np.clip(np.rint(m + rng.normal(0, noise, m.shape)), 0, 255).astype(np.uint8) for m in moved]


def played(pictures: list[np.ndarray], enhancer: object, injection: object = PAPER) -> list[np.ndarray]:
    steps = [PathStep(VIEW, float(k), "a") for k in range(len(pictures))]
    depths = [np.full(VIEW.hw, 2000, np.uint16)] * len(pictures)
    return list(enhance_sequence(steps, pictures, depths, lambda step: pictures[0], enhancer, injection, SEARCH))
