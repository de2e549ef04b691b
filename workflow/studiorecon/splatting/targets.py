# SPDX-License-Identifier: Apache-2.0
"""Images that Gaussians are trained on, their draw order, and their half-size versions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from studiorecon.scene.camera import Camera


@dataclass(frozen=True)
class Target:
    """One image to fit.

    Attributes:
        camera: where it was taken; its size is the image's.
        rgb: (H, W, 3) float32; masked pixels may hold anything.
        weight: (H, W) float32 per pixel, 0 = masked; None = 1 everywhere.
        share: how often it is drawn, relative to the others.
        background_rgb: colour behind the Gaussians.
        depth_m: (H, W) z-depth for the depth loss, 0 = unknown; None = none.
    """

    camera: Camera
    rgb: np.ndarray
    weight: np.ndarray | None = None
    share: float = 1.0
    background_rgb: tuple[float, float, float] = (0.0, 0.0, 0.0)
    depth_m: np.ndarray | None = None

    def halved(self) -> Target:
        """The target at half the size; a pixel is masked when any pixel under it is, and depth is taken, never averaged."""
        width, height = max(1, self.camera.wh[0] // 2), max(1, self.camera.wh[1] // 2)
        weight = None
        rgb = np.ascontiguousarray(self.rgb, np.float32)
        if self.weight is not None:
            used = self.weight > 0
            rgb = np.where(used[..., None], rgb, np.float32(0))
            whole = cv2.resize(used.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) > 0.999
            weight = np.where(whole, cv2.resize(self.weight.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA), 0)
        small = cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA)
        depth = None if self.depth_m is None else cv2.resize(self.depth_m, (width, height), interpolation=cv2.INTER_NEAREST)
        return replace(self, camera=self.camera.resized((width, height)), rgb=small, weight=weight, depth_m=depth)


def draws(shares: Sequence[float], count: int, rng: np.random.Generator) -> Iterator[int]:
    """``count`` target indices, each target as often as its share says, spread evenly: with equal shares every round visits all once."""
    cumulative = np.cumsum(np.asarray(shares, np.float64))
    if not (np.isfinite(cumulative[-1]) and cumulative[-1] > 0 and min(shares) >= 0):
        raise ValueError(f"shares of targets must be at least 0 and not all 0, not {list(shares)}")
    drawn = 0
    while drawn < count:
        points = (rng.random() + np.arange(len(shares))) / len(shares) * cumulative[-1]
        for index in rng.permutation(np.searchsorted(cumulative, points, side="right").clip(max=len(shares) - 1)):
            if drawn == count:
                return
            drawn += 1
            yield int(index)


def scene_extent(cameras: Sequence[Camera]) -> float:
    """Metres that position learning rates are multiplied by: 1.1 × the largest distance of a camera from their mean (3DGS)."""
    centres = np.array([camera.centre_m for camera in cameras])
    return float(1.1 * np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
