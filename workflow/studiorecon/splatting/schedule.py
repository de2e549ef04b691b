# SPDX-License-Identifier: Apache-2.0
"""What a configuration says about training, and the learning rates that follow from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from studiorecon.splatting.conventions import OPACITY, QUATERNION, ROWS, SCALE, SH
from studiorecon.splatting.perceptual import PerceptualSettings

RATE_LEAST = 1e-12


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
        densify: "none"; "gradient" clones and splits where the screen gradient is large (3DGS); "relocate" moves dead Gaussians onto
            live ones (3DGS-MCMC), which keeps the number.
        cap: most Gaussians that densification may lead to.
        densify_every, densify_from, densify_until: iterations at which that happens.
        densify_gradient: mean screen gradient, in half image widths, above which a Gaussian is cloned or split.
        densify_scale: share of the scene extent above which it is split rather than cloned.
        prune_opacity: Gaussians fainter than that are removed, or relocated, when densifying.
        relocate_growth: share by which relocation also raises the number each time, up to ``cap``.
        relocate_noise: strength of the random walk of faint Gaussians while relocating; 0 = none.
        opacity_reset_every: iterations between resets to opacity 0.01 while densifying; 0 = never (U54).
        lpips: the perceptual term.
        checkpoint_every_s: seconds between checkpoints; 0 = none.
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
    densify: Literal["none", "gradient", "relocate"]
    cap: int
    densify_every: int
    densify_from: int
    densify_until: int
    densify_gradient: float
    densify_scale: float
    prune_opacity: float
    opacity_reset_every: int
    relocate_growth: float
    relocate_noise: float
    checkpoint_every_s: float
    lpips: PerceptualSettings


def exponential(begin: float, end: float, done: float) -> float:
    """The schedule ``begin``^(1 − done) · ``end``^done, both raised to 1e-12 so that a rate of 0 is no logarithm of 0 (numerics O07)."""
    begin, end = max(begin, RATE_LEAST), max(end, RATE_LEAST)
    return float(begin * (end / begin) ** done)


def rates_at(settings: TrainingSettings, iteration: int, extent_m: float) -> np.ndarray:
    """(59,) float32 learning rate of every row of a parameter block; positions move in shares of the scene's extent (numerics O08)."""
    rates = np.empty(ROWS, np.float32)
    done = iteration / settings.iterations
    rates[:SCALE] = extent_m * exponential(settings.position_lr_start, settings.position_lr_end, done)
    rates[SCALE:QUATERNION], rates[QUATERNION:OPACITY], rates[OPACITY] = settings.scale_lr, settings.rotation_lr, settings.opacity_lr
    rates[SH : SH + 3], rates[SH + 3 :] = settings.sh_lr, settings.sh_rest_lr
    return rates
