# SPDX-License-Identifier: Apache-2.0
"""L1 and SSIM of images of one size on the CPU, weighted per pixel, with their analytic gradient."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.splatting.cpu import ssim as similarity
from studiorecon.splatting.cpu.blocks import aligned_zeros
from studiorecon.splatting.cpu.ssim import PAD, RADIUS

if TYPE_CHECKING:
    from jaxtyping import Float, Num


@dataclass(frozen=True)
class PreparedTarget:
    """A target image in the kernels' layout; ``mean`` and ``square`` are None when computed at every use."""

    padded: Float[np.ndarray, " P"]
    weight: Float[np.ndarray, " W"]
    weighted_pixels: int
    mean: Float[np.ndarray, " P"] | None
    square: Float[np.ndarray, " P"] | None


@dataclass(frozen=True)
class PhotometricTerms:
    """Means of one evaluation: ``total`` = l1·mean|x−y| + ssim·mean(1−SSIM); ``psnr_db`` over the weighted pixels."""

    total: float
    absolute: float
    dissimilarity: float
    psnr_db: float


class BufferPool:
    """Zeroed buffers by name, for pictures of many sizes that are used once: allocation costs as much as the loss."""

    def __init__(self) -> None:
        self._held: dict[str, np.ndarray] = {}

    def zeros(self, name: str, count: int) -> Float[np.ndarray, " C"]:
        """``count`` zeros that start at a cache line; the next call with this name overwrites them."""
        if name not in self._held or len(self._held[name]) < count:
            self._held[name] = aligned_zeros(count)
        zeros = self._held[name][:count]
        zeros[:] = 0
        return zeros


class _Fresh(BufferPool):
    def zeros(self, name: str, count: int) -> np.ndarray:
        return aligned_zeros(count)


class Photometric:
    """l1·L1 + ssim·(1 − SSIM) for images of one size, with reused buffers.

    With ``memory``, the result of ``prepare`` is valid until its next call. Pixels of weight 0 neither count nor affect
    the SSIM windows of their neighbours: the target's colours replace them.
    """

    def __init__(self, hw: tuple[int, int], l1: float, ssim: float, memory: BufferPool | None = None) -> None:
        self.hw, self.l1, self.ssim = hw, float(l1), float(ssim)
        self._memory = memory or _Fresh()
        self._wide = similarity.padded_width(hw[1])
        self._plane = (hw[0] + 2 * RADIUS) * self._wide
        self._taps = similarity.window()
        self._image = self._memory.zeros("image", 3 * self._plane)
        self._slopes = self._memory.zeros("slopes", 9 * self._plane)
        self._statistics = (np.zeros(0, np.float32), np.zeros(0, np.float32))
        self._sums = np.zeros((3 * hw[0], 3), np.float32)

    @property
    def statistics_bytes(self) -> int:
        """Memory of one target's stored statistics."""
        return 2 * 3 * self._plane * 4

    def prepare(
        self, rgb: Num[np.ndarray, "H W 3"], weight: Num[np.ndarray, "H W"] | None = None, keep_statistics: bool = True
    ) -> PreparedTarget:
        """A target with per-pixel weights; masked colours may be NaN. Raises ValueError for another size."""
        height, width = self.hw
        weight = np.ones(self.hw, np.float32) if weight is None else weight
        if rgb.shape != (height, width, 3) or weight.shape != self.hw:
            raise ValueError(f"target {rgb.shape} with weight {weight.shape} does not fit images of {self.hw}")
        padded = self._memory.zeros("padded", 3 * self._plane)
        wide_weight = self._memory.zeros("weight", height * (self._wide - 2 * PAD))
        pictures = (np.ascontiguousarray(picture, np.float32) for picture in (rgb, weight))
        used = similarity.pad_target(*pictures, self._wide, padded, wide_weight)
        mean = square = None
        if keep_statistics:
            mean, square = aligned_zeros(3 * self._plane), aligned_zeros(3 * self._plane)
            similarity.target_statistics(padded, height, self._wide, self._taps, mean, square)
        return PreparedTarget(padded, wide_weight, int(used), mean, square)

    def evaluate(
        self, planes: Float[np.ndarray, "5 H W"], target: PreparedTarget, gradient: Float[np.ndarray, "5 H W"]
    ) -> PhotometricTerms:
        """The loss of planes; its gradient is added to the first three planes of ``gradient`` (5, H, W)."""
        height = self.hw[0]
        mean, square = target.mean, target.square
        if mean is None or square is None:
            if not self._statistics[0].size:
                self._statistics = (
                    self._memory.zeros("mean", 3 * self._plane),
                    self._memory.zeros("square", 3 * self._plane),
                )
            mean, square = self._statistics
            similarity.target_statistics(target.padded, height, self._wide, self._taps, mean, square)
        share = 1.0 / (3 * target.weighted_pixels) if target.weighted_pixels else 0.0
        weights = (np.float32(self.l1 * share), np.float32(self.ssim * share))
        similarity.photometric_terms(
            planes,
            target.padded,
            mean,
            square,
            target.weight,
            height,
            self._wide,
            self._taps,
            *weights,
            self._image,
            self._slopes,
            gradient[:3],
            self._sums,
        )
        dissimilarity, absolute, squared = (self._sums.sum(axis=0, dtype=np.float64) * share).tolist()
        psnr_db = -10 * np.log10(max(squared, 1e-12))
        return PhotometricTerms(self.l1 * absolute + self.ssim * dissimilarity, absolute, dissimilarity, float(psnr_db))


def flatten_image(image: Num[np.ndarray, "H W"] | None) -> Float[np.ndarray, " C"]:
    """An image in the kernels' layout: (H·W,) float32, empty for None."""
    return np.zeros(0, np.float32) if image is None else np.ascontiguousarray(image, np.float32).reshape(-1)
