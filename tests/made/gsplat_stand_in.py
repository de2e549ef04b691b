# SPDX-License-Identifier: Apache-2.0
"""``gsplat.rasterization`` as of version 1.5.3 in the eyes of its caller, computed by the float64 reference on a CPU.

The names, shapes and meanings of arguments and results are gsplat's, and what gsplat would assert is asserted here.
Written from its documentation; tests/gpu compares with the real kernels.
"""

from __future__ import annotations

from typing import Any

import torch
from studiorecon.scene.camera import Camera
from studiorecon.splatting.reference import blend, colours_towards, project


def rasterization(
    means: torch.Tensor,
    quats: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colors: torch.Tensor,
    viewmats: torch.Tensor,
    Ks: torch.Tensor,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    packed: bool = True,
    tile_size: int = 16,
    backgrounds: torch.Tensor | None = None,
    render_mode: str = "RGB",
    sparse_grad: bool = False,
    absgrad: bool = False,
    rasterize_mode: str = "classic",
) -> tuple[torch.Tensor, torch.Tensor, dict[str, Any]]:
    """(1, H, W, C) colours, (1, H, W, 1) alpha and the intermediate results."""
    n = len(means)
    assert means.shape == (n, 3)
    assert quats.shape == (n, 4)
    assert scales.shape == (n, 3)
    assert opacities.shape == (n,)
    assert viewmats.shape == (1, 4, 4)
    assert Ks.shape == (1, 3, 3)
    assert not packed, "means2d of packed results has another shape"
    assert render_mode in ("RGB", "RGB+D")
    assert abs(eps2d - 0.3) < 1e-6
    for value in (means, quats, scales, opacities, colors):
        assert torch.isfinite(value).all(), "gsplat does not guard itself against this"
    assert (quats.norm(dim=1) > 0).all(), "gsplat divides by the norm"
    camera = Camera("stand-in", (width, height), Ks[0].double().numpy(), viewmats[0].double().numpy())
    means, quats, scales, opacities, colors = (value.double() for value in (means, quats, scales, opacities, colors))
    splats = project(means, quats, scales, camera, near_plane)
    # As in gsplat, everything after the projection depends on means2d of shape (cameras, N, 2), whose gradient the
    # caller may keep.
    means2d = splats.centres[None]
    splats = type(splats)(means2d[0], splats.covariances, splats.compensation, splats.depth)
    if rasterize_mode == "antialiased":
        opacities = opacities * splats.compensation
    if sh_degree is not None:
        assert colors.ndim == 3
        assert colors.shape[1] >= (sh_degree + 1) ** 2
        colors = colours_towards(means, colors[:, : (sh_degree + 1) ** 2], camera)
    channels = colors.shape[1]
    drawn, alpha, depth_sum = blend(splats, opacities, colors, camera, near_plane)
    if backgrounds is not None:
        assert backgrounds.shape == (1, channels)
        drawn = drawn + (1 - alpha)[..., None] * backgrounds[0].double()
    if render_mode == "RGB+D":
        drawn = torch.cat([drawn, depth_sum[..., None]], -1)
    reach = torch.sqrt(2 * torch.log((opacities * 255).clamp_min(1)))
    radii = torch.stack([torch.ceil(reach * splats.covariances[:, i, i].sqrt()) for i in range(2)], -1)
    seen = (splats.depth > near_plane) & (opacities >= 1 / 255)
    for i, size in enumerate((width, height)):
        seen = seen & (splats.centres[:, i] + radii[:, i] > 0) & (splats.centres[:, i] - radii[:, i] < size)
    meta = {
        "means2d": means2d,
        "radii": torch.where(seen[:, None], radii, 0.0).int()[None],
        "depths": splats.depth[None],
    }
    return drawn.float()[None], alpha.float()[None, ..., None], meta
