# SPDX-License-Identifier: Apache-2.0
"""The perceptual term (LPIPS) of training: its schedule, its crop of the picture, and the interface of its network.

The network is behind a Protocol, so that training without it needs neither torch nor weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from studiorecon.configuration.setting import setting

if TYPE_CHECKING:
    import torch
    from jaxtyping import Float

SMALLEST_PX = 16
"""A VGG16 halves a picture four times: below this side there is nothing left to compare."""


@dataclass(frozen=True)
class PerceptualSettings:
    """Schedule and crop of LPIPS: weighted ``every`` times at every ``every``-th step, on a square of ``crop_px``.

    ``whole``: at every step on the whole picture. On a CPU it is by far the slowest part of a step.
    """

    weight: float = setting(
        0.0,
        "Weight of LPIPS in the loss; needs weights of VGG16 and LPIPS.",
        minimum=0,
        paper="0.1 at every step; U12",
        paper_value=0.1,
    )
    whole: bool = setting(
        False,
        "LPIPS on the whole picture at every step, not on a 96 px square at every fourth.",
        paper="whole picture",
        paper_value=True,
    )
    every: int = 4
    crop_px: int = 96

    @property
    def steps(self) -> int:
        """Number of steps from one evaluation to the next."""
        return 1 if self.whole else self.every


class Perceptual(Protocol):
    """A distance between pictures that has a gradient."""

    def __call__(
        self, rendered: Float[np.ndarray, "h w 3"], target: Float[np.ndarray, "h w 3"]
    ) -> tuple[float, Float[np.ndarray, "h w 3"]]:
        """Distance of two float32 RGB pictures in [0, 1], and its gradient by ``rendered``."""

    def distance(self, rendered: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        """The same for two tensors (1, 3, h, w) on the network's device, as a () tensor that carries gradients."""


def choose_crop(hw: tuple[int, int], settings: PerceptualSettings, rng: np.random.Generator) -> tuple[slice, slice]:
    """Rows and columns of the compared crop, at most the whole picture."""
    if settings.whole:
        return slice(0, hw[0]), slice(0, hw[1])
    side = settings.crop_px
    starts = [int(rng.integers(max(0, size - side) + 1)) for size in hw]
    return slice(starts[0], starts[0] + min(side, hw[0])), slice(starts[1], starts[1] + min(side, hw[1]))


def perceptual(
    network: Perceptual,
    settings: PerceptualSettings,
    rendered: Float[np.ndarray, "H W 3"],
    target: Float[np.ndarray, "H W 3"],
    weight: Float[np.ndarray, "H W"] | None,
    rng: np.random.Generator,
    weighed: bool = False,
) -> tuple[float, Float[np.ndarray, "H W 3"]]:
    """The term's share of the loss for one picture, and its gradient; 0 for crops below ``SMALLEST_PX``.

    Where ``weight`` is 0 the target replaces the rendering, so masked pixels neither count nor affect their
    surroundings (U11). ``weighed``: times the mean weight of the others.
    """
    rows, columns = choose_crop(rendered.shape[:2], settings, rng)
    gradient = np.zeros(rendered.shape, np.float32)
    if min(rows.stop - rows.start, columns.stop - columns.start) < SMALLEST_PX:
        return 0.0, gradient
    used = np.ones(rendered.shape[:2], bool)[rows, columns] if weight is None else weight[rows, columns] > 0
    wanted = np.where(
        used[..., None], target[rows, columns], np.clip(np.nan_to_num(target[rows, columns]), 0, 1)
    ).astype(np.float32)
    shown = np.where(used[..., None], rendered[rows, columns], wanted).astype(np.float32)
    distance, slope = network(shown, wanted)
    strength = settings.weight * settings.steps
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
    """``perceptual`` for tensors on the drawing device, ``wanted`` (3, H, W) finite also where the weight is 0."""
    import torch

    rows, columns = choose_crop((weight.shape[0], weight.shape[1]), settings, rng)
    if min(rows.stop - rows.start, columns.stop - columns.start) < SMALLEST_PX:
        return rendered.new_zeros(())
    counted = weight[rows, columns]
    used, theirs = counted > 0, wanted[:, rows, columns]
    theirs = torch.where(used, theirs, theirs.clamp(0, 1))
    ours = torch.where(used, rendered[:, rows, columns], theirs)
    strength: float | torch.Tensor = settings.weight * settings.steps
    if weighed:
        strength = strength * counted.sum() / used.sum().clamp_min(1)
    return strength * network.distance(ours[None], theirs[None])
