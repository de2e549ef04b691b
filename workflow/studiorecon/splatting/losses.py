# SPDX-License-Identifier: Apache-2.0
"""Losses with analytic gradients: photometric (L1 + SSIM, weighted per pixel), silhouette, density, depth.

Every loss is a mean over the pixels whose weight is above 0, of weight times error: with weights 0 and 1 that is Σ m·l / Σ m
(numerics U11), and a weight of 3 counts three times (U15). SSIM enters as 1 − SSIM, not halved (U10).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from studiorecon.splatting import similarity
from studiorecon.splatting.blocks import aligned
from studiorecon.splatting.coverage import alpha_terms, depth_terms
from studiorecon.splatting.similarity import PAD, RADIUS


@dataclass(frozen=True)
class PreparedTarget:
    """A target image in the kernels' layout; ``mean`` and ``square`` are None when its statistics are computed at every use."""

    padded: np.ndarray
    weight: np.ndarray
    weighted_pixels: int
    mean: np.ndarray | None
    square: np.ndarray | None


@dataclass(frozen=True)
class PhotometricTerms:
    """Means of one evaluation: ``total`` = l1·mean|x−y| + ssim·mean(1−SSIM); ``psnr_db`` over the weighted pixels."""

    total: float
    absolute: float
    dissimilarity: float
    psnr_db: float


class Photometric:
    """l1·L1 + ssim·(1 − SSIM) for images of one size, with reused buffers.

    Pixels of weight 0 neither count nor disturb the SSIM windows of their neighbours: the target's colours stand in for them.
    """

    def __init__(self, hw: tuple[int, int], l1: float, ssim: float) -> None:
        self.hw, self.l1, self.ssim = hw, float(l1), float(ssim)
        self._wide = similarity.padded_width(hw[1])
        self._plane = (hw[0] + 2 * RADIUS) * self._wide
        self._taps = similarity.window()
        self._image, self._slopes = aligned(3 * self._plane), aligned(9 * self._plane)
        self._statistics = (np.zeros(0, np.float32), np.zeros(0, np.float32))
        self._sums = np.zeros((3 * hw[0], 3), np.float32)

    @property
    def statistics_bytes(self) -> int:
        """Memory of one target's kept statistics."""
        return 2 * 3 * self._plane * 4

    def prepare(self, rgb: np.ndarray, weight: np.ndarray | None = None, keep_statistics: bool = True) -> PreparedTarget:
        """A target (H, W, 3) with per-pixel weights (H, W); masked colours may be NaN. Raises ValueError for another size."""
        height, width = self.hw
        weight = np.ones(self.hw, np.float32) if weight is None else weight
        if rgb.shape != (height, width, 3) or weight.shape != self.hw:
            raise ValueError(f"target {rgb.shape} with weight {weight.shape} does not fit images of {self.hw}")
        used = weight > 0
        padded = aligned(3 * self._plane)
        inside = padded.reshape(3, height + 2 * RADIUS, self._wide)[:, RADIUS : RADIUS + height, PAD : PAD + width]
        inside[:] = np.where(used[..., None], rgb, np.clip(np.nan_to_num(rgb), 0, 1)).transpose(2, 0, 1)
        wide_weight = aligned(height * (self._wide - 2 * PAD))
        wide_weight.reshape(height, -1)[:, :width] = np.where(used, weight, 0)
        mean = square = None
        if keep_statistics:
            mean, square = aligned(3 * self._plane), aligned(3 * self._plane)
            similarity.target_statistics(padded, height, self._wide, self._taps, mean, square)
        return PreparedTarget(padded, wide_weight, int(used.sum()), mean, square)

    def evaluate(self, planes: np.ndarray, target: PreparedTarget, gradient: np.ndarray) -> PhotometricTerms:
        """The loss of planes (5, H, W); its gradient goes into the first three planes of ``gradient`` (5, H, W)."""
        height = self.hw[0]
        mean, square = target.mean, target.square
        if mean is None or square is None:
            if not self._statistics[0].size:
                self._statistics = (aligned(3 * self._plane), aligned(3 * self._plane))
            mean, square = self._statistics
            similarity.target_statistics(target.padded, height, self._wide, self._taps, mean, square)
        share = 1.0 / (3 * target.weighted_pixels) if target.weighted_pixels else 0.0
        weights = (np.float32(self.l1 * share), np.float32(self.ssim * share))
        similarity.photometric_terms(
            planes, target.padded, mean, square, target.weight, height, self._wide, self._taps, *weights, self._image, self._slopes,
            gradient[:3], self._sums,
        )  # fmt: skip
        dissimilarity, absolute, squared = (self._sums.sum(axis=0, dtype=np.float64) * share).tolist()
        psnr_db = -10 * np.log10(max(squared, 1e-12))
        return PhotometricTerms(self.l1 * absolute + self.ssim * dissimilarity, absolute, dissimilarity, float(psnr_db))


