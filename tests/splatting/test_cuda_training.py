# SPDX-License-Identifier: Apache-2.0
"""The CUDA training loop without a GPU: gsplat's function replaced by the float64 reference, against the CPU's loop."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from studiorecon.errors import UserError
from studiorecon.scene.gaussians import Gaussians, empty
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.cuda.tensor_set import TensorSet
from studiorecon.splatting.train.checkpoint import Checkpoint
from studiorecon.splatting.train.still import TrainedGaussians
from studiorecon.splatting.train.still import train_still as train_cpu
from studiorecon.splatting.train.targets import Target
from studiorecon.splatting.train.terms import WEIGHED, L1AndSsim, TensorView, Term

from tests.made.gaussians import camera_on_ring, room
from tests.made.splatting_settings import SETTINGS
from tests.made.splatting_training import FIELDS
from tests.made.training import plane_view, train_on_tensors


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """The reference's small tensors gain nothing from more, and a busy machine stalls on them."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def lesson() -> tuple[Gaussians, list[Target]]:
    truth = room(220, 3).with_sh_degree(1)
    rng, rasteriser = np.random.default_rng(4), Rasteriser(near_m=0.01, threads=1)
    targets = []
    for index in range(4):
        picture = rasteriser.forward(truth, camera_on_ring(index, 4, 48, 32))
        weight = np.ones((32, 48), np.float32)
        weight[:6, index * 5 : index * 5 + 9] = 0
        rgb = np.where(weight[..., None] > 0, picture.rgb.clip(0, 1), np.nan).astype(np.float32)
        targets.append(Target(camera_on_ring(index, 4, 48, 32), rgb, weight))
    begin = replace(
        truth,
        means_m=truth.means_m + rng.normal(0, 0.03, truth.means_m.shape).astype(np.float32),
        sh=np.zeros_like(truth.sh),
        logit_opacities=np.full(truth.count, -1.0),
    )
    return begin, targets


def trained_on_both(**changes: object) -> tuple[TrainedGaussians, TrainedGaussians]:
    begin, targets = lesson()
    settings = replace(SETTINGS, **{"iterations": 40, "warmup_half_resolution": 0.25, "sh_degree_every": 10, **changes})
    on_cpu = train_cpu(begin, targets, settings, np.random.default_rng(0), extent_m=1.0, threads=1)
    on_cuda = train_on_tensors(begin, targets, settings, np.random.default_rng(0), extent_m=1.0)
    return on_cpu, on_cuda


# Settings, and the decibels that 40 steps reach: without wall-sized Gaussians the room keeps gaps.
REGULARISERS = {"plain": ({}, 21.0), "density, scale limit": ({"density": 0.05, "largest_scale_m": 0.4}, 15.0)}


@pytest.mark.slow
@pytest.mark.parametrize(("changes", "reached_db"), list(REGULARISERS.values()), ids=list(REGULARISERS))
def test_both_loops_learn_the_same(changes: dict, reached_db: float) -> None:
    begin, _ = lesson()
    on_cpu, on_cuda = trained_on_both(**changes)
    assert on_cuda.psnr_db == pytest.approx(on_cpu.psnr_db, abs=0.02)
    assert on_cuda.psnr_db > reached_db
    for name in FIELDS:
        way = np.linalg.norm(getattr(on_cpu.gaussians, name) - getattr(begin, name))
        assert np.linalg.norm(getattr(on_cuda.gaussians, name) - getattr(on_cpu.gaussians, name)) < 0.06 * way, name
    np.testing.assert_array_equal(on_cuda.source, on_cpu.source)


def test_gradient_growth_chooses_the_gaussians_that_the_cpu_chooses() -> None:
    """Offsets of split halves are drawn in another order, so what is compared is who had descendants, and what was
    learnt."""
    control = {
        "iterations": 10,
        "densify": "gradient",
        "densify_every": 8,
        "densify_from": 8,
        "densify_until": 8,
        "densify_gradient": 1e-3,
        "densify_scale": 0.1,
        "cap": 400,
        "prune_opacity": 0.05,
        "warmup_half_resolution": 0.0,
    }
    on_cpu, on_cuda = trained_on_both(**control)
    assert on_cpu.gaussians.count > 260
    assert on_cuda.gaussians.count == pytest.approx(on_cpu.gaussians.count, rel=0.02)
    children = [np.bincount(trained.source, minlength=220) for trained in (on_cpu, on_cuda)]
    assert (children[0] > 1).sum() > 20
    assert np.mean(children[0] == children[1]) > 0.95
    assert on_cuda.psnr_db == pytest.approx(on_cpu.psnr_db, abs=1)


