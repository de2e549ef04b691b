# SPDX-License-Identifier: Apache-2.0
"""The training loop: render a drawn target, compare, step the visible Gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.progress import progress, say
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting import growth, relocation, state
from studiorecon.splatting.adam import step_blocks
from studiorecon.splatting.checkpoint import Checkpoint
from studiorecon.splatting.conventions import LANES, OPACITY, QUATERNION, ROWS, SCALE, SH
from studiorecon.splatting.feedback import Feedback
from studiorecon.splatting.losses import Photometric, PreparedTarget, add_coverage, add_depth
from studiorecon.splatting.perceptual import Perceptual, perceptual
from studiorecon.splatting.planes import planes_to_images
from studiorecon.splatting.rasterise import Rasteriser
from studiorecon.splatting.schedule import TrainingSettings, exponential, rates_at
from studiorecon.splatting.state import TrainingState
from studiorecon.splatting.targets import DrawOrder, Target

__all__ = ["TrainedGaussians", "TrainingSettings", "exponential", "train"]

STATISTICS_BYTES_MAX = 1 << 30
"""Targets' SSIM statistics kept in memory; those beyond are computed anew at every use (4 to 11 % of the loss's time)."""
BETA_1, BETA_2 = 0.9, 0.999
EPSILON_STEPS = 4
EPSILON_LEAST = 1e-30
"""Keeps 0 / 0 away where a kind of parameter has had no gradient at all."""
RESET_OPACITY = 0.01
NOISE_OF_RATE = 5e5
"""What ``relocate_noise`` 1 means, as a multiple of the position learning rate (3DGS-MCMC's value)."""


@dataclass(frozen=True)
class TrainedGaussians:
    """Attributes:
    gaussians: in the order of the initial ones (descendants beside each other); without densification the same N.
    source: (N,) index of the initial Gaussian each descends from: what labels such as provenance are carried over with.
    psnr_db: mean over the last tenth of the iterations, on the pixels that counted.
    refused: gradient entries that were not finite and were skipped.
    left_out: Gaussians, given or trained, that were not finite and are not in the result.
    masked: pixels of targets that were not finite and did not count.
    """

    gaussians: Gaussians
    source: np.ndarray
    psnr_db: float
    refused: int
    left_out: int
    masked: int


def train(
    initial: Gaussians, targets: Sequence[Target], settings: TrainingSettings, rng: np.random.Generator, *, extent_m: float,
    span: tuple[int, int] | None = None, threads: int | None = None, label: str = "training", network: Perceptual | None = None,
    checkpoint: Checkpoint | None = None, previews: Path | None = None,
) -> TrainedGaussians:  # fmt: skip
    """Gaussians fitted to the targets.

    ``extent_m`` (``targets.scene_extent``) scales position steps. ``span`` runs only those iterations of the schedule, for loops that
    change the targets in between (Adam's moments start anew). ``network`` is asked when ``settings.lpips.weight`` is above 0.
    ``previews`` is the folder that receives a picture of the first target at every tenth of the way. The same inputs, generator state
    and ``threads`` give the same bytes, also when a killed run is taken up at its ``checkpoint``. Gaussians and pixels that are not
    finite are left out and counted. Raises Refusal without Gaussians or targets.
    """
    initial = initial.with_sh_degree(settings.sh_degree)
    given = np.flatnonzero(state.finite(initial))
    if len(given) == 0 or not targets:
        raise Refusal(f"{label}: there are {len(given)} finite Gaussians and {len(targets)} images; training needs some of both")
    left_out, initial = initial.count - len(given), initial.take(given)
    targets, masked = zip(*(target.sound() for target in targets))
    if settings.largest_scale_m > 0:
        initial = replace(initial, log_scales=np.minimum(initial.log_scales, np.float32(np.log(settings.largest_scale_m))))
    run = _Run(state.start(initial), targets, settings, rng, extent_m, threads, network)
    first, last = span or (0, settings.iterations)
    feedback, order = Feedback(label, first, last, previews), DrawOrder([target.share for target in targets], rng)
    say(f"{label}: {initial.count} Gaussians on {len(targets)} images, iterations {first} to {last}")
    begin = first
    if checkpoint is not None and (stored := checkpoint.load()) is not None:
        begin = run.resume(*stored, feedback, order)
        say(f"{label}: goes on at iteration {begin}, where it was interrupted")
    for iteration in progress(range(begin, last), label, last - begin):
        if feedback.add(*run.step(iteration, order.draw())):
            feedback.tell(run.state.blocked.count, targets[0].camera.name, *run.look())
        if checkpoint is not None and checkpoint.due():
            checkpoint.save(*run.snapshot(iteration + 1, feedback, order))
    back = np.argsort(run.state.source, kind="stable")
    trained = state.gaussians_of(run.state).take(back)
    kept = state.finite(trained)
    left_out += int(np.count_nonzero(~kept))
    for count, what in ((sum(masked), "pixels of targets"), (left_out, "Gaussians"), (run.refused, "gradient entries")):
        if count:
            say(f"{label}: {count} {what} were not finite and were left out")
    source = given[run.state.source[back]]
    return TrainedGaussians(trained.take(kept), source[kept], feedback.last_psnr_db, run.refused, left_out, int(sum(masked)))


class _Run:
    """One training run; ``step`` is the whole iteration."""

    def __init__(
        self, begin: TrainingState, targets: Sequence[Target], settings: TrainingSettings, rng: np.random.Generator, extent_m: float,
        threads: int | None, network: Perceptual | None = None,
    ) -> None:  # fmt: skip
        self.state, self.settings, self.rng, self.extent_m, self.network = begin, settings, rng, extent_m, network
        self.refused, self.steps = 0, 0
        self._rasteriser = Rasteriser(near_m=settings.near_m, threads=threads)
        self._targets = {False: list(targets), True: [None] * len(targets)}
        self._prepared: dict[tuple[bool, int], PreparedTarget] = {}
        self._losses: dict[tuple[int, int], tuple[Photometric, np.ndarray]] = {}
        self._statistics_bytes = 0
        self._squares, self._epsilons = np.zeros(ROWS), np.zeros(ROWS, np.float32)

    def snapshot(self, iteration: int, feedback: Feedback, order: DrawOrder) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """All that the iterations from ``iteration`` on depend on: arrays, and JSON facts."""
        arrays = {"squares": self._squares, "epsilons": self._epsilons, **feedback.record(), **state.arrays_of(self.state)}
        drawing = {"generator": self.rng.bit_generator.state, "pending": order.pending}
        return arrays, {"iteration": iteration, "steps": self.steps, "refused": self.refused, **drawing}

    def resume(self, arrays: dict[str, np.ndarray], facts: dict[str, Any], feedback: Feedback, order: DrawOrder) -> int:
        """Puts a ``snapshot`` back; returns the iteration to go on with."""
        self.state, self._squares, self._epsilons = state.restored(arrays), arrays["squares"], arrays["epsilons"]
        self.steps, self.refused, self.rng.bit_generator.state = facts["steps"], facts["refused"], facts["generator"]
        order.pending = facts["pending"]
        feedback.resume(arrays)
        return facts["iteration"]

    def look(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The first target as it is rendered now (H, W, 3), as it should be, and which pixels count (H, W) bool."""
        target = self._targets[False][0]
        shape = target.camera.hw
        rgb, alpha, depth_m = (np.empty(s, np.float32) for s in ((*shape, 3), shape, shape))
        with self._rasteriser.own_threads():
            planes_to_images(self._rasteriser.draw(self.state.blocked, target.camera, target.background_rgb), rgb, alpha, depth_m)
        return rgb, target.rgb, np.ones(shape, bool) if target.weight is None else target.weight > 0

    def step(self, iteration: int, index: int) -> tuple[float, float]:
        """One iteration on one target; returns loss and PSNR."""
        s = self.settings
        target, prepared, photometric, gradient = self._target(iteration < s.warmup_half_resolution * s.iterations, index)
        degree = s.sh_degree if s.sh_degree_every == 0 else min(s.sh_degree, iteration // s.sh_degree_every)
        with self._rasteriser.own_threads():
            planes = self._rasteriser.draw(replace(self.state.blocked, degree=degree), target.camera, target.background_rgb)
            terms = photometric.evaluate(planes, prepared, gradient)
            gradient[3:] = 0
            loss = terms.total
            if s.density > 0:
                loss += add_coverage(planes, None, target.weight, 0.0, s.density, gradient)
            if s.depth > 0 and target.depth_m is not None:
                loss += add_depth(planes, target.depth_m, target.weight, s.depth, gradient)
            if s.lpips.weight > 0 and self.network is not None and iteration % s.lpips.every == 0:
                rendered = np.ascontiguousarray(planes[:3].transpose(1, 2, 0))
                distance, slope = perceptual(self.network, s.lpips, rendered, target.rgb, target.weight, self.rng)
                loss += distance
                gradient[:3] += slope.transpose(2, 0, 1)
            self._adam(iteration, degree, self._rasteriser.gather(gradient))
            self._grow(iteration, target.camera.wh[0])
        return loss, terms.psnr_db

    def _target(self, half: bool, index: int) -> tuple[Target, PreparedTarget, Photometric, np.ndarray]:
        target = self._targets[half][index]
        if target is None:
            target = self._targets[half][index] = self._targets[False][index].halved()
        hw = target.camera.hw
        if hw not in self._losses:
            self._losses[hw] = (Photometric(hw, self.settings.l1, self.settings.ssim), np.zeros((5, *hw), np.float32))
        photometric, gradient = self._losses[hw]
        if (half, index) not in self._prepared:
            keep = self._statistics_bytes + photometric.statistics_bytes <= STATISTICS_BYTES_MAX
            self._statistics_bytes += photometric.statistics_bytes if keep else 0
            self._prepared[half, index] = photometric.prepare(target.rgb, target.weight, keep)
        return target, self._prepared[half, index], photometric, gradient

    def _adam(self, iteration: int, degree: int, by_blocks: np.ndarray) -> None:
        s, visible = self.settings, self._rasteriser.visible
        self.steps += 1
        if self.steps <= EPSILON_STEPS:
            self._settle_epsilons(by_blocks, visible)
        refused = np.empty(len(visible) // LANES, np.int32)
        f32 = np.float32
        step_blocks(
            self.state.blocked.parameters, self.state.raw, by_blocks, self.state.first, self.state.second,
            rates_at(s, iteration, self.extent_m), self._epsilons, f32(BETA_1), f32(BETA_2), f32(1 - BETA_1**self.steps),
            f32(1 - BETA_2**self.steps), visible, SH + 3 * (degree + 1) ** 2, f32(s.opacity_pull / max(1, self._rasteriser.visible_count)),
            f32(np.log(s.largest_scale_m)) if s.largest_scale_m > 0 else f32(np.inf), refused,
        )  # fmt: skip
        self.refused += int(refused.sum())

    def _settle_epsilons(self, by_blocks: np.ndarray, visible: np.ndarray) -> None:
        """Per kind of parameter: ``adam_epsilon`` × root mean square gradient over the first steps."""
        shown, gradients = visible.reshape(-1, LANES) != 0, by_blocks.reshape(-1, ROWS, LANES)
        count = max(1, int(shown.sum())) * EPSILON_STEPS
        for row in range(ROWS):  # one at a time: all at once in float64 would be the largest thing in memory
            # An infinite gradient that counted here would make epsilon infinite, and nothing would ever move again.
            seen = np.where(shown & np.isfinite(gradients[:, row]), gradients[:, row], 0).astype(np.float64)
            self._squares[row] += np.square(seen).sum() / count
        for rows in (slice(0, SCALE), slice(SCALE, QUATERNION), slice(QUATERNION, OPACITY), slice(OPACITY, SH), slice(SH, ROWS)):
            typical = np.sqrt(self._squares[rows].max() * EPSILON_STEPS / self.steps)
            self._epsilons[rows] = max(self.settings.adam_epsilon * typical, EPSILON_LEAST)

    def _grow(self, iteration: int, width: int) -> None:
        """Density control after the step of ``iteration``, as ``densify`` says."""
        s, done, before = self.settings, iteration + 1, self.state
        # What is added after the last step would be in the result untrained: 6 dB on the photos when seen.
        if s.densify == "none" or done > s.densify_until or done >= s.iterations:
            return
        due = done >= s.densify_from and done % s.densify_every == 0
        if s.densify == "gradient":
            state.add_screen_gradient(
                self._rasteriser.visible, self._rasteriser.screen, np.float32(width / 2), before.gradient_sum, before.gradient_count
            )  # fmt: skip
        elif s.relocate_noise > 0:
            relocation.wander(before.blocked, s.relocate_noise * NOISE_OF_RATE * float(rates_at(s, iteration, self.extent_m)[0]), self.rng)
        if due and s.densify == "gradient":
            mean = before.gradient_sum / np.maximum(before.gradient_count, 1)
            grown = growth.grow(
                state.gaussians_of(before), mean[: before.blocked.count], threshold=s.densify_gradient,
                large_m=s.densify_scale * self.extent_m, prune_opacity=s.prune_opacity, cap=s.cap, rng=self.rng,
            )  # fmt: skip
        elif due:
            grown = relocation.relocate(
                state.gaussians_of(before), dead_opacity=s.prune_opacity, growth=s.relocate_growth, cap=s.cap, rng=self.rng
            )
        if due:
            self.state = state.regrown(before, grown.gaussians, grown.parent, grown.fresh)
        if s.opacity_reset_every > 0 and done % s.opacity_reset_every == 0:
            state.lower_opacities(self.state, RESET_OPACITY)
