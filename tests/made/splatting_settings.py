# SPDX-License-Identifier: Apache-2.0
"""How tests and benches train a few Gaussians; without pytest, whose import would count where a start is timed."""

from __future__ import annotations

from studiorecon.splatting.train.perceptual import PerceptualSettings
from studiorecon.splatting.train.schedule import TrainingSettings

SETTINGS = TrainingSettings(
    iterations=200,
    l1=0.7,
    ssim=0.3,
    density=0.0,
    position_lr_start=1.6e-4,
    position_lr_end=1.6e-6,
    scale_lr=5e-3,
    rotation_lr=1e-3,
    opacity_lr=5e-2,
    sh_lr=2.5e-3,
    sh_rest_lr=1.25e-4,
    adam_epsilon=1e-6,
    sh_degree=1,
    sh_degree_every=0,
    warmup_half_resolution=0.3,
    near_m=0.01,
    largest_scale_m=0.0,
    densify="none",
    cap=3000,
    densify_every=50,
    densify_from=50,
    densify_until=200,
    densify_gradient=2e-4,
    densify_scale=0.01,
    prune_opacity=0.01,
    checkpoint_every_s=0.0,
    lpips=PerceptualSettings(weight=0.0, whole=True),
)
