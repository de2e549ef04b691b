# SPDX-License-Identifier: Apache-2.0
"""What tests of splatting training and their neighbours share."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.train.targets import Target

from tests.made.gaussians import camera_on_ring, room

FIELDS = ("means_m", "quaternions", "log_scales", "logit_opacities", "sh")


@pytest.fixture(scope="module")
def lesson() -> tuple[Gaussians, list[Target]]:
    """A perturbed start and eight views of what it should become."""
    truth = room(1200, 3).with_sh_degree(1)
    rng = np.random.default_rng(4)
    rasteriser = Rasteriser(near_m=0.01, threads=1)
    views = [camera_on_ring(i, 8, 97, 53) for i in range(8)]
    targets = [Target(view, np.clip(rasteriser.forward(truth, view).rgb, 0, 1)) for view in views]
    begin = Gaussians(
        truth.means_m + rng.normal(0, 0.03, truth.means_m.shape).astype(np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (truth.count, 1)),
        np.repeat(truth.log_scales.mean(axis=1, keepdims=True) + 0.3, 3, axis=1),
        np.full(truth.count, -1.0),
        np.zeros_like(truth.sh),
    )
    return begin, targets


def psnr_db(gaussians: Gaussians, targets: list[Target]) -> float:
    rasteriser = Rasteriser(near_m=0.01, threads=1)
    errors = [
        ((rasteriser.forward(gaussians, t.camera, t.background_rgb).rgb.clip(0, 1) - t.rgb) ** 2).mean()
        for t in targets
    ]
    return float(-10 * np.log10(np.mean(errors)))