def test_a_run_taken_up_ends_with_the_same_bytes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    begin, targets = lesson()
    growing = {"densify": "gradient", "densify_every": 4, "densify_from": 4, "densify_until": 12, "cap": 260}
    settings = replace(SETTINGS, iterations=9, warmup_half_resolution=0.9, **growing)

    def run(checkpoint: Checkpoint | None) -> TrainedGaussians:
        return train_on_tensors(begin, targets, settings, np.random.default_rng(0), extent_m=1.0, checkpoint=checkpoint)

    whole, step, steps = run(None), TensorSet.step, []

    def watched(running: TensorSet, iteration: int, view: TensorView, loss: torch.Tensor) -> tuple[float, float]:
        steps.append(iteration)
        if len(steps) == 7:
            running.leaves["means_m"].data.fill_(7.0)  # half-done work must not be taken up
            raise KeyboardInterrupt
        return step(running, iteration, view, loss)

    monkeypatch.setattr(TensorSet, "step", watched)
    with pytest.raises(KeyboardInterrupt):
        run(Checkpoint(tmp_path / "state.npz", "mark", 1e-9))
    taken_up = run(Checkpoint(tmp_path / "state.npz", "mark", 1e-9))
    assert steps == [*range(7), *range(6, 9)], "it went on where the checkpoint was"
    for name in FIELDS:
        assert getattr(taken_up.gaussians, name).tobytes() == getattr(whole.gaussians, name).tobytes(), name
    assert taken_up.source.tobytes() == whole.source.tobytes()
    assert (taken_up.psnr_db, taken_up.refused) == (whole.psnr_db, whole.refused)


def test_a_poisoned_start_is_left_out_and_nothing_to_train_is_a_sentence() -> None:
    begin, targets = lesson()
    begin.means_m[7, 1] = np.nan
    settings = replace(SETTINGS, iterations=4)
    trained = train_on_tensors(begin, targets, settings, np.random.default_rng(0), extent_m=1.0)
    assert trained.left_out == 1
    assert 7 not in trained.source
    with pytest.raises(UserError, match="0 finite Gaussians and 4 images"):
        train_on_tensors(empty(1), targets, settings, np.random.default_rng(0), extent_m=1.0)


TERMS = {"L1 and SSIM": L1AndSsim(0.7, 0.3), **{name: make(0.2) for name, make in WEIGHED.items()}}


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("term", [pytest.param(v, id=k) for k, v in TERMS.items()])
def test_a_term_is_the_same_on_both_devices(term: Term, masked: bool) -> None:
    rng = np.random.default_rng(0)
    rgb, wanted = rng.random((2, 21, 35, 3), np.float32)
    alpha = rng.random((21, 35), np.float32)
    weight = rng.choice(np.float32([0, 0.5, 1]), (21, 35)) if masked else np.ones((21, 35), np.float32)
    planes = np.concatenate([rgb.transpose(2, 0, 1), 0 * alpha[None], 1 - alpha[None]])
    view = plane_view(planes, wanted, weight, silhouette=rng.random((21, 35)) < 0.5)
    view.alpha = alpha
    value = view.total([term])
    shown = [torch.tensor(x, requires_grad=True) for x in (rgb, alpha)]
    target = torch.as_tensor(wanted).permute(2, 0, 1), torch.as_tensor(weight)
    found = TensorView(view.target, 0, rng, *shown, *target, key=0).total([term])
    found.backward()
    assert float(found.detach()) == pytest.approx(value, rel=1e-5)
    for tensor, expected in zip(shown, (view.gradient[:3].transpose(1, 2, 0), view.gradient[4])):
        slope = np.zeros_like(expected) if tensor.grad is None else tensor.grad.numpy()
        assert np.linalg.norm(slope - expected) <= 2e-5 * np.linalg.norm(expected)
