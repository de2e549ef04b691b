# SPDX-License-Identifier: Apache-2.0
"""Images that Gaussians are trained on, their draw order, and their half-size versions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.scene.camera import Camera
from studiorecon.splatting.train.schedule import TrainingSettings, is_half_size

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


@dataclass(frozen=True)
class Target:
    """One image to fit, of ``camera``'s size.

    Attributes:
        rgb: float32; masked pixels may hold anything.
        weight: float32 per pixel, 0 = masked; None = 1 everywhere.
        share: how often it is drawn, relative to the others.
        background_rgb: colour behind the Gaussians.
        silhouette: where the person is, for the silhouette loss; None = none.
    """

    camera: Camera
    rgb: Float[np.ndarray, "H W 3"]
    weight: Float[np.ndarray, "H W"] | None = None
    share: float = 1.0
    background_rgb: tuple[float, float, float] = (0.0, 0.0, 0.0)
    silhouette: Bool[np.ndarray, "H W"] | None = None

    @property
    def used(self) -> Bool[np.ndarray, "H W"]:
        """The pixels that count."""
        return np.ones(self.camera.hw, bool) if self.weight is None else self.weight > 0

    def without_non_finite(self) -> tuple[Target, int]:
        """The target with every pixel masked whose colour or weight is not finite, and the number of such pixels."""
        weight = np.ones(self.rgb.shape[:2], np.float32) if self.weight is None else self.weight
        finite = np.isfinite(weight)
        finite &= np.isfinite(self.rgb).all(axis=-1) | (weight == 0)
        if finite.all():
            return self, 0
        return replace(self, weight=np.where(finite, weight, 0).astype(np.float32)), int(np.count_nonzero(~finite))

    def halved(self) -> Target:
        """The target at half the size; a pixel is masked when any pixel under it is."""
        width, height = max(1, self.camera.wh[0] // 2), max(1, self.camera.wh[1] // 2)
        weight = None
        rgb = np.ascontiguousarray(self.rgb, np.float32)
        if self.weight is not None:
            used = self.weight > 0
            rgb = np.where(used[..., None], rgb, np.float32(0))
            whole = cv2.resize(used.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) > 0.999
            weight = np.where(
                whole, cv2.resize(self.weight.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA), 0
            )
        small = cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA)
        return replace(self, camera=self.camera.resized((width, height)), rgb=small, weight=weight)


class TargetSizes:
    """Targets at full and half size; the half size is computed on first use."""

    def __init__(self, targets: Sequence[Target]) -> None:
        self._whole, self._half = list(targets), dict[int, Target]()

    @property
    def first(self) -> Target:
        """The first target at full size."""
        return self._whole[0]

    def at(self, settings: TrainingSettings, iteration: int, index: int) -> tuple[tuple[bool, int], Target]:
        """The target at a step's size, with its cache key."""
        half = is_half_size(settings, iteration)
        if half and index not in self._half:
            self._half[index] = self._whole[index].halved()
        return (half, index), self._half[index] if half else self._whole[index]


class DrawOrder:
    """Chooses the next target: each as often as its share, spread evenly; equal shares visit all once a round.

    ``pending`` is the rest of the round, in order; with the generator's state it is all that a resumed run needs.
    """

    def __init__(self, shares: Sequence[float], rng: np.random.Generator) -> None:
        cumulative = np.cumsum(np.asarray(shares, np.float64))
        if not (np.isfinite(cumulative[-1]) and cumulative[-1] > 0 and min(shares) >= 0):
            raise ValueError(f"shares of targets must be at least 0 and not all 0, not {list(shares)}")
        self._cumulative, self._rng = cumulative, rng
        self.pending: list[int] = []

    def draw(self) -> int:
        """The next target's index."""
        if not self.pending:
            count = len(self._cumulative)
            points = (self._rng.random() + np.arange(count)) / count * self._cumulative[-1]
            once = np.searchsorted(self._cumulative, points, side="right").clip(max=count - 1)
            self.pending = self._rng.permutation(once).tolist()
        return self.pending.pop(0)


def scene_extent(cameras: Sequence[Camera]) -> float:
    """Scale of position learning rates, metres: 1.1 × the largest distance of a camera from their mean (3DGS)."""
    centres = np.array([camera.centre_m for camera in cameras])
    return float(1.1 * np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
