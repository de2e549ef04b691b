# SPDX-License-Identifier: Apache-2.0
"""A still set of Gaussians in training on the CPU: parameter blocks, fused Adam of the visible, density control."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.cpu.planes import planes_to_images
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.train import density, state
from studiorecon.splatting.train.optimiser import BlockAdam
from studiorecon.splatting.train.schedule import TrainingSettings, degree_at, rates_at
from studiorecon.splatting.train.targets import DrawOrder, Target, TargetSizes
from studiorecon.splatting.train.terms import PlaneView
from studiorecon.splatting.train.trainer import Preview

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Shaped


class BlockedSet:
    """Gaussians in blocks, and the targets they are fitted to; arguments as for ``still.train_still``.

    Attributes:
        state: parameters and moments, and every Gaussian's source.
        adam: counts the gradients that it refused.
        order: chooses the next target.
    """

    def __init__(
        self,
        initial: Gaussians,
        targets: Sequence[Target],
        settings: TrainingSettings,
        rng: np.random.Generator,
        extent_m: float,
        threads: int | None,
    ) -> None:
        self.state, self.adam = state.initial_state(initial), BlockAdam(settings.adam_epsilon)
        self._settings, self._rng, self._extent_m = settings, rng, extent_m
        self.rasteriser = Rasteriser(near_m=settings.near_m, threads=threads)
        self._targets, self.order = TargetSizes(targets), DrawOrder([target.share for target in targets], rng)
        self._gradients: dict[tuple[int, int], np.ndarray] = {}
        self._degree = 0

    @property
    def source(self) -> Integer[np.ndarray, " N"]:
        """Index of the initial Gaussian each descends from."""
        return self.state.source

    @property
    def refused(self) -> int:
        """Gradient entries so far that were not finite."""
        return self.adam.refused

    def gaussians(self) -> Gaussians:
        """The current Gaussians, in the order of ``source``."""
        return state.state_gaussians(self.state)

    def threads(self) -> AbstractContextManager[None]:
        """The rasteriser's own context of threads."""
        return self.rasteriser.own_threads()

    def begin(self, iteration: int) -> None:
        """Does nothing: no part of a still set starts late."""

    def draw(self, iteration: int) -> PlaneView:
        """The view of the next target in order, at half its size while warming up."""
        key, target = self._targets.at(self._settings, iteration, self.order.draw())
        self._degree = degree_at(self._settings, iteration)
        blocked = replace(self.state.blocked, degree=self._degree)
        planes = self.rasteriser.draw(blocked, target.camera, target.background_rgb)
        if (hw := target.camera.hw) not in self._gradients:
            self._gradients[hw] = np.empty((5, *hw), np.float32)
        gradient = self._gradients[hw]
        gradient[:] = 0
        return PlaneView(target, iteration, self._rng, planes, gradient, key=key)

    def step(self, iteration: int, view: PlaneView, loss: float) -> tuple[float, float]:
        """Move the Gaussians by gradients in blocks and Adam, then control their density; returns loss and PSNR."""
        self.descend(iteration, self._degree, self.rasteriser.gather(view.gradient))
        self._control(iteration + 1, view.target.camera.wh[0])
        return loss, view.psnr_db

    def descend(self, iteration: int, degree: int, gradient: Float[np.ndarray, " P"]) -> None:
        """Do one step of Adam along a gradient in blocks."""
        s = self._settings
        most = np.log(s.largest_scale_m) if s.largest_scale_m > 0 else np.inf
        rates = rates_at(s, iteration, self._extent_m)
        self.adam.step(self.state, gradient, self.rasteriser.visible, rates, degree, most)

    def _control(self, done: int, width: int) -> None:
        s, before = self._settings, self.state
        if density.is_density_control_on(s, done):
            drawn = self.rasteriser
            state.add_screen_gradient(
                drawn.visible, drawn.screen, np.float32(width / 2), before.gradient_sum, before.gradient_count
            )
        if density.is_growth_step(s, done):
            mean = (before.gradient_sum / np.maximum(before.gradient_count, 1))[: before.blocked.count]
            grown = density.grow_scene(self.gaussians(), mean, s, self._extent_m, self._rng)
            self.state = state.regrow(before, grown.gaussians, grown.parent, grown.fresh)

    def preview(self) -> Preview:
        """A preview of the first target."""
        target = self._targets.first
        shape = target.camera.hw
        rgb, alpha, depth_m = (np.empty(s, np.float32) for s in ((*shape, 3), shape, shape))
        planes = self.rasteriser.draw(self.state.blocked, target.camera, target.background_rgb)
        planes_to_images(planes, rgb, alpha, depth_m)
        return Preview(self.state.blocked.count, target.camera.name, rgb, target.rgb, target.used)

    def snapshot(self) -> tuple[dict[str, Shaped[np.ndarray, " ..."]], dict[str, Any]]:
        """The state, Adam's epsilons, and the rest of the round of targets."""
        adam = {f"adam.{name}": value for name, value in self.adam.arrays().items()}
        return {**adam, **state.state_arrays(self.state)}, {"pending": self.order.pending}

    def resume(self, arrays: dict[str, Shaped[np.ndarray, " ..."]], facts: dict[str, Any]) -> None:
        """Restore a ``snapshot``."""
        self.state = state.restore_state(arrays)
        self.adam.resume({name.removeprefix("adam."): a for name, a in arrays.items() if name.startswith("adam.")})
        self.order.pending = facts["pending"]
