# SPDX-License-Identifier: Apache-2.0
"""A person's training on a GPU without one: tensors on the CPU, and on torch's meta device, which has no values to copy
to the host, with the float64 reference in gsplat's place, against the CPU's kernels."""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from studiorecon.body.avatar import tensor_posing
from studiorecon.body.avatar.avatar_files import read_avatar
from studiorecon.body.avatar.posing import Posing
from studiorecon.body.avatar.temporal import TemporalNetwork
from studiorecon.body.avatar.weight_grid import build_weight_grid
from studiorecon.body.model import BodyModel
from studiorecon.configuration import settings as settings_module
from studiorecon.geometry import rotations
from studiorecon.humans import tensor_person, train

from tests.made.gsplat_stand_in import rasterization
from tests.made.humans import Made, body, made  # noqa: F401
from tests.made.steps import call

OVER_TIME = {"use": "always", "start": 4, "width": 16, "points": 0, "bands": "all"}
LETTER: dict[str, Any] = {
    "skinning": "grid",
    "sh_degree": 2,
    "limit_sh_to_views": False,
    "pose_from": 0,
    "temporal": OVER_TIME,
    "losses": {"density": 0.1},
}


@pytest.fixture
def subjects(made: Made, default_settings: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable:
    """The person before the first step, by the CPU's kernels and by tensors on ``place``, and the loss's terms."""

    def begun(place: str = "cpu", function: Callable = rasterization, **replaced: object) -> tuple:
        section = copy.deepcopy(default_settings("humans", **({"iterations": 8, "gaussians": 300} | replaced)))
        section["rates"]["pose_rad"] = 1e-3
        settings = replace(settings_module.load(train.Settings, section, "humans"), grid_resolution=24)
        found: list = []
        monkeypatch.setattr(train, "resolve", lambda device: device)
        here = functools.partial(tensor_person.TensorPerson, place=place, function=function)
        monkeypatch.setattr(tensor_person, "TensorPerson", here)

        class Begun(Exception):
            pass

        def stop(subject: Any, terms: Any, *_: object, **__: object) -> None:
            found.extend([subject, terms])
            raise Begun

        with monkeypatch.context() as patch:
            patch.setattr(train, "train", stop)
            for device in ("cpu", "cuda"):
                files = tmp_path / f"{device}.ply", tmp_path / f"{device}.npz"
                with pytest.raises(Begun):
                    call(
                        train.run,
                        settings,
                        **made.options,
                        gaussians=files[0],
                        avatar=files[1],
                        working=tmp_path / device,
                        device=device,
                    )
        return found[0], found[2], found[1]

    return begun


def steps(subject: Any, terms: list, count: int) -> list[float]:
    losses = []
    for iteration in range(count):
        with subject.threads():
            subject.begin(iteration)
            view = subject.draw(iteration)
            losses.append(float(subject.step(iteration, view, view.total(terms))[0]))
    subject.finish()
    return losses


@pytest.mark.parametrize(
    "replaced",
    [
        pytest.param(LETTER, id="letter", marks=pytest.mark.slow),
        pytest.param({"pose_from": 0, "temporal": OVER_TIME | {"points": 40}}, id="ours"),
    ],
)
def test_tensors_learn_what_the_kernels_learn(subjects: Callable, replaced: dict) -> None:
    by_kernels, by_tensors, terms = subjects(**replaced)
    starts = {name: value.copy() for name, value in by_kernels._own.items()}
    wanted, found = steps(by_kernels, terms, 7), steps(by_tensors, terms, 7)
    np.testing.assert_allclose(found, wanted, rtol=1e-3)
    one, other = by_kernels.gaussians(), by_tensors.gaussians()
    moved = np.linalg.norm(one.means_m - starts["means"])
    assert moved > 0
    assert np.linalg.norm(other.means_m - one.means_m) < 0.05 * moved
    for motion in ("local", "trans_m"):
        np.testing.assert_allclose(getattr(by_tensors._motion, motion), getattr(by_kernels._motion, motion), atol=2e-4)
    nets = [subject._appearance.active_network.flat for subject in (by_kernels, by_tensors)]
    assert np.abs(nets[0]).max() > 0
    assert np.linalg.norm(nets[1] - nets[0]) < 1e-3 * np.linalg.norm(nets[0])


def valueless(
    means: torch.Tensor,
    quats: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colors: torch.Tensor,
    **more: Any,
) -> tuple[torch.Tensor, torch.Tensor, dict[str, torch.Tensor]]:
    """gsplat's shapes, and dependence on every parameter, on a device without values."""
    assert {value.device.type for value in (means, quats, scales, opacities, colors)} == {"meta"}
    centres = 1 * means[None, :, :2]
    total = sum(value.sum() for value in (centres, means, quats, scales, opacities, colors))
    picture = total + torch.zeros((1, more["height"], more["width"], 4), device="meta")
    return picture, picture[..., :1], {"means2d": centres, "radii": torch.ones((1, len(means), 2), device="meta")}


def test_no_step_brings_a_value_to_the_host(subjects: Callable) -> None:
    _, subject, terms = subjects("meta", valueless, **LETTER)
    subject._appearance._active = True
    for iteration in range(3):
        view = subject.draw(iteration)
        loss, psnr_db = subject.step(iteration, view, view.total(terms))
        assert loss.device.type == psnr_db.device.type == "meta"
    with pytest.raises(NotImplementedError, match="meta"):
        subject.finish()


@pytest.mark.slow
def test_a_killed_training_goes_on_with_its_own_state(subjects: Callable) -> None:
    _, whole, terms = subjects(**LETTER, densify={"use": "gradient", "every": 3, "gradient": 1e-7, "cap": 400})
    _, other, _ = subjects(**LETTER, densify={"use": "gradient", "every": 3, "gradient": 1e-7, "cap": 400})
    steps(whole, terms, 5)
    assert whole.gaussians().count > 300
    arrays, facts = whole.snapshot()
    other.resume({name: np.array(value) for name, value in arrays.items()}, facts)
    other._rng.bit_generator.state = whole._rng.bit_generator.state
    for subject in (whole, other):
        view = subject.draw(5)
        subject.step(5, view, view.total(terms))
        subject.finish()
    for name in ("means_m", "sh", "log_scales"):
        np.testing.assert_array_equal(getattr(whole.gaussians(), name), getattr(other.gaussians(), name))
    np.testing.assert_array_equal(whole._motion.local, other._motion.local)
    np.testing.assert_array_equal(whole._appearance.network.flat, other._appearance.network.flat)
    np.testing.assert_array_equal(whole.bones, other.bones)


def test_a_person_trained_on_tensors_is_written(
    made: Made, body: BodyModel, default_settings: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    section = copy.deepcopy(default_settings("humans", iterations=4, gaussians=200, temporal=OVER_TIME | {"start": 1}))
    settings = settings_module.load(train.Settings, section, "humans")
    monkeypatch.setattr(train, "resolve", lambda device: device)
    here = functools.partial(tensor_person.TensorPerson, place="cpu", function=rasterization)
    monkeypatch.setattr(tensor_person, "TensorPerson", here)
    files = tmp_path / "p3.ply", tmp_path / "p3.npz"
    call(
        train.run, settings, **made.options, gaussians=files[0], avatar=files[1], working=tmp_path / "w", device="cuda"
    )
    person = read_avatar(*files, body)
    assert person.network is not None
    assert np.abs(person.network.flat[-4:]).max() > 0


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_posing_agrees_with_the_kernels_even_where_a_blend_collapses(degree: int) -> None:
    rng = np.random.default_rng(degree)
    count, joints = 200, 24
    transforms = np.tile(np.eye(4), (joints, 1, 1))
    transforms[:, :3, :3] = rotations.exp(rng.normal(0, 1.0, (joints, 3)))
    transforms[:, :3, 3] = rng.normal(0, 1, (joints, 3))
    transforms[1, :3, :3], transforms[2, :3, :3] = np.eye(3), np.diag([1.0, -1, -1])
    weights = rng.dirichlet(np.full(joints, 0.05), count).astype(np.float32)
    weights[0] = 0
    weights[0, 1:3] = 0.5
    means, quaternions = (rng.normal(size=(count, k)).astype(np.float32) for k in (3, 4))
    sh = rng.normal(size=(count, (degree + 1) ** 2, 3)).astype(np.float32)
    bones = np.tile(np.arange(joints, dtype=np.uint8), (count, 1))
    wanted = Posing(bones, weights).out(means, quaternions, sh, transforms)
    arrays = (weights, transforms[:, :3].astype(np.float32), means, quaternions, sh)
    found = [part.numpy() for part in tensor_posing.pose_gaussians(*map(torch.as_tensor, arrays))]
    signs = np.sign((found[1] * wanted[1]).sum(1, keepdims=True))
    for one, other in zip((found[0], found[1] * signs, found[2]), wanted):
        assert np.quantile(np.abs(one - other), 0.99) < 1e-4
    np.testing.assert_allclose(found[0], wanted[0], atol=1e-5)


def test_the_network_agrees_with_numpy() -> None:
    rng = np.random.default_rng(0)
    network = TemporalNetwork.start(-np.ones(3), np.ones(3), 30, rng, 32)
    network.flat += 0.05 * rng.standard_normal(network.flat.shape).astype(np.float32)
    points = rng.uniform(-1, 1, (50, 3)).astype(np.float32)
    points[3, 0] = np.nan
    colour, logit = network.residuals(points, 7.5)
    found = tensor_posing.residuals(network, torch.as_tensor(network.flat), torch.as_tensor(points), 7.5).numpy()
    np.testing.assert_allclose(found, np.column_stack([colour, logit]), atol=2e-5)


def test_the_grid_is_asked_inside_and_beyond(body: BodyModel) -> None:
    rest = body.rest_vertices(np.zeros(10))
    grid = build_weight_grid(rest, body.weights, 12, 0.15)
    points = np.random.default_rng(0).uniform(rest.min() - 0.5, rest.max() + 0.5, (300, 3)).astype(np.float32)
    found = tensor_person._Grid(grid, "cpu").query(torch.as_tensor(points)).numpy()
    np.testing.assert_allclose(found, grid.query(points), atol=1e-5)
