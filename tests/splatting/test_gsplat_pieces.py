# SPDX-License-Identifier: Apache-2.0
"""The slow float64 truth against gsplat's own torch pieces, where gsplat can be imported; no GPU is needed.

gsplat is no dependency of a CPU. To run this without installing it, put its unpacked wheel on the path:

    pip download --no-deps gsplat==1.5.3 && python -m zipfile -e gsplat-1.5.3-*.whl DIR
    PYTHONPATH=DIR pytest tests/splatting/test_gsplat_pieces.py
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.conventions import DILATION_PX2
from studiorecon.splatting.reference import colours_towards, leaves, project

from tests.made.gaussians import camera, hard, room

pytest.importorskip("gsplat", reason="gsplat is not installed: its torch pieces cannot be compared with the reference")

SCENES = [
    pytest.param(room(800, 5), camera(96, 56), id="room"),
    pytest.param(room(800, 6), camera(96, 56, (9.0, -6.0)), id="shifted principal point"),
    pytest.param(hard(600, 1), camera(96, 56), id="hard"),
]


def relative(found: torch.Tensor, wanted: torch.Tensor) -> float:
    """Largest difference over the largest value."""
    return float(((found - wanted).abs().max() / wanted.abs().max()).detach())


@pytest.mark.parametrize(("gaussians", "view"), SCENES)
def test_projection_covariance_compensation_and_its_gradients_are_gsplats(gaussians: Gaussians, view: Camera) -> None:
    from gsplat.cuda._torch_impl import _fully_fused_projection, _quat_scale_to_covar_preci

    near_m = 0.2
    ours, theirs = leaves(gaussians), leaves(gaussians)
    splats = project(ours["means_m"], ours["quaternions"], torch.exp(ours["log_scales"]), view, near_m)
    covariances, _ = _quat_scale_to_covar_preci(theirs["quaternions"], torch.exp(theirs["log_scales"]), True, False)
    matrices = (torch.as_tensor(m, dtype=torch.float64)[None] for m in (view.camera_from_world, view.intrinsics))
    radii, centres, depths, conics, compensation = _fully_fused_projection(
        theirs["means_m"], covariances, *matrices, *view.wh, float(DILATION_PX2), near_m, calc_compensations=True
    )
    seen = (radii[0] > 0).all(dim=1)
    assert seen.sum() > 100
    assert (splats.depth[seen] > near_m).all()
    inverse = torch.linalg.inv(splats.covariances)[seen]
    pairs = [
        (splats.centres[seen], centres[0][seen]),
        (splats.depth[seen], depths[0][seen]),
        (torch.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], -1), conics[0][seen]),
        (splats.compensation[seen], compensation[0][seen]),
    ]
    # Of needles gsplat's determinants, differences of products, keep fewer of float64's digits than our sums of
    # squares.
    for (found, wanted), limit in zip(pairs, (1e-12, 1e-12, 1e-7, 1e-6), strict=True):
        assert relative(found, wanted) < limit
    weights = [torch.as_tensor(np.random.default_rng(0).normal(size=tuple(found.shape))) for found, _ in pairs[:3]]
    for index in (0, 1):
        sum((pair[index] * w).sum() for pair, w in zip(pairs[:3], weights, strict=True)).backward()
    for name in ("means_m", "quaternions", "log_scales"):
        assert relative(ours[name].grad, theirs[name].grad) < 1e-7, name


@pytest.mark.parametrize(("gaussians", "view"), SCENES)
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_harmonics_are_gsplats(gaussians: Gaussians, view: Camera, degree: int) -> None:
    from gsplat.cuda._torch_impl import _spherical_harmonics

    values = leaves(gaussians.with_sh_degree(degree))
    found = colours_towards(values["means_m"], values["sh"], view)
    theirs = _spherical_harmonics(degree, values["means_m"] - torch.as_tensor(view.centre_m), values["sh"])
    # The caller adds the half and cuts at 0, in gsplat.rasterization.
    assert relative(found, (theirs + 0.5).clamp_min(0)) < 1e-6
