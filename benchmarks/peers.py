# SPDX-License-Identifier: Apache-2.0
"""gsplat's torch rasteriser, drawn from the same Gaussians as ours; never part of this project.

gsplat 1.5.3's torch reference is read from its unpacked wheel. As shipped it calls CUDA for the pairs of pixel and
Gaussian and nerfacc for the scan along a ray; both are replaced here, by numba and by one torch cumulative sum, which
favours it.
"""

from __future__ import annotations

import sys
import types
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numba import njit, prange
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.cpu.rasterise import Rasteriser

NEAR_M = 0.01
TILE = 16
"""Side of a tile of ``splatting.cpu``, pixels."""


def gsplat_reference(
    folder: Path, gaussians: Gaussians, camera: Camera, drawn: Rasteriser, by: np.ndarray
) -> Callable[[bool], np.ndarray]:
    """A call that draws with gsplat's torch functions, and with True also computes all gradients for ``by`` (5, H, W);
    returns RGB.

    ``drawn`` has just drawn the same Gaussians in the same order: its lists say which pairs contribute.
    """
    import torch

    sys.path.insert(0, str(folder))
    sys.modules.setdefault("nerfacc", types.ModuleType("nerfacc"))
    sys.modules["nerfacc"].render_weight_from_alpha = _weights  # type: ignore[attr-defined]
    sys.modules["nerfacc"].accumulate_along_rays = _sums  # type: ignore[attr-defined]
    from gsplat.cuda import _torch_impl as theirs

    height, width = camera.hw
    splats, lists = drawn._splats.reshape(-1, 16), (drawn._starts, drawn._pairs)
    fields = [
        gaussians.means_m,
        gaussians.quaternions,
        np.exp(gaussians.log_scales),
        1 / (1 + np.exp(-gaussians.logit_opacities)),
        gaussians.sh,
    ]
    leaves = [torch.tensor(value, requires_grad=True) for value in fields]
    viewmat, k, centre = (
        torch.tensor(m, dtype=torch.float32) for m in (camera.camera_from_world, camera.intrinsics, camera.centre_m)
    )
    weights = torch.tensor(by)

    def run(gradients: bool) -> np.ndarray:
        counts = np.zeros((height, width), np.int64)
        pairs_of(drawn._grid[0], splats, *lists, counts, np.zeros(0, np.int64), np.zeros(0, np.int64))
        ends = np.cumsum(counts)
        ids, pixels = np.empty(ends[-1], np.int64), np.empty(ends[-1], np.int64)
        pairs_of(drawn._grid[0], splats, *lists, (ends - counts.ravel()).reshape(height, width), ids, pixels)
        with torch.set_grad_enabled(gradients):
            means, quaternions, scales, opacities, sh = leaves
            covariances, _ = theirs._quat_scale_to_covar_preci(quaternions, scales, True, False)
            _, centres, depths, conics, _ = theirs._fully_fused_projection(
                means, covariances, viewmat[None], k[None], width, height, 0.3, NEAR_M
            )
            colours = torch.clamp_min(theirs._spherical_harmonics(3, means - centre, sh) + 0.5, 0.0)
            values = torch.cat([colours, depths[0][:, None]], dim=1)
            image, alpha = theirs.accumulate(
                centres[0],
                conics[0],
                opacities,
                values,
                torch.from_numpy(ids),
                torch.from_numpy(pixels),
                torch.zeros(len(ids), dtype=int),
                width,
                height,
            )
            if gradients:
                for leaf in leaves:
                    leaf.grad = None
                ((image * weights[:4].permute(1, 2, 0)).sum() - (alpha[..., 0] * weights[4]).sum()).backward()
        return image[..., :3].detach().numpy()

    run.leaves = leaves  # type: ignore[attr-defined]
    return run


def _weights(alphas, ray_indices, n_rays):
    """Weights and transmittances of pairs that are sorted by ray and depth: a product along each ray, as one sum of
    logarithms."""
    import torch

    logs = torch.log1p(-alphas.double())
    before = torch.cumsum(logs, 0) - logs
    first = torch.searchsorted(ray_indices, torch.arange(n_rays))
    trans = torch.exp(before - before[first.clamp_max(len(before) - 1)][ray_indices]).float()
    return alphas * trans, trans


def _sums(weights, values, ray_indices, n_rays):
    import torch

    shares = weights[:, None] if values is None else weights[:, None] * values
    return torch.zeros((n_rays, shares.shape[1])).index_add(0, ray_indices, shares)


@njit(parallel=True, cache=True)
def pairs_of(columns, splats, starts, pairs, places, ids, pixels):
    """Counts contributing pairs per pixel into ``places`` (H, W), or, with room in ``ids``, writes them from those
    places on."""
    height, width = places.shape
    fill = len(ids) > 0
    for y in prange(height):
        for x in range(width):
            tile, rest, found = y // TILE * columns + x // TILE, 1.0, 0
            for i in range(starts[tile], starts[tile + 1]):
                s = splats[pairs[i]]
                dy = y + 0.5 - s[1]
                u = x + 0.5 - s[0] - s[3] * dy
                power = s[5] - s[2] * u * u - s[4] * dy * dy
                if power < -7.9943534:
                    continue
                rest *= 1 - min(0.999, 2.0**power)
                if rest <= 1e-4:
                    break
                if fill:
                    ids[places[y, x] + found], pixels[places[y, x] + found] = pairs[i], y * width + x
                found += 1
            if not fill:
                places[y, x] = found
