# SPDX-License-Identifier: Apache-2.0
"""The gsplat back end's real kernels against the float64 reference, and its training loop."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("gsplat")
torch = pytest.importorskip("torch")
if not torch.cuda.is_available():
    pytest.skip("no CUDA device", allow_module_level=True)

from studiorecon.scene.camera import Camera  # noqa: E402
from studiorecon.scene.gaussians import Gaussians, concatenate  # noqa: E402
from studiorecon.splatting.cpu.rasterise import Rasteriser  # noqa: E402
from studiorecon.splatting.cuda.rasterise import GsplatRasteriser  # noqa: E402
from studiorecon.splatting.cuda.tensor_set import TensorSet  # noqa: E402
from studiorecon.splatting.train.checkpoint import Checkpoint  # noqa: E402
from studiorecon.splatting.train.still import TrainedGaussians, train_still  # noqa: E402
from studiorecon.splatting.train.targets import Target  # noqa: E402
from studiorecon.splatting.train.terms import L1AndSsim, TensorView  # noqa: E402

from tests.made.gaussians import camera, camera_on_ring, room  # noqa: E402
from tests.made.splatting_gradients import BACKGROUND, FIELDS, NEAR_M, SCENES, reference  # noqa: E402
from tests.made.splatting_limits import DEGENERATE, POISON, assert_finite, one, run  # noqa: E402
from tests.made.splatting_settings import SETTINGS  # noqa: E402
from tests.made.training import plane_view  # noqa: E402

pytestmark = pytest.mark.gpu
LIMIT, HARD_LIMIT = 1e-3, 0.05


@pytest.mark.parametrize("antialias", [False, True])
@pytest.mark.parametrize(("gaussians", "view"), SCENES)
def test_images_and_gradients_agree_with_the_reference(
    gaussians: Gaussians, view: Camera, antialias: bool, request: pytest.FixtureRequest
) -> None:
    by = np.random.default_rng(3).normal(size=(*view.hw, 5)).astype(np.float32)
    rasteriser = GsplatRasteriser(near_m=NEAR_M, antialias=antialias)
    rendering = rasteriser.forward(gaussians, view, BACKGROUND)
    gradients = rasteriser.backward(by[..., :3], by[..., 3], by[..., 4])
    pictures, expected = reference(gaussians, view, by, antialias)
    for found, wanted in zip((rendering.rgb, rendering.alpha), pictures[:2]):
        assert np.abs(found - wanted).mean() < LIMIT
    errors = {n: np.linalg.norm(getattr(gradients, n) - expected[n]) / np.linalg.norm(expected[n]) for n in FIELDS}
    # gsplat's kernels are compiled with fast arithmetic: needles and what grazes the near plane lose digits there.
    assert max(errors.values()) < (HARD_LIMIT if "hard" in request.node.name else LIMIT), errors


def test_flat_places_are_compared_in_all_bits_of_float32() -> None:
    # A GPU's convolution may take TF32, whose ten bits drown the variance of a wall under its mean's square.
    rng = np.random.default_rng(0)
    wanted = (0.7 + 0.01 * rng.random((96, 160, 3))).astype(np.float32)
    rgb = (wanted + 0.005 * rng.standard_normal(wanted.shape)).astype(np.float32)
    empty = np.zeros((2, *rgb.shape[:2]), np.float32)
    seen = plane_view(np.concatenate([rgb.transpose(2, 0, 1), empty]), wanted, np.ones(rgb.shape[:2], np.float32))
    loss = seen.total([L1AndSsim(0.0, 1.0)])
    shown, target = (torch.as_tensor(a, device="cuda") for a in (rgb, wanted.transpose(2, 0, 1).copy()))
    shown.requires_grad_()
    nothing = torch.zeros(rgb.shape[:2], device="cuda")
    found = TensorView(seen.target, 0, rng, shown, nothing, target, nothing + 1, 0)
    by_gpu = found.total([L1AndSsim(0.0, 1.0)])
    by_gpu.backward()
    assert shown.grad is not None
    assert float(by_gpu.detach()) == pytest.approx(loss, rel=1e-4)
    expected = seen.gradient[:3].transpose(1, 2, 0)
    assert np.linalg.norm(shown.grad.cpu().numpy() - expected) < 1e-3 * np.linalg.norm(expected)


@pytest.mark.parametrize("case", [*POISON, *DEGENERATE])
def test_poisoned_and_degenerate_gaussians_do_no_harm(case: str) -> None:
    changes = {**POISON, **DEGENERATE}[case]
    rendering, gradients, rasteriser = run(
        concatenate([room(300, 2), one(**changes)]), camera(97, 53), GsplatRasteriser(near_m=NEAR_M)
    )
    assert_finite(rendering, gradients)
    # A blob of a thousand kilometres reaches more pixels than gsplat's tiles can count; the CPU's kernels draw it.
    assert rasteriser.refused == (case in POISON or case == "scale 1e6")


def lesson() -> tuple[Gaussians, list[Target]]:
    truth = room(5000, 3).with_sh_degree(1)
    rasteriser = Rasteriser(near_m=0.01)
    targets = [
        Target(v, rasteriser.forward(truth, v).rgb.clip(0, 1))
        for v in (camera_on_ring(i, 8, 320, 176) for i in range(8))
    ]
    begin = replace(truth, sh=np.zeros_like(truth.sh), logit_opacities=np.full(truth.count, -1.0))
    return begin, targets


def test_training_learns() -> None:
    begin, targets = lesson()
    trained = train_still(
        begin, targets, replace(SETTINGS, iterations=500), np.random.default_rng(0), extent_m=1.0, device="cuda"
    )
    assert trained.psnr_db > 25
    assert trained.refused == 0


@pytest.mark.parametrize("kind", [torch.float16, torch.bfloat16], ids=str)
def test_mixed_precision_around_the_loop_stays_finite_and_learns_the_same(kind: torch.dtype) -> None:
    begin, targets = lesson()
    settings = replace(SETTINGS, iterations=100)
    plain = train_still(begin, targets, settings, np.random.default_rng(0), extent_m=1.0, device="cuda")
    with torch.autocast("cuda", kind):
        mixed = train_still(begin, targets, settings, np.random.default_rng(0), extent_m=1.0, device="cuda")
    assert mixed.refused == mixed.left_out == 0
    assert mixed.psnr_db == pytest.approx(plain.psnr_db, abs=0.1)


def test_density_control_adds_as_many_as_on_the_cpu() -> None:
    begin, targets = lesson()
    settings = replace(
        SETTINGS,
        iterations=120,
        densify="gradient",
        densify_every=50,
        densify_from=50,
        densify_until=100,
        cap=9000,
        prune_opacity=0.05,
    )
    found = train_still(begin, targets, settings, np.random.default_rng(0), extent_m=1.0, device="cuda")
    wanted = train_still(begin, targets, settings, np.random.default_rng(0), extent_m=1.0)
    assert found.gaussians.count == pytest.approx(wanted.gaussians.count, rel=0.03)
    assert found.psnr_db == pytest.approx(wanted.psnr_db, abs=1.5), "offsets of split halves are drawn in another order"


def test_a_killed_training_taken_up_learns_what_an_uninterrupted_one_does(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    begin, targets = lesson()
    settings, step, done = replace(SETTINGS, iterations=100), TensorSet.step, []

    def run(checkpoint: Checkpoint | None) -> TrainedGaussians:
        return train_still(
            begin, targets, settings, np.random.default_rng(0), extent_m=1.0, checkpoint=checkpoint, device="cuda"
        )

    def dying(running: TensorSet, iteration: int, view: TensorView, loss: torch.Tensor) -> tuple[float, float]:
        done.append(iteration)
        if len(done) == 60:
            raise KeyboardInterrupt
        return step(running, iteration, view, loss)

    whole = run(None)
    monkeypatch.setattr(TensorSet, "step", dying)
    with pytest.raises(KeyboardInterrupt):
        run(Checkpoint(tmp_path / "state.npz", "mark", 1e-9))
    taken_up = run(Checkpoint(tmp_path / "state.npz", "mark", 1e-9))
    assert done[60] == 59
    assert taken_up.psnr_db == pytest.approx(whole.psnr_db, abs=0.1)
