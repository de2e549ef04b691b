# SPDX-License-Identifier: Apache-2.0
"""What tests of splatting gradients and their neighbours share."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians

from tests.made.gaussians import camera, hard, room

NEAR_M = 0.01


BACKGROUND = (0.2, 0.5, 0.7)


FIELDS = ("means_m", "quaternions", "log_scales", "logit_opacities", "sh")


Pictures = tuple[np.ndarray, np.ndarray, np.ndarray]


def reference(
    gaussians: Gaussians, view: Camera, by: np.ndarray, antialias: bool = False
) -> tuple[Pictures, dict[str, np.ndarray]]:
    """(rgb, alpha, expected depth) and the gradients of Σ by·(rgb, alpha, depth), all by float64 autograd."""
    import torch
    from studiorecon.splatting.reference import leaves, render

    parameters = leaves(gaussians)
    background = torch.tensor(BACKGROUND, dtype=torch.float64, requires_grad=True)
    rgb, alpha, depth_sum = render(parameters, view, background, NEAR_M, antialias)
    depth = torch.where(alpha > 1e-4, depth_sum / alpha.clamp_min(1e-9), torch.zeros_like(alpha))
    weights = torch.tensor(by, dtype=torch.float64)
    ((rgb * weights[..., :3]).sum() + (alpha * weights[..., 3]).sum() + (depth * weights[..., 4]).sum()).backward()
    gradients = {name: parameters[name].grad.numpy() for name in FIELDS} | {"background_rgb": background.grad.numpy()}
    return (rgb.detach().numpy(), alpha.detach().numpy(), depth.detach().numpy()), gradients


# The seeds are such that no pixel lies within rounding of the 1/255 threshold, where image and gradients jump.
SCENES = [
    pytest.param(room(1500, 5), camera(96, 56), id="room"),
    pytest.param(hard(600, 1), camera(96, 56), id="hard"),
    pytest.param(hard(900, 7), camera(160, 90), id="hard, not whole tiles"),
    pytest.param(room(777, 9).with_sh_degree(1), camera(83, 41, (11.3, -6.2)), id="odd size, off-centre, SH 1"),
    pytest.param(room(400, 2).with_sh_degree(0), camera(48, 48), id="SH 0"),
    pytest.param(room(400, 3).with_sh_degree(2), camera(48, 48), id="SH 2"),
]
