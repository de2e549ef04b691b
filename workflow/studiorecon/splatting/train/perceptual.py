# SPDX-License-Identifier: Apache-2.0
"""The perceptual term (LPIPS) as training loops see it: how often, on which part of the picture, and what the network
gives back.

The network is behind a Protocol, so that who trains without it needs neither torch nor weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from studiorecon.configuration.setting import setting

if TYPE_CHECKING:
    import torch

SMALLEST_PX = 16
"""A VGG16 halves a picture four times: below this side there is nothing left to compare."""


@dataclass(frozen=True)
class PerceptualSettings:
    """How often, and on how much of a picture, LPIPS counts."""

    weight: float = setting(
        0.0,
        "Weight of LPIPS in the loss; above 0 it needs weights of VGG16 and LPIPS.",
        minimum=0,
        paper="0.1 at every step; U12",
        letter=0.1,
    )
    every: int = setting(4, "Steps between evaluations; each counts that many times.", minimum=1, paper="1", letter=1)
    crop_px: int = setting(
        96,
        "Side of the random square that is compared; 0 = the whole picture.",
        unit="px",
        minimum=0,
        paper="0",
        letter=0,
    )


class Perceptual(Protocol):
    """A distance between pictures that has a gradient."""

    def __call__(self, rendered: np.ndarray, target: np.ndarray) -> tuple[float, np.ndarray]:
        """Distance of two (h, w, 3) float32 RGB pictures in [0, 1], and its gradient (h, w, 3) by ``rendered``."""

    def distance(self, rendered: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        """The same of two tensors (1, 3, h, w) where the network lies, as a () tensor that carries gradients."""


def crop_of(hw: tuple[int, int], crop_px: int, rng: np.random.Generator) -> tuple[slice, slice]:
    """Rows and columns of a random square of ``crop_px``, cut to the picture; all of it when ``crop_px`` is 0."""
    if crop_px == 0:
        return slice(0, hw[0]), slice(0, hw[1])
    starts = [int(rng.integers(max(0, size - crop_px) + 1)) for size in hw]
    return slice(starts[0], starts[0] + min(crop_px, hw[0])), slice(starts[1], starts[1] + min(crop_px, hw[1]))


def perceptual(
    network: Perceptual,
    settings: PerceptualSettings,
    rendered: np.ndarray,
    target: np.ndarray,
    weight: np.ndarray | None,
    rng: np.random.Generator,
    weighed: bool = False,
) -> tuple[float, np.ndarray]:
    """The term's share of the loss and its gradient (H, W, 3) for one picture of (H, W, 3).

    Where ``weight`` (H, W) is 0 the target stands in for the rendering, so masked pixels neither count nor disturb
    their surroundings (U11). ``weighed``: times the mean weight of the others. 0 for crops below ``SMALLEST_PX``.
    """
    rows, columns = crop_of(rendered.shape[:2], settings.crop_px, rng)
    gradient = np.zeros(rendered.shape, np.float32)
    if min(rows.stop - rows.start, columns.stop - columns.start) < SMALLEST_PX:
        return 0.0, gradient
    used = np.ones(rendered.shape[:2], bool)[rows, columns] if weight is None else weight[rows, columns] > 0
    wanted = np.where(
        used[..., None], target[rows, columns], np.clip(np.nan_to_num(target[rows, columns]), 0, 1)
    ).astype(np.float32)
    shown = np.where(used[..., None], rendered[rows, columns], wanted).astype(np.float32)
    distance, slope = network(shown, wanted)
    strength = settings.weight * settings.every
    if weighed and weight is not None:
        strength *= float(weight[rows, columns][used].mean(dtype=np.float64)) if used.any() else 0.0
    gradient[rows, columns] = np.where(used[..., None], slope * np.float32(strength), 0)
    return strength * distance, gradient


def perceptual_of_tensors(
    network: Perceptual,
    settings: PerceptualSettings,
    rendered: torch.Tensor,
    wanted: torch.Tensor,
    weight: torch.Tensor,
    rng: np.random.Generator,
    weighed: bool = False,
) -> torch.Tensor:
    """``perceptual`` of tensors on the device that draws: ``rendered`` and ``wanted`` (3, H, W), ``weight`` (H, W),
    0 = masked, where ``wanted`` is finite. Nothing leaves the device."""
    import torch

    rows, columns = crop_of((weight.shape[0], weight.shape[1]), settings.crop_px, rng)
    if min(rows.stop - rows.start, columns.stop - columns.start) < SMALLEST_PX:
        return rendered.new_zeros(())
    counted = weight[rows, columns]
    used, theirs = counted > 0, wanted[:, rows, columns]
    theirs = torch.where(used, theirs, theirs.clamp(0, 1))
    ours = torch.where(used, rendered[:, rows, columns], theirs)
    strength: float | torch.Tensor = settings.weight * settings.every
    if weighed:
        strength = strength * counted.sum() / used.sum().clamp_min(1)
    return strength * network.distance(ours[None], theirs[None])
