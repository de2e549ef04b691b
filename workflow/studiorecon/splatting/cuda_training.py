# SPDX-License-Identifier: Apache-2.0
"""The training loop of ``training`` on a CUDA device: gsplat draws, torch does losses and Adam, and nothing leaves the device.

Settings, targets, draw order, schedules, epsilons and density control are the same, so it learns the same to rounding. Sums over pixels
are atomic there and come in any order, so that two runs differ by rounding; a run taken up at its checkpoint continues from the very
bits it had, and differs from an uninterrupted one by no more than that.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from studiorecon.errors import Refusal
from studiorecon.progress import progress, say, warn
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting import growth, relocation, torch_losses
from studiorecon.splatting.checkpoint import Checkpoint
from studiorecon.splatting.conventions import OPACITY, QUATERNION, SCALE, SH
from studiorecon.splatting.feedback import Feedback
from studiorecon.splatting.gsplat_rasteriser import FIELDS, Rasterization, View, gsplat_function, view
from studiorecon.splatting.perceptual import Perceptual, perceptual
from studiorecon.splatting.schedule import TrainingSettings, rates_at
from studiorecon.splatting.state import finite
from studiorecon.splatting.targets import DrawOrder, Target
from studiorecon.splatting.torch_adam import Adam
from studiorecon.splatting.training import NOISE_OF_RATE, RESET_OPACITY, TrainedGaussians


def train(
    initial: Gaussians, targets: Sequence[Target], settings: TrainingSettings, rng: np.random.Generator, *, extent_m: float,
    span: tuple[int, int] | None = None, label: str = "training", network: Perceptual | None = None,
    checkpoint: Checkpoint | None = None, previews: Path | None = None, place: str = "cuda", function: Rasterization | None = None,
) -> TrainedGaussians:  # fmt: skip
    """Gaussians fitted to the targets; arguments, result and refusals as for ``training.train``.

    ``place`` and ``function`` (in place of gsplat's) let it run without a GPU.
    """
    given = np.flatnonzero(finite(initial))
    if len(given) == 0 or not targets:
        raise Refusal(f"{label}: there are {len(given)} finite Gaussians and {len(targets)} images; training needs some of both")
    left_out, initial = initial.count - len(given), initial.take(given).with_sh_degree(settings.sh_degree)
    targets, masked = zip(*(target.sound() for target in targets))
    run = _Run(initial, targets, settings, rng, extent_m, network, place, function or gsplat_function())
    first, last = span or (0, settings.iterations)
    feedback, order = Feedback(label, first, last, previews), DrawOrder([target.share for target in targets], rng)
    say(f"{label}: {initial.count} Gaussians on {len(targets)} images, iterations {first} to {last} on {place}")
    begin = first
    if checkpoint is not None and (stored := checkpoint.load()) is not None:
        begin = run.resume(*stored, feedback, order)
        say(f"{label}: goes on at iteration {begin}, where it was interrupted")
    for iteration in progress(range(begin, last), label, last - begin):
        if feedback.add(*run.step(iteration, order.draw())):
            feedback.tell(len(run.source), targets[0].camera.name, *run.look())
        if checkpoint is not None and checkpoint.due():
            checkpoint.save(*run.snapshot(iteration + 1, feedback, order))
    back = np.argsort(run.source, kind="stable")
    trained, source = run.gaussians().take(back), given[run.source[back]]
    kept = finite(trained)
    left_out += int(np.count_nonzero(~kept))
    refused = int(run.adam.refused)
    for count, what in ((sum(masked), "pixels of targets"), (left_out, "Gaussians"), (refused, "gradient entries")):
        if count:
            warn(f"{label}: {count} {what} were not finite and were left out")
    return TrainedGaussians(trained.take(kept), source[kept], feedback.last_psnr_db, refused, left_out, int(sum(masked)))


class _Run:
    """One training run; ``step`` is the whole iteration."""

    def __init__(
        self, initial: Gaussians, targets: Sequence[Target], settings: TrainingSettings, rng: np.random.Generator, extent_m: float,
        network: Perceptual | None, place: str, function: Rasterization,
    ) -> None:  # fmt: skip
        self.settings, self.rng, self.extent_m, self.network = settings, rng, extent_m, network
        self.source = np.arange(initial.count)
        self._place, self._function = place, function
        self._generator = torch.Generator(place).manual_seed(int(rng.bit_generator.seed_seq.generate_state(1)[0]))
        self._targets = {False: list(targets), True: [None] * len(targets)}
        self._images: dict[tuple[bool, int], tuple[torch_losses.Image, torch.Tensor | None]] = {}
        self._put({name: getattr(initial, name) for name in FIELDS})
        self.adam = Adam(self.leaves, settings.adam_epsilon)

    def _put(self, arrays: dict[str, np.ndarray]) -> None:
        self.leaves = {name: torch.tensor(array, device=self._place, requires_grad=True) for name, array in arrays.items()}
        if self.settings.largest_scale_m > 0:
            self.leaves["log_scales"].data.clamp_(max=float(np.log(self.settings.largest_scale_m)))
        self._seen = torch.zeros((2, len(self.source)), device=self._place)

    def snapshot(self, iteration: int, feedback: Feedback, order: DrawOrder) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """All that the iterations from ``iteration`` on depend on: arrays, and JSON facts."""
        arrays = {name: leaf.detach().cpu().numpy() for name, leaf in self.leaves.items()}
        arrays |= {f"adam.{name}": value for name, value in self.adam.arrays().items()}
        arrays |= {"source": self.source, "seen": self._seen.cpu().numpy(), "noise": self._generator.get_state().numpy()}
        return {**arrays, **feedback.record()}, {
            "iteration": iteration, "generator": self.rng.bit_generator.state, "pending": order.pending,
        }  # fmt: skip

    def resume(self, arrays: dict[str, np.ndarray], facts: dict[str, Any], feedback: Feedback, order: DrawOrder) -> int:
        """Puts a ``snapshot`` back; returns the iteration to go on with."""
        self.source = arrays["source"]
        self._put({name: arrays[name] for name in FIELDS})
        self._seen.copy_(torch.as_tensor(arrays["seen"]))
        self.adam.resume({name.removeprefix("adam."): value for name, value in arrays.items() if name.startswith("adam.")})
        self._generator.set_state(torch.as_tensor(arrays["noise"]))
        self.rng.bit_generator.state, order.pending = facts["generator"], facts["pending"]
        feedback.resume(arrays)
        return facts["iteration"]

    def gaussians(self) -> Gaussians:
        """As they are now, in the loop's order."""
        return Gaussians(*(self.leaves[name].detach().cpu().numpy() for name in FIELDS))

    def look(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The first target as it is rendered now (H, W, 3), as it should be, and which pixels count (H, W) bool."""
        target = self._targets[False][0]
        with torch.no_grad():
            shown = self._draw(target, self.settings.sh_degree).rgb.cpu().numpy()
        return shown, target.rgb, np.ones(target.camera.hw, bool) if target.weight is None else target.weight > 0

    def step(self, iteration: int, index: int) -> tuple[float, float]:
        """One iteration on one target; returns loss and PSNR. In float32 whatever the caller's autocast says (numerics rule 1)."""
        with torch.autocast(self.adam.refused.device.type, enabled=False):
            return self._step(iteration, index)

    def _step(self, iteration: int, index: int) -> tuple[float, float]:
        s = self.settings
        target, image, wanted_m = self._target(iteration < s.warmup_half_resolution * s.iterations, index)
        degree = s.sh_degree if s.sh_degree_every == 0 else min(s.sh_degree, iteration // s.sh_degree_every)
        drawn = self._draw(target, degree)
        loss, squared = torch_losses.photometric(drawn.rgb, image, s.l1, s.ssim)
        if s.density > 0:
            loss = loss + s.density * torch_losses.density(drawn.alpha, image.weight)
        if s.depth > 0 and wanted_m is not None:
            loss = loss + s.depth * torch_losses.depth(drawn.depth_sum, drawn.alpha, wanted_m, image.weight)
        if s.lpips.weight > 0 and self.network is not None and iteration % s.lpips.every == 0:
            rendered = drawn.rgb.detach().cpu().numpy()
            distance, slope = perceptual(self.network, s.lpips, rendered, target.rgb, target.weight, self.rng)
            by_rgb = torch.as_tensor(slope, device=self._place)
            loss = loss + distance + (by_rgb * (drawn.rgb - drawn.rgb.detach())).sum()
        told = loss.detach()
        if s.opacity_pull > 0:
            opacity = torch.sigmoid(self.leaves["logit_opacities"])
            loss = loss + s.opacity_pull * (opacity * drawn.visible).sum() / drawn.visible.sum().clamp_min(1)
        for leaf in self.leaves.values():
            leaf.grad = None
        loss.backward()
        rates = rates_at(s, iteration, self.extent_m)
        by_field = dict(zip(FIELDS, (float(rates[row]) for row in (0, QUATERNION, SCALE, OPACITY, SH))))
        self.adam.step(self.leaves, by_field, float(rates[-1]), (degree + 1) ** 2, drawn.visible)
        if s.largest_scale_m > 0:
            self.leaves["log_scales"].data.clamp_(max=float(np.log(s.largest_scale_m)))
        self._grow(iteration, target.camera.wh[0], drawn)
        value, error = torch.stack([told, squared]).tolist()
        return value, -10 * float(np.log10(max(error, 1e-12)))

    def _draw(self, target: Target, degree: int) -> View:
        behind = torch.tensor(target.background_rgb, dtype=torch.float32, device=self._place)
        return view(self.leaves, target.camera, behind, self.settings.near_m, degree=degree, antialias=False, function=self._function)

    def _target(self, half: bool, index: int) -> tuple[Target, torch_losses.Image, torch.Tensor | None]:
        target = self._targets[half][index]
        if target is None:
            target = self._targets[half][index] = self._targets[False][index].halved()
        if (half, index) not in self._images:
            rgb, weight, depth_m = (
                None if array is None else torch.as_tensor(np.ascontiguousarray(array, np.float32), device=self._place)
                for array in (target.rgb, target.weight, target.depth_m)
            )
            self._images[half, index] = (torch_losses.prepare(rgb, weight), depth_m)
        return target, *self._images[half, index]

    @torch.no_grad()
    def _grow(self, iteration: int, width: int, drawn: View) -> None:
        """Density control after the step of ``iteration``, as ``densify`` says; chosen on the CPU by the same functions."""
        s, done = self.settings, iteration + 1
        # What is added after the last step would be in the result untrained.
        if s.densify == "none" or done > s.densify_until or done >= s.iterations:
            return
        due, grown = done >= s.densify_from and done % s.densify_every == 0, None
        if s.densify == "gradient":
            if drawn.centres.grad is not None:
                self._seen[0] += drawn.visible * drawn.centres.grad[0].norm(dim=1) * (width / 2)
                self._seen[1] += drawn.visible
            if due:
                mean = (self._seen[0] / self._seen[1].clamp_min(1)).cpu().numpy()
                grown = growth.grow(
                    self.gaussians(), mean, threshold=s.densify_gradient, large_m=s.densify_scale * self.extent_m,
                    prune_opacity=s.prune_opacity, cap=s.cap, rng=self.rng,
                )  # fmt: skip
        else:
            if s.relocate_noise > 0:
                self._wander(s.relocate_noise * NOISE_OF_RATE * float(rates_at(s, iteration, self.extent_m)[0]))
            if due:
                grown = relocation.relocate(
                    self.gaussians(), dead_opacity=s.prune_opacity, growth=s.relocate_growth, cap=s.cap, rng=self.rng
                )  # fmt: skip
        if grown is not None:
            self.source = self.source[grown.parent]
            self._put({name: getattr(grown.gaussians, name) for name in FIELDS})
            self.adam.regrow(grown.parent, grown.fresh)
        if s.opacity_reset_every > 0 and done % s.opacity_reset_every == 0:
            self.leaves["logit_opacities"].clamp_(max=float(np.log(RESET_OPACITY / (1 - RESET_OPACITY))))
            self.adam.forget("logit_opacities")

    def _wander(self, strength: float) -> None:
        """``relocation.wander`` on the device: Σ η of the faint, by an opacity gate."""
        faint = torch.nonzero(torch.sigmoid(self.leaves["logit_opacities"]) < relocation.NOISE_NONE).flatten()
        q = torch.nn.functional.normalize(self.leaves["quaternions"][faint], dim=1)
        scales, opacity = self.leaves["log_scales"][faint].exp(), torch.sigmoid(self.leaves["logit_opacities"][faint])
        noise = torch.randn((len(faint), 3), generator=self._generator, device=self._place)
        inverse = q * q.new_tensor([1.0, -1, -1, -1])
        spread = _turned(q, scales**2 * _turned(inverse, noise))
        gate = torch.sigmoid(-relocation.NOISE_STEEPNESS * (opacity - relocation.NOISE_OPACITY))
        self.leaves["means_m"][faint] += strength * gate[:, None] * spread


def _turned(quaternions: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
    """Vectors (N, 3) turned by unit quaternions (N, 4)."""
    w, axis = quaternions[:, :1], quaternions[:, 1:]
    across = 2 * torch.linalg.cross(axis, vectors)
    return vectors + w * across + torch.linalg.cross(axis, across)
