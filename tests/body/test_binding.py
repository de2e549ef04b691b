# SPDX-License-Identifier: Apache-2.0
"""Canonical Gaussians of unknown make are tied to the body: planted shapes come back, other poses and other things are
refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.body.avatar.binding import bind
from studiorecon.body.avatar.posing import Posing
from studiorecon.body.model import BodyModel
from studiorecon.errors import UserError
from studiorecon.scene.gaussians import Gaussians

BETAS = np.array([1.0, -0.8, 0.3, 0, 0, 0, 0, 0, 0, 0])
SHIFT_M = np.array([0.1, 0.6, -0.2])


@pytest.fixture(scope="module")
def body(root: Path) -> BodyModel:
    return BodyModel.load(root / "resources/body.npz")


def on(points_m: np.ndarray) -> Gaussians:
    n = len(points_m)
    return Gaussians(
        points_m, np.tile([1.0, 0, 0, 0], (n, 1)), np.full((n, 3), -4.6), np.full(n, 3.0), np.zeros((n, 16, 3))
    )


@pytest.fixture(scope="module")
def stranger(body: BodyModel) -> Gaussians:
    """Another method's person: every second vertex of a planted shape, somewhere, with harmonics of degree 3."""
    return on(body.rest_vertices(BETAS)[::2] + SHIFT_M)


def test_a_strangers_shape_place_and_weights_are_found(body: BodyModel, stranger: Gaussians) -> None:
    found = bind(stranger, body, "stranger.ply")
    rest_mm = 1000 * np.linalg.norm(body.rest_joints(found.betas) - body.rest_joints(BETAS), axis=1)
    # Joints are off by centimetres on the mean body: knees would bend in the thigh.
    assert (
        rest_mm.max()
        < 6
        < 1000 * np.linalg.norm(body.rest_joints(np.zeros(10)) - body.rest_joints(BETAS), axis=1).max()
    )
    assert found.gaussians.sh_degree == 2
    poses = np.random.default_rng(0).normal(0, 0.3, (1, 72))
    trans = np.zeros((1, 3))
    moved = body.joint_transforms(poses, found.betas, trans)[0]
    means = Posing(found.bones, found.weights).out(
        found.gaussians.means_m, found.gaussians.quaternions, found.gaussians.sh, moved
    )[0]
    off_mm = 1000 * np.linalg.norm(means - body.vertices(poses, BETAS, trans)[0, ::2], axis=1)
    assert np.median(off_mm) < 6
    assert np.percentile(off_mm, 99) < 25


def test_broken_gaussians_are_left_out(body: BodyModel, stranger: Gaussians) -> None:
    means = stranger.means_m.copy()
    means[5] = np.nan
    assert bind(replace(stranger, means_m=means), body, "stranger.ply").gaussians.count == stranger.count - 1


def test_what_is_no_person_in_the_rest_pose_is_refused_by_name(body: BodyModel, stranger: Gaussians) -> None:
    poses = np.zeros((1, 72))
    poses[0, [16 * 3 + 2, 17 * 3 + 2]] = -1.2, 1.2
    hanging = body.vertices(poses, BETAS, np.zeros((1, 3)))[0, ::2]
    with pytest.raises(UserError, match=r"hanging.ply is not in the rest pose: parts of a body .* are \d+ cm from any"):
        bind(on(hanging), body, "hanging.ply")
    with pytest.raises(UserError, match=r"back.ply faces backwards"):
        bind(replace(stranger, means_m=stranger.means_m * np.float32([-1, 1, -1])), body, "back.ply")
    with pytest.raises(UserError, match=r"cm.ply is 1\d\d\.\d\d high along y"):
        bind(replace(stranger, means_m=stranger.means_m * 100), body, "cm.ply")
    with pytest.raises(UserError, match=r"vase.ply has 100 solid Gaussians, too few for a person"):
        bind(stranger.take(np.arange(100)), body, "vase.ply")
    assert bind(stranger, body, "turned.ply").gaussians.count == stranger.count, "the canonical one is bound"
