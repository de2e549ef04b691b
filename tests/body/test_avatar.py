# SPDX-License-Identifier: Apache-2.0
"""Posing Gaussians, gradients through the skinning, and the avatar's files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from studiorecon.body.avatar.avatar_files import Avatar, read_avatar, write_avatar
from studiorecon.body.avatar.posing import Posing
from studiorecon.body.avatar.weight_grid import strongest_weights
from studiorecon.body.model import BodyModel, upright_global_orientation
from studiorecon.errors import UserError
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import write_npz
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.provenance import INFERRED, MEASURED

from tests.made.gaussians import rasterise


@pytest.fixture(scope="module")
def body(root: Path) -> BodyModel:
    return BodyModel.load(root / "resources" / "body.npz")


@pytest.fixture(scope="module")
def avatar(body: BodyModel) -> Avatar:
    rng = np.random.default_rng(0)
    chosen = np.arange(0, body.vertex_count, 60)
    n = len(chosen)
    gaussians = Gaussians(
        body.rest_vertices(np.zeros(10))[chosen],
        rng.normal(size=(n, 4)),
        np.log(rng.uniform(0.01, 0.03, (n, 3))),
        rng.normal(size=n),
        rng.normal(0, 0.3, (n, 9, 3)),
    )
    poses = rng.normal(0, 0.3, (3, 72))
    poses[:, :3] = upright_global_orientation(0.3)
    bones, weights = strongest_weights(body.weights[chosen], 4)
    provenance = np.where(np.arange(n) % 4, MEASURED, INFERRED).astype(np.uint8)
    trans = np.array([[0.0, 0, 0.9], [0.2, 0, 0.9], [0.4, 0.1, 0.9]])
    return Avatar(
        "p0", body, gaussians, bones, weights, provenance, poses, trans, np.zeros(10), np.ones(3, bool), 30.0, True
    )


def test_a_turned_room_shows_a_turned_avatar_unchanged(avatar: Avatar) -> None:
    """Posing by a rigid motion and looking from a camera that moved along is the same picture: means, axes and
    harmonics agree."""
    turn = np.eye(4)
    turn[:3, :3], turn[:3, 3] = Rotation.from_rotvec([0.7, -0.4, 1.9]).as_matrix(), [0.3, -0.2, 0.5]
    camera = Camera("c", (64, 64), np.array([[60.0, 0, 32], [0, 60, 32], [0, 0, 1]]), np.eye(4))
    camera = replace(
        camera, camera_from_world=np.block([[np.eye(3), np.array([[0], [-0.2], [2.5]])], [np.zeros((1, 3)), np.eye(1)]])
    )
    own = avatar.gaussians
    means, quaternions, sh = Posing(avatar.bones, avatar.weights).out(
        own.means_m, own.quaternions, own.sh, np.tile(turn, (24, 1, 1))
    )
    moved = Gaussians(means, quaternions, own.log_scales, own.logit_opacities, sh)
    along = replace(camera, camera_from_world=camera.camera_from_world @ np.linalg.inv(turn))
    before, after = (rasterise(g, c, near_m=0.05).rgb for g, c in ((own, camera), (moved, along)))
    assert before.std() > 0.02
    assert np.abs(before - after).max() < 2e-3


@pytest.mark.parametrize("name", ["means_m", "quaternions", "sh"])
def test_gradients_through_the_skinning_match_differences(avatar: Avatar, name: str) -> None:
    rng = np.random.default_rng(1)
    own = avatar.gaussians
    posing = Posing(avatar.bones, avatar.weights)
    transforms = avatar.model.joint_transforms(avatar.poses[:1], avatar.betas, avatar.trans[:1])[0]
    given = {
        "means_m": own.means_m.astype(float),
        "quaternions": own.quaternions.astype(float),
        "sh": own.sh.astype(float),
    }
    weights = [rng.normal(size=a.shape) for a in given.values()]
    posing.out(*given.values(), transforms)
    back = dict(zip(given, posing.back(*weights)))[name]
    direction = rng.normal(size=given[name].shape)
    values = []
    for step in (1e-4, -1e-4):
        posed = posing.out(*(given | {name: given[name] + step * direction}).values(), transforms)
        values.append(sum(float((w * p).sum()) for w, p in zip(weights, posed)))
    numeric = (values[0] - values[1]) / 2e-4
    assert numeric == pytest.approx(float((back * direction).sum()), rel=1e-6)


def test_an_avatar_reads_back_what_was_written(avatar: Avatar, tmp_path: Path) -> None:
    write_avatar(tmp_path / "p0.ply", tmp_path / "p0.npz", avatar)
    read = read_avatar(tmp_path / "p0.ply", tmp_path / "p0.npz", avatar.model)
    assert np.array_equal(read.gaussians.sh, avatar.gaussians.sh)
    assert np.array_equal(read.poses, avatar.poses)
    assert (read.person, read.fps, read.metric, read.seen_share) == ("p0", 30.0, True, avatar.seen_share)
    assert np.array_equal(read.posed(1.25).means_m, avatar.posed(1.25).means_m)


def test_halfway_every_joint_has_turned_half_way_and_the_ends_are_held(avatar: Avatar) -> None:
    pose, trans = avatar.pose_at(0.5)
    first, half, second = (Rotation.from_rotvec(p.reshape(24, 3)) for p in (avatar.poses[0], pose, avatar.poses[1]))
    whole = (first.inv() * second).magnitude()
    assert np.allclose((first.inv() * half).magnitude(), whole / 2, atol=1e-9)
    assert np.allclose((half.inv() * second).magnitude(), whole / 2, atol=1e-9)
    assert np.allclose(trans, [0.1, 0, 0.9])
    assert np.array_equal(avatar.posed(-3).means_m, avatar.posed(0).means_m)
    assert np.array_equal(avatar.posed(99).means_m, avatar.posed(2).means_m)


def test_files_that_disagree_are_refused(avatar: Avatar, tmp_path: Path) -> None:
    write_avatar(tmp_path / "a/p0.ply", tmp_path / "a/p0.npz", avatar)
    fewer = replace(
        avatar, gaussians=avatar.gaussians.take(np.arange(5)), bones=avatar.bones[:5], weights=avatar.weights[:5]
    )
    write_avatar(tmp_path / "b/p0.ply", tmp_path / "b/p0.npz", fewer)
    with pytest.raises(UserError, match=r"p0\.npz .*delete it"):
        read_avatar(tmp_path / "a/p0.ply", tmp_path / "b/p0.npz", avatar.model)
    with pytest.raises(UserError, match="use the same body file"):
        read_avatar(tmp_path / "a/p0.ply", tmp_path / "a/p0.npz", replace(avatar.model, identity="another body"))
    with pytest.raises(UserError, match=r"gone\.npz is missing"):
        read_avatar(tmp_path / "a/p0.ply", tmp_path / "gone.npz", avatar.model)


def test_a_person_who_is_away_is_not_drawn_and_infinitely_far(avatar: Avatar, tmp_path: Path) -> None:
    assert avatar.present.all(), "without a word, they are always there"
    left = replace(avatar, present=np.array([True, False, False]))
    assert [left.is_present(frame) for frame in (-3, 0, 0.5, 0.51, 1, 2, 99)] == [True] * 3 + [False] * 4
    gone = left.posed(1.0)
    assert gone.count == avatar.gaussians.count
    assert gone.logit_opacities.max() < -20
    assert np.isinf(left.joints_m(1.0)).all()
    assert np.array_equal(left.posed(0.5).means_m, avatar.posed(0.5).means_m)
    assert np.array_equal(left.joints_m(0.5), avatar.joints_m(0.5))
    camera = Camera("c", (64, 64), np.array([[60.0, 0, 32], [0, 60, 32], [0, 0, 1]]), np.eye(4))
    camera = replace(camera, camera_from_world=np.array([[1.0, 0, 0, 0], [0, 0, -1, 0.9], [0, 1, 0, 3], [0, 0, 0, 1]]))
    assert rasterise(avatar.posed(1.0), camera, near_m=0.05).alpha.max() > 0.1
    assert rasterise(gone, camera, near_m=0.05).alpha.max() == 0
    write_avatar(tmp_path / "p0.ply", tmp_path / "p0.npz", left)
    assert np.array_equal(read_avatar(tmp_path / "p0.ply", tmp_path / "p0.npz", left.model).present, left.present)


def test_a_file_that_does_not_say_when_somebody_is_there_is_refused(avatar: Avatar, tmp_path: Path) -> None:
    ply, npz = tmp_path / "p0.ply", tmp_path / "p0.npz"
    write_avatar(ply, npz, avatar)
    with np.load(npz) as data:
        write_npz(npz, {name: data[name] for name in data if name != "present"})
    with pytest.raises(UserError, match=r"p0\.npz .*no 'present'.*delete it"):
        read_avatar(ply, npz, avatar.model)
