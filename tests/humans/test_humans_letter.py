# SPDX-License-Identifier: Apache-2.0
"""A person's training to the paper's letter: weights of all bones where a Gaussian is, every joint, no addition."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.body.avatar.avatar_files import read_avatar
from studiorecon.body.avatar.encoding import encode_time, time_bands
from studiorecon.body.avatar.temporal import TemporalNetwork
from studiorecon.body.avatar.weight_grid import build_weight_grid
from studiorecon.body.model import BodyModel
from studiorecon.configuration import settings as settings_module
from studiorecon.humans import train
from studiorecon.humans.refined_motion import FIXED_JOINTS, RefinedMotion
from studiorecon.scene.provenance import INFERRED

from tests.made.humans import Made, body, made  # noqa: F401
from tests.made.steps import call

LETTER = {"background": "black", "unseen_colours": "trained", "pose_joints": "all", "edge_px": 0, "limit_scales": False}


@pytest.fixture
def trained(made: Made, body: BodyModel, default_settings: Callable, tmp_path: Path) -> Callable[..., tuple]:
    def run(**replaced: object) -> tuple:
        section = copy.deepcopy(default_settings("humans", **({"iterations": 40, "gaussians": 1500} | replaced)))
        section["rates"]["pose_rad"] = 1e-3
        # A coarser grid than that of films: building the weights of 24 bones is most of the time.
        settings = replace(settings_module.load(train.Settings, section, "humans"), grid_resolution=24)
        folder = tmp_path / "out"
        folder.mkdir(exist_ok=True)
        files = folder / "p3.ply", folder / "p3.npz"
        call(train.run, settings, **made.options, gaussians=files[0], avatar=files[1], working=folder / "working")
        return settings, read_avatar(*files, body)

    return run


def test_all_bones_of_the_grid_carry_a_gaussian_from_where_it_went(trained: Callable, body: BodyModel) -> None:
    settings, person = trained(skinning="grid", placement="vertices")
    rest = body.rest_vertices(person.betas)
    grid = build_weight_grid(rest, body.weights, settings.grid_resolution, settings.grid_margin)
    assert person.bones.shape == person.weights.shape == (person.gaussians.count, 24)
    # Naive, asked once at the start: the weights are those of the vertices.
    np.testing.assert_array_equal(person.weights, grid.query(person.gaussians.means_m))
    started = np.unique(body.faces[body.region[body.faces[:, 0]] != body.region_names.index("inside")])
    assert np.abs(person.weights - grid.query(rest[started])).max() > 1e-3


def test_feet_head_and_hands_move_with_the_letter_alone(body: BodyModel) -> None:
    moved = []
    for held in (FIXED_JOINTS, ()):
        motion = RefinedMotion(np.zeros((1, 72)), np.zeros((1, 3)), body.rest_joints(np.zeros(10)), body.parents, held)
        motion.step(0, np.ones((25, 3)), 1e-2)
        moved.append(np.linalg.norm(motion.poses.reshape(24, 3), axis=1) > 0)
    assert np.flatnonzero(~moved[0]).tolist() == [joint for joint in FIXED_JOINTS if joint < 24]
    assert moved[1].all()


def test_without_additions_what_no_camera_saw_is_trained_and_changes_over_time(trained: Callable) -> None:
    over_time = {"use": "always", "start": 10, "width": 16, "points": 0, "bands": "all"}
    _, filled = trained(temporal=over_time | {"bands": "below_nyquist"})
    settings, person = trained(temporal=over_time, additions=LETTER)
    assert settings.additions.unseen_colours == "trained"
    for one, move_unseen in ((filled, False), (person, True)):
        hidden = one.provenance == INFERRED
        assert hidden.any()
        first, last = (one.appearance_at(frame)[0][hidden, 0] for frame in (0, one.frames - 1))
        assert (np.abs(first - last).max() > 0) == move_unseen
        assert one.network.use_all_bands == one.network.move_unseen == move_unseen


def test_black_or_another_colour_at_every_step_stands_behind(
    trained: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen, grey = [], [0.5, 0.5, 0.5]
    original = train.PersonInTraining.draw.__globals__["training_target"]
    monkeypatch.setitem(
        train.PersonInTraining.draw.__globals__,
        "training_target",
        # Previews are over grey.
        lambda crop, behind: seen.append(behind.tolist()) or original(crop, behind),
    )
    trained(additions=LETTER, iterations=5)
    assert [behind for behind in seen if behind != grey] == [[0.0, 0.0, 0.0]] * 5
    seen.clear()
    trained(iterations=5)
    assert len({tuple(behind) for behind in seen if behind != grey}) == 5


def test_the_papers_network_gets_every_band_of_time() -> None:
    assert time_bands(30) < 10
    some, every = encode_time(7, 30), encode_time(7, 30, use_all_bands=True)
    assert np.count_nonzero(some) < np.count_nonzero(every) == 21
    network = TemporalNetwork.start(
        -np.ones(3), np.ones(3), 30, np.random.default_rng(0), 8, use_all_bands=True, move_unseen=True
    )
    again = TemporalNetwork.from_arrays(network.to_arrays())
    assert (again.use_all_bands, again.move_unseen) == (True, True)
    plain = TemporalNetwork.start(-np.ones(3), np.ones(3), 30, np.random.default_rng(0), 8)
    assert not {"use_all_bands", "move_unseen"} & set(plain.to_arrays())
