# SPDX-License-Identifier: Apache-2.0
"""The training loop: render a drawn target, compare, step the visible Gaussians."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.progress import progress, say
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting import growth, state
from studiorecon.splatting.adam import step_blocks
from studiorecon.splatting.conventions import LANES, OPACITY, QUATERNION, ROWS, SCALE, SH
from studiorecon.splatting.losses import Photometric, PreparedTarget, add_coverage, add_depth
from studiorecon.splatting.rasterise import Rasteriser
from studiorecon.splatting.state import TrainingState
from studiorecon.splatting.targets import Target, draws

STATISTICS_BYTES_MAX = 1 << 30
"""Targets' SSIM statistics kept in memory; those beyond are computed again at every use (a third of the loss's time)."""


@dataclass(frozen=True)
class TrainingSettings:
    """What a stage's configuration section says about training.

    Attributes:
        iterations: steps of one image each.
        l1, ssim: weights of mean absolute error and of 1 − SSIM (U10, U11).
        density: weight of the prior that rendered alpha is 0 or 1 (U13).
        depth: weight of the relative depth error where targets have depth.
        opacity_pull: weight of the mean opacity, the alternative to ``density`` (U13).
        position_lr_start, position_lr_end: exponential schedule, per metre of scene extent.
        scale_lr, rotation_lr, opacity_lr: steps of log scales, quaternions and logit opacities.
        sh_lr, sh_rest_lr: steps of the constant harmonic and of the others.
        adam_epsilon: relative to the first steps' root mean square gradient of each kind of parameter.
        sh_degree: of the result, 0 to 3.
        sh_degree_every: iterations between raising the degree by one from 0; 0 = all degrees from the start.
        warmup_half_resolution: share of the iterations, from the first on, at half the image size.
        near_m: nothing nearer is drawn.
        largest_scale_m: scales are cut here; 0 = no limit.
        cap: most Gaussians that densification may lead to.
        densify_every, densify_from, densify_until: iterations; ``densify_every`` 0 = fixed number.
        densify_gradient: mean screen gradient, in half image widths, above which a Gaussian is cloned or split.
        densify_scale: share of the scene extent above which it is split rather than cloned.
        prune_opacity: Gaussians fainter than that are removed when densifying.
        opacity_reset_every: iterations between resets to opacity 0.01 while densifying; 0 = never (U54).
    """

    iterations: int
    l1: float
    ssim: float
    density: float
    depth: float
    opacity_pull: float
    position_lr_start: float
    position_lr_end: float
    scale_lr: float
    rotation_lr: float
    opacity_lr: float
    sh_lr: float
    sh_rest_lr: float
    adam_epsilon: float
    sh_degree: int
    sh_degree_every: int
    warmup_half_resolution: float
    near_m: float
    largest_scale_m: float
    cap: int
    densify_every: int
    densify_from: int
    densify_until: int
    densify_gradient: float
    densify_scale: float
    prune_opacity: float
    opacity_reset_every: int


@dataclass(frozen=True)
class TrainedGaussians:
    """Attributes:
    gaussians: in the order of the initial ones (descendants beside each other); without densification the same N.
    source: (N,) index of the initial Gaussian each descends from: what labels such as provenance are carried over with.
    psnr_db: mean over the last tenth of the iterations, on the pixels that counted.
    refused: gradient entries that were not finite and were skipped.
    """

    gaussians: Gaussians
    source: np.ndarray
    psnr_db: float
    refused: int


def exponential(begin: float, end: float, done: float) -> float:
    """The schedule ``begin``^(1 − done) · ``end``^done, both raised to 1e-12 so that a rate of 0 is no logarithm of 0 (numerics O07)."""
    begin, end = max(begin, RATE_LEAST), max(end, RATE_LEAST)
    return float(begin * (end / begin) ** done)


def train(
    initial: Gaussians,
    targets: Sequence[Target],
    settings: TrainingSettings,
    rng: np.random.Generator,
    *,
    extent_m: float,
    span: tuple[int, int] | None = None,
    threads: int | None = None,
    label: str = "training",
) -> TrainedGaussians:
    """Gaussians fitted to the targets.

    ``extent_m`` (``targets.scene_extent``) scales position steps. ``span`` runs only those iterations of the schedule, for loops that
    change the targets in between (Adam's moments start anew). The same inputs, generator state and ``threads`` give the same bytes.
    Raises Refusal without Gaussians or targets.
    """
    if initial.count == 0 or not targets:
        raise Refusal(f"{label}: there are {initial.count} Gaussians and {len(targets)} images; training needs some of both")
    initial = initial.with_sh_degree(settings.sh_degree)
    if settings.largest_scale_m > 0:
        initial = replace(initial, log_scales=np.minimum(initial.log_scales, np.float32(np.log(settings.largest_scale_m))))
    run = _Run(state.start(initial), targets, settings, rng, extent_m, threads)
    first, last = span or (0, settings.iterations)
    say(f"{label}: {initial.count} Gaussians on {len(targets)} images, iterations {first} to {last}")
    began = told = time.perf_counter()
    losses, psnrs, telling = [], [0.0], max(1, (last - first) // 10)
    order = draws([target.share for target in targets], last - first, rng)
    for iteration, index in enumerate(progress(order, label, last - first), start=first):
        loss, psnr_db = run.step(iteration, index)
        losses.append(loss)
        psnrs.append(psnr_db)
        done = iteration + 1 - first
        if done % telling == 0:
            now = time.perf_counter()
            left = (now - began) / done * (last - first - done)
            say(
                f"{label}: {iteration + 1} of {settings.iterations}, {telling / (now - told):.0f} it/s,"
                f" loss {np.mean(losses[-telling:]):.4f}, PSNR {np.mean(psnrs[-telling:]):.2f} dB,"
                f" {run.state.blocked.count} Gaussians, {left:.0f} s left"
            )
            told = now
    back = np.argsort(run.state.source, kind="stable")
    if run.refused:
        say(f"{label}: {run.refused} gradient entries were not finite and were skipped")
    return TrainedGaussians(
        state.gaussians_of(run.state).take(back), run.state.source[back], float(np.mean(psnrs[-telling:])), run.refused
    )  # fmt: skip


class _Run:
    """One training run; ``step`` is the whole iteration."""

    def __init__(
        self, begin: TrainingState, targets: Sequence[Target], settings: TrainingSettings, rng: np.random.Generator, extent_m: float,
        threads: int | None,
    ) -> None:  # fmt: skip
        self.state, self.settings, self.rng, self.extent_m = begin, settings, rng, extent_m
        self.refused, self.steps = 0, 0
        self._rasteriser = Rasteriser(near_m=settings.near_m, threads=threads)
        self._targets = {False: list(targets), True: [None] * len(targets)}
        self._prepared: dict[tuple[bool, int], PreparedTarget] = {}
        self._losses: dict[tuple[int, int], tuple[Photometric, np.ndarray]] = {}
        self._statistics_bytes = 0
        self._squares, self._epsilons = np.zeros(ROWS), np.zeros(ROWS, np.float32)

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
            by_blocks = self._rasteriser.gather(gradient)
            self._adam(iteration, degree, by_blocks)
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
        rates = np.empty(ROWS, np.float32)
        rates[:SCALE] = self.extent_m * exponential(s.position_lr_start, s.position_lr_end, iteration / s.iterations)
        rates[SCALE:QUATERNION], rates[QUATERNION:OPACITY], rates[OPACITY] = s.scale_lr, s.rotation_lr, s.opacity_lr
        rates[SH : SH + 3], rates[SH + 3 :] = s.sh_lr, s.sh_rest_lr
        refused = np.empty(len(visible) // LANES, np.int32)
        f32 = np.float32
        step_blocks(
            self.state.blocked.parameters, self.state.raw, by_blocks, self.state.first, self.state.second, rates, self._epsilons,
            f32(BETA_1), f32(BETA_2), f32(1 - BETA_1**self.steps), f32(1 - BETA_2**self.steps), visible, SH + 3 * (degree + 1) ** 2,
            f32(s.opacity_pull / max(1, self._rasteriser.visible_count)),
            f32(np.log(s.largest_scale_m)) if s.largest_scale_m > 0 else f32(np.inf), refused,
        )  # fmt: skip
        self.refused += int(refused.sum())

    def _settle_epsilons(self, by_blocks: np.ndarray, visible: np.ndarray) -> None:
        """Per kind of parameter: ``adam_epsilon`` × root mean square gradient over the first steps."""
        shown = visible.reshape(-1, 1, LANES) != 0
        seen = np.where(shown, by_blocks.reshape(-1, ROWS, LANES), 0).astype(np.float64)
        self._squares += np.square(np.nan_to_num(seen)).sum(axis=(0, 2)) / max(1, int(shown.sum())) / EPSILON_STEPS
        for rows in (slice(0, SCALE), slice(SCALE, QUATERNION), slice(QUATERNION, OPACITY), slice(OPACITY, SH), slice(SH, ROWS)):
            typical = np.sqrt(self._squares[rows].max() * EPSILON_STEPS / self.steps)
            self._epsilons[rows] = max(self.settings.adam_epsilon * typical, EPSILON_LEAST)

    def _grow(self, iteration: int, width: int) -> None:
        s = self.settings
        done = iteration + 1
        if s.densify_every == 0 or done > s.densify_until:
            return
        before = self.state
        state.add_screen_gradient(
            self._rasteriser.visible, self._rasteriser.screen, np.float32(width / 2), before.gradient_sum, before.gradient_count
        )  # fmt: skip
        if done >= s.densify_from and done % s.densify_every == 0:
            mean = before.gradient_sum / np.maximum(before.gradient_count, 1)
            grown = growth.grow(
                state.gaussians_of(before), mean[: before.blocked.count], threshold=s.densify_gradient,
                large_m=s.densify_scale * self.extent_m, prune_opacity=s.prune_opacity, cap=s.cap, rng=self.rng,
            )  # fmt: skip
            self.state = state.regrown(before, grown.gaussians, grown.parent, grown.fresh)
        if s.opacity_reset_every > 0 and done % s.opacity_reset_every == 0:
            state.lower_opacities(self.state, 0.01)


BETA_1, BETA_2 = 0.9, 0.999
EPSILON_STEPS = 4
RATE_LEAST = 1e-12
EPSILON_LEAST = 1e-30
"""Keeps 0 / 0 away where a kind of parameter has had no gradient at all."""
