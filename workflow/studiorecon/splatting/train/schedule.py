# SPDX-License-Identifier: Apache-2.0
"""Settings of training, and the learning rates that follow from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.splatting.conventions import OPACITY, QUATERNION, ROWS, SCALE, SH
from studiorecon.splatting.train.perceptual import PerceptualSettings

if TYPE_CHECKING:
    from jaxtyping import Float

RATE_MIN = 1e-12
BETA_1, BETA_2 = 0.9, 0.999
EPSILON_STEPS = 4
"""Steps whose gradients settle Adam's relative epsilons."""
EPSILON_MIN = 1e-30
"""Keeps 0 / 0 away where a kind of parameter has had no gradient at all."""


@dataclass(frozen=True)
class TrainingSettings:
    """The training part of a stage's configuration.

    Attributes:
        l1, ssim: weights of mean absolute error and of 1 − SSIM (U10, U11).
        position_lr_start, position_lr_end: exponential schedule, per metre of scene extent.
        scale_lr, rotation_lr, opacity_lr: steps of log scales, quaternions and logit opacities.
        sh_lr, sh_rest_lr: steps of the constant harmonic and of the others.
        adam_epsilon: relative to the first steps' root mean square gradient of each kind of parameter.
        near_m: nothing nearer is drawn.
        largest_scale_m: upper limit of scales; 0 = no limit.
        densify_every, densify_from, densify_until: iterations at which that happens.
        densify_gradient: mean screen gradient, in half image widths, above which a Gaussian is cloned or split.
        densify_scale: share of the scene extent above which it is split rather than cloned.
        prune_opacity: Gaussians below this opacity are removed when densifying.
        checkpoint_every_s: seconds between checkpoints, from which a killed training resumes with the same result; 0 =
            none.
    """

    iterations: int = setting(1500, "Steps of one picture each.", minimum=1, paper="7000, appendix C", paper_value=7000)
    l1: float = 0.7
    ssim: float = 0.3
    density: float = setting(
        0.0,
        "Pull of rendered alpha to 0 or 1.",
        minimum=0,
        paper="0.1, appendix C; U13",
        paper_value=0.1,
    )
    weighing: Literal["picture", "photometric"] = setting(
        "picture",
        "Terms with pixel and view weights: picture = L1, SSIM, alpha prior; photometric = L1, SSIM, LPIPS.",
        paper="Eq. 5; U15",
        paper_value="photometric",
    )
    position_lr_start: float = 0.00016
    position_lr_end: float = 1.6e-06
    scale_lr: float = 0.005
    rotation_lr: float = 0.001
    opacity_lr: float = 0.05
    sh_lr: float = 0.0025
    sh_rest_lr: float = 0.000125
    adam_epsilon: float = 1e-08
    sh_degree: int = setting(
        1,
        "Degree of spherical harmonics; diffuse rooms gain nothing beyond 1.",
        minimum=0,
        maximum=3,
        paper="3, appendix C",
        paper_value=3,
    )
    sh_degree_every: int = setting(
        0, "Steps between increases of the degree, from 0; 0 = full from the start.", minimum=0
    )
    warmup_half_resolution: float = setting(
        0.3, "Share of the steps at half the image size.", minimum=0, maximum=1, paper="none", paper_value=0.0
    )
    near_m: float = 0.1
    largest_scale_m: float = 0.5
    densify: Literal["none", "gradient"] = setting(
        "none",
        "none; gradient = clone and split where the picture is not yet explained.",
        paper="gradient, appendix C",
        paper_value="gradient",
    )
    cap: int = setting(
        300000,
        "Maximum number of Gaussians after densification; 0 = no limit.",
        minimum=0,
        paper="no limit, appendix C",
        paper_value=0,
    )
    densify_every: int = 500
    densify_from: int = 500
    densify_until: int = setting(
        3000, "Last step that densifies.", minimum=0, paper="3000, appendix C; U54", paper_value=3000
    )
    densify_gradient: float = 0.0002
    densify_scale: float = 0.01
    prune_opacity: float = 0.005
    checkpoint_every_s: float = 30.0
    lpips: PerceptualSettings = setting(PerceptualSettings(), "The perceptual term.")


def exponential(begin: float, end: float, done: float) -> float:
    """``begin``^(1 − done) · ``end``^done, both raised to at least 1e-12 so that a rate of 0 has a logarithm (O07)."""
    begin, end = max(begin, RATE_MIN), max(end, RATE_MIN)
    return float(begin * (end / begin) ** done)


def rates_at(settings: TrainingSettings, iteration: int, extent_m: float) -> Float[np.ndarray, " 59"]:
    """Float32 learning rate of every row of a parameter block; positions move in shares of the scene's extent (O08)."""
    rates = np.empty(ROWS, np.float32)
    done = iteration / settings.iterations
    rates[:SCALE] = extent_m * exponential(settings.position_lr_start, settings.position_lr_end, done)
    rates[SCALE:QUATERNION], rates[QUATERNION:OPACITY], rates[OPACITY] = (
        settings.scale_lr,
        settings.rotation_lr,
        settings.opacity_lr,
    )
    rates[SH : SH + 3], rates[SH + 3 :] = settings.sh_lr, settings.sh_rest_lr
    return rates


def degree_at(settings: TrainingSettings, iteration: int) -> int:
    """Degree of the harmonics that are drawn and moved at a step."""
    every = settings.sh_degree_every
    return settings.sh_degree if every == 0 else min(settings.sh_degree, iteration // every)


def is_half_size(settings: TrainingSettings, iteration: int) -> bool:
    """Whether a step runs at half the image size for warm-up."""
    return iteration < settings.warmup_half_resolution * settings.iterations
