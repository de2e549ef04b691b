# SPDX-License-Identifier: Apache-2.0
"""A still set of Gaussians in training on a CUDA device: gsplat draws, torch differentiates.

Settings, targets, draw order, terms, schedules, epsilons and density control are those of ``train/blocked_set``, so it
learns the same to rounding. A run resumed at its checkpoint continues from exactly the same bits, and differs from an
uninterrupted one by no more than two runs do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.conventions import OPACITY, QUATERNION, SCALE, SH
from studiorecon.splatting.cuda.adam import Adam
from studiorecon.splatting.cuda.rasterise import FIELDS, DeviceView, Rasterization, draw_view, gsplat_function
from studiorecon.splatting.train import density
from studiorecon.splatting.train.schedule import TrainingSettings, degree_at, rates_at
from studiorecon.splatting.train.targets import DrawOrder, Target, TargetSizes
from studiorecon.splatting.train.terms import TensorView
from studiorecon.splatting.train.trainer import Preview

if TYPE_CHECKING:
    from jaxtyping import Shaped


class TensorSet:
    """Gaussians as tensors, and the targets they are fitted to; arguments as for ``train.still.train_still``.

    ``place`` and ``function`` (instead of gsplat's) let it run without a GPU. Each of ``leaves``, the fields of
    ``Gaussians``, has in ``source`` the index of the initial one it descends from; ``adam`` counts refused gradients.
    """

    def __init__(
        self,
        initial: Gaussians,
        targets: Sequence[Target],
        settings: TrainingSettings,
        rng: np.random.Generator,
        extent_m: float,
        *,
        place: str = "cuda",
        function: Rasterization | None = None,
    ) -> None:
        self._settings, self._rng, self._extent_m = settings, rng, extent_m
        self.source = np.arange(initial.count)
        self._place, self._function = place, function or gsplat_function()
        self._targets, self._order = TargetSizes(targets), DrawOrder([target.share for target in targets], rng)
        self._images: dict[tuple[bool, int], tuple[torch.Tensor, torch.Tensor]] = {}
        self._degree = 0
        self._drawn: DeviceView | None = None
        self._put({name: getattr(initial, name) for name in FIELDS})
        self.adam = Adam(self.leaves, settings.adam_epsilon)

    @property
    def refused(self) -> int:
        """Gradient entries so far that were not finite."""
        return int(self.adam.refused)

    def gaussians(self) -> Gaussians:
        """The current Gaussians, in the order of ``source``."""
        return Gaussians(*(self.leaves[name].detach().cpu().numpy() for name in FIELDS))

    @contextmanager
    def threads(self) -> Iterator[None]:
        """A context with float32 whatever the caller's autocast; the CPU's threads do not draw."""
        with torch.autocast(torch.device(self._place).type, enabled=False):
            yield

    def begin(self, iteration: int) -> None:
        """Does nothing: no part of a still set starts late."""

    def draw(self, iteration: int) -> TensorView:
        """The view of the next target in order, at half its size while warming up."""
        key, target = self._targets.at(self._settings, iteration, self._order.draw())
        if key not in self._images:
            self._images[key] = self._image(target)
        rgb, weight = self._images[key]
        self._degree = degree_at(self._settings, iteration)
        drawn = self._drawn = self._view(target, self._degree)
        return TensorView(target, iteration, self._rng, drawn.rgb, drawn.alpha, rgb, weight, key)

    def step(self, iteration: int, view: TensorView, loss: torch.Tensor) -> tuple[float, float]:
        """Move the Gaussians by autograd and Adam, then control their density; returns loss and PSNR."""
        s, drawn = self._settings, self._drawn
        assert drawn is not None
        assert view.squared_error is not None
        for leaf in self.leaves.values():
            leaf.grad = None
        loss.backward()
        rates = rates_at(s, iteration, self._extent_m)
        by_field = dict(zip(FIELDS, (float(rates[row]) for row in (0, QUATERNION, SCALE, OPACITY, SH))))
        self.adam.step(self.leaves, by_field, float(rates[-1]), (self._degree + 1) ** 2, drawn.visible)
        if s.largest_scale_m > 0:
            self.leaves["log_scales"].data.clamp_(max=float(np.log(s.largest_scale_m)))
        self._control(iteration + 1, view.target.camera.wh[0])
        value, error = torch.stack([loss.detach(), view.squared_error]).tolist()
        return value, -10 * float(np.log10(max(error, 1e-12)))

    @torch.no_grad()
    def _control(self, done: int, width: int) -> None:
        """Add and remove Gaussians, chosen on the CPU by the same functions."""
        s, drawn = self._settings, self._drawn
        assert drawn is not None
        if density.is_density_control_on(s, done) and drawn.centres.grad is not None:
            self._seen[0] += drawn.visible * drawn.centres.grad[0].norm(dim=1) * (width / 2)
            self._seen[1] += drawn.visible
        if density.is_growth_step(s, done):
            mean = (self._seen[0] / self._seen[1].clamp_min(1)).cpu().numpy()
            grown = density.grow_scene(self.gaussians(), mean, s, self._extent_m, self._rng)
            self.source = self.source[grown.parent]
            self._put({name: getattr(grown.gaussians, name) for name in FIELDS})
            self.adam.regrow(grown.parent, grown.fresh)

    def preview(self) -> Preview:
        """A preview of the first target."""
        target = self._targets.first
        with torch.no_grad():
            shown = self._view(target, self._settings.sh_degree).rgb.cpu().numpy()
        return Preview(len(self.source), target.camera.name, shown, target.rgb, target.used)

    def snapshot(self) -> tuple[dict[str, Shaped[np.ndarray, " ..."]], dict[str, Any]]:
        """Parameters, Adam, screen gradients so far, and the rest of the round of targets."""
        arrays = {name: leaf.detach().cpu().numpy() for name, leaf in self.leaves.items()}
        arrays |= {f"adam.{name}": value for name, value in self.adam.arrays().items()}
        return arrays | {"source": self.source, "seen": self._seen.cpu().numpy()}, {"pending": self._order.pending}

    def resume(self, arrays: dict[str, Shaped[np.ndarray, " ..."]], facts: dict[str, Any]) -> None:
        """Restore a ``snapshot``."""
        self.source, self._order.pending = arrays["source"], facts["pending"]
        self._put({name: arrays[name] for name in FIELDS})
        self._seen.copy_(torch.as_tensor(arrays["seen"]))
        self.adam.resume({name.removeprefix("adam."): a for name, a in arrays.items() if name.startswith("adam.")})

    def _put(self, arrays: dict[str, np.ndarray]) -> None:
        self.leaves = {
            name: torch.tensor(array, device=self._place, requires_grad=True) for name, array in arrays.items()
        }
        self._seen = torch.zeros((2, len(self.source)), device=self._place)

    def _view(self, target: Target, degree: int) -> DeviceView:
        behind = torch.tensor(target.background_rgb, dtype=torch.float32, device=self._place)
        near_m, function = self._settings.near_m, self._function
        return draw_view(self.leaves, target.camera, behind, near_m, degree=degree, antialias=False, function=function)

    def _image(self, target: Target) -> tuple[torch.Tensor, torch.Tensor]:
        """Colours (3, H, W) and weight (H, W) of a target on the device; masked colours may be NaN."""
        weights = np.ones(target.rgb.shape[:2]) if target.weight is None else target.weight.clip(0)
        rgb, weight = (
            torch.as_tensor(np.ascontiguousarray(array, np.float32), device=self._place)
            for array in (target.rgb, weights)
        )
        rgb = rgb.permute(2, 0, 1)
        return torch.where(weight > 0, rgb, torch.nan_to_num(rgb)).contiguous(), weight