def photometric(
    rendered_rgb: np.ndarray, target_rgb: np.ndarray, weight: np.ndarray | None, l1: float, ssim: float
) -> tuple[float, np.ndarray]:
    """The loss and its gradient (H, W, 3) for one pair of images; loops should keep a ``Photometric``."""
    hw = rendered_rgb.shape[:2]
    loss = Photometric(hw, l1, ssim)
    planes = np.zeros((5, *hw), np.float32)
    planes[:3] = rendered_rgb.transpose(2, 0, 1)
    gradient = np.zeros((5, *hw), np.float32)
    terms = loss.evaluate(planes, loss.prepare(target_rgb, weight, keep_statistics=False), gradient)
    return terms.total, np.ascontiguousarray(gradient[:3].transpose(1, 2, 0))


def coverage(
    alpha: np.ndarray, mask: np.ndarray | None, weight: np.ndarray | None, silhouette: float, density: float
) -> tuple[float, np.ndarray]:
    """silhouette·mean(w(α − mask)²) + density·mean(w·D(α)) and its gradient (H, W) by alpha.

    D(α) = −log(e^{−α} + e^{α−1}) + log(1 + 1/e) is 0 for empty and for opaque pixels and 0.120 half-way; its slope is tanh(½ − α),
    finite everywhere (numerics I14, U13).
    """
    planes = np.zeros((5, *alpha.shape), np.float32)
    planes[4] = 1 - alpha
    gradient = np.zeros((5, *alpha.shape), np.float32)
    return add_coverage(planes, mask, weight, silhouette, density, gradient), gradient[4]


def add_coverage(
    planes: np.ndarray, mask: np.ndarray | None, weight: np.ndarray | None, silhouette: float, density: float, gradient: np.ndarray
) -> float:
    """``coverage`` of planes (5, H, W) whose last is transmittance; writes the last plane of ``gradient``. A None weight means 1."""
    flat_mask = _flat(mask)
    sums, used = np.zeros((planes.shape[1], 2), np.float32), planes[4].size if weight is None else int(np.count_nonzero(weight > 0))
    share = 1.0 / used if used else 0.0
    strengths = (np.float32((silhouette if flat_mask.size else 0.0) * share), np.float32(density * share))
    alpha_terms(planes, flat_mask, _flat(weight), *strengths, gradient, sums)
    return float(sums[:, 0].sum(dtype=np.float64) * strengths[0] + sums[:, 1].sum(dtype=np.float64) * strengths[1])


def add_depth(planes: np.ndarray, depth_m: np.ndarray, weight: np.ndarray | None, strength: float, gradient: np.ndarray) -> float:
    """strength·mean(w·|d/target − 1|) over pixels with a target depth; adds to the last two planes of ``gradient``.

    d is the expected depth (blended depth over alpha). The slope is softened within 2 % so that exact depths do not jitter.
    """
    used = np.count_nonzero(depth_m > 0) if weight is None else np.count_nonzero((depth_m > 0) & (weight > 0))
    sums = np.zeros(planes.shape[1], np.float32)
    share = np.float32(strength / used if used else 0.0)
    depth_terms(planes, np.ascontiguousarray(depth_m, np.float32), _flat(weight), share, gradient, sums)
    return float(sums.sum(dtype=np.float64) * share)


def _flat(image: np.ndarray | None) -> np.ndarray:
    return np.zeros(0, np.float32) if image is None else np.ascontiguousarray(image, np.float32).reshape(-1)
