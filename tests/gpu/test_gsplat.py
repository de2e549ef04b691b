# SPDX-License-Identifier: Apache-2.0
"""The gsplat back end's real kernels against the float64 reference, and its training loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("gsplat")
torch = pytest.importorskip("torch")
if not torch.cuda.is_available():
    pytest.skip("no CUDA device", allow_module_level=True)

from studiorecon.scene.camera import Camera  # noqa: E402
from studiorecon.scene.gaussians import Gaussians, concatenate  # noqa: E402
from studiorecon.splatting.cuda_training import train  # noqa: E402
from studiorecon.splatting.gsplat_rasteriser import GsplatRasteriser  # noqa: E402
from studiorecon.splatting.rasterise import Rasteriser  # noqa: E402
from studiorecon.splatting.targets import Target  # noqa: E402

from tests.foundations.splatting_scenes import camera, camera_on_ring, room  # noqa: E402
from tests.foundations.test_splatting_gradients import BACKGROUND, FIELDS, NEAR_M, SCENES, reference  # noqa: E402
from tests.foundations.test_splatting_training import SETTINGS  # noqa: E402
from tests.hard.test_splatting import DEGENERATE, POISON, assert_finite, one, run  # noqa: E402

pytestmark = pytest.mark.gpu
LIMIT = 1e-3


@pytest.mark.parametrize("antialias", [False, True])
@pytest.mark.parametrize(("gaussians", "view"), SCENES)
def test_images_and_gradients_agree_with_the_reference(gaussians: Gaussians, view: Camera, antialias: bool) -> None:
    by = np.random.default_rng(3).normal(size=(*view.hw, 5)).astype(np.float32)
    rasteriser = GsplatRasteriser(near_m=NEAR_M, antialias=antialias)
    rendering = rasteriser.forward(gaussians, view, BACKGROUND)
    gradients = rasteriser.backward(by[..., :3], by[..., 3], by[..., 4])
    pictures, expected = reference(gaussians, view, by, antialias)
    for found, wanted in zip((rendering.rgb, rendering.alpha), pictures[:2]):
        assert np.abs(found - wanted).mean() < LIMIT
    errors = {n: np.linalg.norm(getattr(gradients, n) - expected[n]) / np.linalg.norm(expected[n]) for n in FIELDS}
    assert max(errors.values()) < LIMIT, errors


@pytest.mark.parametrize("changes", [pytest.param(v, id=k) for k, v in {**POISON, **DEGENERATE}.items()])
def test_poisoned_and_degenerate_gaussians_do_no_harm(changes: dict) -> None:
    rendering, gradients, rasteriser = run(
        concatenate([room(300, 2), one(**changes)]), camera(97, 53), GsplatRasteriser(near_m=NEAR_M)
    )  # fmt: skip
    assert_finite(rendering, gradients)
    assert rasteriser.refused == (changes in POISON.values())


def test_training_learns() -> None:
    truth = room(5000, 3).with_sh_degree(1)
    rasteriser = Rasteriser(near_m=0.01)
    targets = [Target(v, rasteriser.forward(truth, v).rgb.clip(0, 1)) for v in (camera_on_ring(i, 8, 320, 176) for i in range(8))]
    begin = replace(truth, sh=np.zeros_like(truth.sh), logit_opacities=np.full(truth.count, -1.0))
    trained = train(begin, targets, replace(SETTINGS, iterations=500), np.random.default_rng(0), extent_m=1.0)
    assert trained.psnr_db > 25
    assert trained.refused == 0
