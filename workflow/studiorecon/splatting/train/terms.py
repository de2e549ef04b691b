# SPDX-License-Identifier: Apache-2.0
"""The terms of a training's loss, each for planes on the CPU (gradient by hand) and tensors on CUDA (autograd).

A training names the weights of its terms, ``active_terms`` builds them, and the loop in ``trainer`` adds them up. Every
term but LPIPS is a mean over the pixels whose weight is above 0, of weight times error: with weights 0 and 1 that is Σ
m·l / Σ m (U11), and a weight of 3 counts three times (U15). With ``weighing`` "photometric" it is as printed in the
paper. SSIM enters as 1 − SSIM, not halved (U10).

A new term is a class with ``on_cpu`` and ``on_cuda``, its line in ``WEIGHED`` and a setting of that name.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from studiorecon.splatting.cpu.alpha_loss import DENSITY_OFFSET, density_terms, silhouette_terms
from studiorecon.splatting.cpu.ssim import C1, C2, window
from studiorecon.splatting.train.perceptual import Perceptual, PerceptualSettings, perceptual, perceptual_of_tensors
from studiorecon.splatting.train.photometric import BufferPool, Photometric, PreparedTarget, flatten_image
from studiorecon.splatting.train.targets import Target

if TYPE_CHECKING:
    import torch
    from jaxtyping import Float

STATISTICS_BYTES_MAX = 1 << 30
"""Targets' SSIM statistics kept in memory, on either device: with 716 targets of 1280×720 they would fill 16 GB of a
card. Those beyond are computed at every use (4 to 11 % of the loss's time on the CPU)."""


@dataclass
class PlaneView:
    """A picture drawn on the CPU, its target, and the gradient that terms add to.

    Attributes:
        target: the image that it is compared with.
        iteration, rng: for terms that are not evaluated at every step, or on random crops.
        planes: red, green, blue, depth sum, transmittance.
        gradient: of the loss by red, green, blue, depth sum and alpha; 0 before the first term.
        key: cache key of a target that comes again unchanged; None = it was made for this step.
        psnr_db: over the pixels that count; the photometric term sets it.
    """

    target: Target
    iteration: int
    rng: np.random.Generator
    planes: Float[np.ndarray, "5 H W"]
    gradient: Float[np.ndarray, "5 H W"]
    key: Hashable | None = None
    psnr_db: float = 0.0

    def total(self, terms: Sequence[Term]) -> float:
        """The loss; fills ``gradient``."""
        loss = 0.0
        for term in terms:
            loss += term.on_cpu(self)
        return loss


@dataclass
class TensorView:
    """A picture as tensors that carry gradients, and its target; see ``PlaneView``.

    Attributes:
        rgb, alpha: (H, W, 3), (H, W) as drawn.
        wanted_rgb: (3, H, W); where the weight is 0 it may be anything finite.
        weight: (H, W), 0 = masked.
        squared_error: () mean over the pixels that count; the photometric term sets it.
    """

    target: Target
    iteration: int
    rng: np.random.Generator
    rgb: torch.Tensor
    alpha: torch.Tensor
    wanted_rgb: torch.Tensor
    weight: torch.Tensor
    key: Hashable | None
    squared_error: torch.Tensor | None = None

    def total(self, terms: Sequence[Term]) -> torch.Tensor:
        """The loss as a tensor to call ``backward`` on."""
        loss = terms[0].on_cuda(self)
        for term in terms[1:]:
            loss = loss + term.on_cuda(self)
        return loss


class Term(Protocol):
    """One summand of the loss, weight included."""

    def on_cpu(self, view: PlaneView) -> float:
        """The term's value; adds its gradient to ``view.gradient``."""

    def on_cuda(self, view: TensorView) -> torch.Tensor:
        """The term's value as a () tensor."""


class L1AndSsim:
    """l1·L1 + ssim·(1 − SSIM), in one pass; the target replaces pixels of weight 0, so they leave windows unbiased."""

    def __init__(self, l1: float, ssim: float) -> None:
        self.l1, self.ssim = l1, ssim
        self._kernels: dict[tuple[int, int], Photometric] = {}
        self._memory = BufferPool()
        self._prepared: dict[Hashable, PreparedTarget] = {}
        self._windowed: dict[Hashable, tuple[torch.Tensor, torch.Tensor]] = {}
        self._statistics_bytes = 0

    def _keeps(self, statistics_bytes: int) -> bool:
        """Whether one more target's statistics are kept, which are counted then."""
        keep = self._statistics_bytes + statistics_bytes <= STATISTICS_BYTES_MAX
        self._statistics_bytes += statistics_bytes if keep else 0
        return keep

    def on_cpu(self, view: PlaneView) -> float:
        hw, target = view.planes.shape[1:], view.target
        if view.key is None:
            kernel = Photometric(hw, self.l1, self.ssim, self._memory)
            prepared = kernel.prepare(target.rgb, target.weight, keep_statistics=False)
        else:
            if hw not in self._kernels:
                self._kernels[hw] = Photometric(hw, self.l1, self.ssim)
            kernel = self._kernels[hw]
            if view.key not in self._prepared:
                keep = self._keeps(kernel.statistics_bytes)
                self._prepared[view.key] = kernel.prepare(target.rgb, target.weight, keep)
            prepared = self._prepared[view.key]
        found = kernel.evaluate(view.planes, prepared, view.gradient)
        view.psnr_db = found.psnr_db
        return found.total

    def on_cuda(self, view: TensorView) -> torch.Tensor:
        import torch

        used, wanted = view.weight > 0, view.wanted_rgb
        windowed = self._windowed.get(view.key)
        if windowed is None:
            windowed = _apply_window(wanted), _apply_window(wanted * wanted)
            if view.key is not None and self._keeps(sum(part.nbytes for part in windowed)):
                self._windowed[view.key] = windowed
        my, yy = windowed
        share = 1 / (3 * used.sum().clamp_min(1))
        x = torch.where(used, view.rgb.permute(2, 0, 1), wanted)
        error = x - wanted
        mx, xx, xy = _apply_window(x), _apply_window(x * x), _apply_window(x * wanted)
        c1, c2 = float(C1), float(C2)
        similarity = (2 * mx * my + c1) * (2 * (xy - mx * my) + c2)
        similarity = similarity / ((mx * mx + my * my + c1) * (xx + yy - mx * mx - my * my + c2))
        view.squared_error = (error.detach() ** 2).sum() * share
        return (view.weight * (self.l1 * error.abs() + self.ssim * (1 - similarity))).sum() * share


def _apply_window(planes: torch.Tensor) -> torch.Tensor:
    """(3, H, W) under the 11×11 Gaussian window, zeros outside, differentiable."""
    return _window_on_device().apply(planes)


@cache
def _window_on_device() -> type[torch.autograd.Function]:
    """An autograd function of the window, its own adjoint; a convolution's derivative takes an H100 2.7 times as
    long."""
    import torch
    from kornia.filters import filter2d_separable

    def filtered(planes: torch.Tensor) -> torch.Tensor:
        taps = torch.as_tensor(window(), device=planes.device, dtype=planes.dtype)[None]
        # Variances are differences of the outputs: TF32's ten bits, which cuDNN may use, are noise in flat regions.
        with torch.backends.cudnn.flags(enabled=True, benchmark=False, deterministic=False, allow_tf32=False):
            return filter2d_separable(planes[:, None], taps, taps, border_type="constant")[:, 0]

    class Windowed(torch.autograd.Function):
        @staticmethod
        def forward(context: Any, planes: torch.Tensor) -> torch.Tensor:
            return filtered(planes)

        @staticmethod
        def backward(context: Any, gradient: torch.Tensor) -> torch.Tensor:
            return filtered(gradient)

    return Windowed


@dataclass(frozen=True)
class Silhouette:
    """L1 of alpha and the target's silhouette: no part of the person outside of it, no hole inside (U52)."""

    weight: float

    def on_cpu(self, view: PlaneView) -> float:
        weight, wanted = view.target.weight, view.target.silhouette
        assert weight is not None
        assert wanted is not None
        counted = max(int(np.count_nonzero(weight)), 1)
        sums = np.zeros(len(weight), np.float32)
        silhouette_terms(view.planes, weight, wanted, np.float32(self.weight / counted), view.gradient, sums)
        return self.weight * float(sums.sum(dtype=np.float64)) / counted

    def on_cuda(self, view: TensorView) -> torch.Tensor:
        miss = (view.alpha - view.alpha.new_tensor(view.target.silhouette)) * view.weight
        return self.weight * miss.abs().sum() / (view.weight > 0).sum().clamp_min(1)


@dataclass(frozen=True)
class Density:
    """Loss that pulls alpha to 0 or 1 (I14, U13): the mean of D(α) = log(1 + 1/e) + α − log(1 + e^{2α−1}).

    D is 0 for empty and for opaque pixels and 0.120 half-way; its slope is tanh(½ − α), finite everywhere.
    ``everywhere``: over all pixels, masked ones too, as in the paper's Eq. 5.
    """

    weight: float
    everywhere: bool = False

    def on_cpu(self, view: PlaneView) -> float:
        weight = None if self.everywhere else view.target.weight
        used = view.planes[4].size if weight is None else int(np.count_nonzero(weight > 0))
        strength = np.float32(self.weight * (1.0 / used if used else 0.0))
        sums = np.zeros(view.planes.shape[1], np.float32)
        density_terms(view.planes, flatten_image(weight), strength, view.gradient, sums)
        return float(sums.sum(dtype=np.float64) * strength)

    def on_cuda(self, view: TensorView) -> torch.Tensor:
        from torch.nn.functional import softplus

        prior = float(DENSITY_OFFSET) + view.alpha - softplus(2 * view.alpha - 1)
        if self.everywhere:
            return self.weight * prior.mean()
        return self.weight * (view.weight * prior).sum() / (view.weight > 0).sum().clamp_min(1)


@dataclass(frozen=True)
class LpipsTerm:
    """The perceptual distance on a random crop at every n-th step; without a network it is 0.

    ``weighed``: times the mean weight of the crop's pixels that count, as in Eq. 5 of the paper.
    """

    settings: PerceptualSettings
    network: Perceptual | None
    weighed: bool = False

    def on_cpu(self, view: PlaneView) -> float:
        if self.network is None or view.iteration % self.settings.steps != 0:
            return 0.0
        rendered, target = np.ascontiguousarray(view.planes[:3].transpose(1, 2, 0)), view.target
        value, by_rgb = perceptual(
            self.network, self.settings, rendered, target.rgb, target.weight, view.rng, self.weighed
        )
        view.gradient[:3] += by_rgb.transpose(2, 0, 1)
        return value

    def on_cuda(self, view: TensorView) -> torch.Tensor:
        if self.network is None or view.iteration % self.settings.steps != 0:
            return view.rgb.new_zeros(())
        rendered = view.rgb.permute(2, 0, 1)
        return perceptual_of_tensors(
            self.network, self.settings, rendered, view.wanted_rgb, view.weight, view.rng, self.weighed
        )


WEIGHED: dict[str, Callable[[float], Term]] = {"mask": Silhouette, "density": Density}
"""Terms with one number as their setting, by its name."""


def active_terms(weights: Any, network: Perceptual | None = None) -> list[Term]:
    """The terms whose weights (``l1``, ``ssim``, ``lpips``, names in ``WEIGHED``) are above 0; L1 and SSIM always.

    ``weighing``, where there is such a field, selects the errors that the targets' weights multiply.
    """
    named = ((make, getattr(weights, name, 0.0)) for name, make in WEIGHED.items())
    terms: list[Term] = [L1AndSsim(weights.l1, weights.ssim), *(make(weight) for make, weight in named if weight > 0)]
    photometric = getattr(weights, "weighing", "picture") == "photometric"
    terms = [Density(term.weight, everywhere=photometric) if isinstance(term, Density) else term for term in terms]
    return [*terms, LpipsTerm(weights.lpips, network, photometric)] if weights.lpips.weight > 0 else terms
