# SPDX-License-Identifier: Apache-2.0
"""The CPU rasteriser as a torch function, for losses and networks whose gradients torch computes.

The function's backward pass is the kernels' own; torch only carries its results on.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.cpu.rasterise import Rasteriser

if TYPE_CHECKING:
    import torch


def rasterise(
    means_m: torch.Tensor,
    quaternions: torch.Tensor,
    log_scales: torch.Tensor,
    logit_opacities: torch.Tensor,
    sh: torch.Tensor,
    camera: Camera,
    background_rgb: torch.Tensor,
    *,
    near_m: float,
    threads: int | None = None,
    antialias: bool = False,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """rgb (H, W, 3), alpha (H, W) and expected depth (H, W) as float32 tensors on the CPU.

    The first five are the fields of ``Gaussians``; all and the background (3,) get gradients, in their own dtype and on
    their own device. Posed means and rotations are inputs like any other, so a body's pose is refined by what computes
    them. The kernels work in float32 whatever the inputs are; second derivatives do not exist.
    """
    rasteriser = Rasteriser(near_m=near_m, threads=threads, antialias=antialias)
    return _function().apply(rasteriser, camera, means_m, quaternions, log_scales, logit_opacities, sh, background_rgb)


def _function() -> type[torch.autograd.Function]:
    """Defined on first use, since its base class is torch's."""
    import torch

    class Rasterise(torch.autograd.Function):
        @staticmethod
        def forward(ctx, rasteriser, camera, *inputs):  # type: ignore[no-untyped-def]
            ctx.rasteriser, ctx.likes = rasteriser, [(x.dtype, x.device) for x in inputs]
            *gaussians, background = (x.detach().cpu().numpy() for x in inputs)
            picture = rasteriser.forward(Gaussians(*gaussians), camera, background)
            return tuple(torch.from_numpy(image) for image in (picture.rgb, picture.alpha, picture.depth_m))

        @staticmethod
        @torch.autograd.function.once_differentiable
        def backward(ctx, by_rgb, by_alpha, by_depth):  # type: ignore[no-untyped-def]
            g = ctx.rasteriser.backward(
                *(np.ascontiguousarray(by.numpy(), np.float32) for by in (by_rgb, by_alpha, by_depth))
            )
            arrays = (g.means_m, g.quaternions, g.log_scales, g.logit_opacities, g.sh, g.background_rgb)
            found = [
                torch.from_numpy(array).to(device=device, dtype=dtype)
                for array, (dtype, device) in zip(arrays, ctx.likes)
            ]
            return None, None, *found

    return Rasterise
