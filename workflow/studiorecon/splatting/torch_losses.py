# SPDX-License-Identifier: Apache-2.0
"""The losses of ``losses`` on torch tensors, for training on a CUDA device: the same terms, weights and masks, gradients by autograd."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from kornia.filters import filter2d_separable

from studiorecon.splatting.coverage import DENSITY_OFFSET, DEPTH_SOFTNESS
from studiorecon.splatting.planes import DEPTH_ALPHA_MIN
from studiorecon.splatting.similarity import C1, C2, window


@dataclass(frozen=True)
class Image:
    """A target on the device: colours (3, H, W), weight (H, W), the SSIM window's mean and mean square of it (3, H, W)."""

    rgb: torch.Tensor
    weight: torch.Tensor
    mean: torch.Tensor
    square: torch.Tensor


def prepare(rgb: torch.Tensor, weight: torch.Tensor | None) -> Image:
    """A target (H, W, 3) with weights (H, W), None = 1; masked colours may be NaN."""
    weight = torch.ones_like(rgb[..., 0]) if weight is None else torch.where(weight > 0, weight, 0.0)
    planes = torch.where(weight > 0, rgb.permute(2, 0, 1), torch.nan_to_num(rgb.permute(2, 0, 1))).contiguous()
    return Image(planes, weight, _windowed(planes), _windowed(planes * planes))


def photometric(rgb: torch.Tensor, target: Image, l1: float, ssim: float) -> tuple[torch.Tensor, torch.Tensor]:
    """l1·L1 + ssim·(1 − SSIM) of a rendering (H, W, 3), and its mean squared error; means over the pixels of weight above 0."""
    used = target.weight > 0
    share = 1 / (3 * used.sum().clamp_min(1))
    x = torch.where(used, rgb.permute(2, 0, 1), target.rgb)
    error = x - target.rgb
    mx, xx, xy, my = _windowed(x), _windowed(x * x), _windowed(x * target.rgb), target.mean
    c1, c2 = float(C1), float(C2)
    similarity = (2 * mx * my + c1) * (2 * (xy - mx * my) + c2)
    similarity = similarity / ((mx * mx + my * my + c1) * (xx + target.square - mx * mx - my * my + c2))
    loss = (target.weight * (l1 * error.abs() + ssim * (1 - similarity))).sum() * share
    return loss, (error.detach() ** 2).sum() * share


def density(alpha: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """Mean of w·D(α), D(α) = log(1 + 1/e) + α − log(1 + e^{2α−1}): 0 for empty and for opaque pixels (numerics I14, U13)."""
    prior = float(DENSITY_OFFSET) + alpha - torch.nn.functional.softplus(2 * alpha - 1)
    return (weight * prior).sum() / (weight > 0).sum().clamp_min(1)


def depth(depth_sum: torch.Tensor, alpha: torch.Tensor, wanted_m: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """Mean of w·ρ(d/wanted − 1) where a depth is wanted, ρ the absolute value rounded to a parabola within 2 %."""
    known = (wanted_m > 0) & (weight > 0)
    drawn = known & (alpha >= float(DEPTH_ALPHA_MIN))
    ratio = torch.where(drawn, depth_sum / torch.where(drawn, alpha * wanted_m, 1.0), 1.0)
    size, soft = (ratio - 1).abs(), float(DEPTH_SOFTNESS)
    rounded = torch.where(size < soft, 0.5 * size * size / soft, size - 0.5 * soft)
    return (weight * rounded).sum() / known.sum().clamp_min(1)


def _windowed(planes: torch.Tensor) -> torch.Tensor:
    """(3, H, W) under the 11×11 Gaussian window, zeros outside."""
    taps = torch.as_tensor(window(), device=planes.device, dtype=planes.dtype)[None]
    return filter2d_separable(planes[:, None], taps, taps, border_type="constant")[:, 0]
