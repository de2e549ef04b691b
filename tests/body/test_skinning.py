# SPDX-License-Identifier: Apache-2.0
"""Skinning where it breaks: points outside the grid, swapped axes, collapsed twists, half floats (rows L01–L08)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from studiorecon.body.avatar.posing import Posing
from studiorecon.body.avatar.weight_grid import WeightGrid, build_weight_grid, strongest_weights
from studiorecon.body.model import BodyModel

IDENTITY = np.float32([1, 0, 0, 0])


@pytest.fixture(scope="module")
def body(root: Path) -> BodyModel:
    return BodyModel.load(root / "resources" / "body.npz")


def thinnest(posing: Posing) -> np.ndarray:
    """(N,) what the last pose left of each Gaussian's surroundings along their thinnest axis."""
    return np.linalg.svd(posing.linear, compute_uv=False)[:, -1]


def twisted(angle_deg: float) -> tuple[Posing, np.ndarray]:
    """One Gaussian carried half by a resting bone, half by one turned about x."""
    transforms = np.tile(np.eye(4), (24, 1, 1))
    transforms[1, :3, :3] = Rotation.from_euler("x", angle_deg, degrees=True).as_matrix()
    return Posing(np.array([[0, 1]]), np.array([[0.5, 0.5]])), transforms


def pose_one(posing: Posing, transforms: np.ndarray, mean: np.ndarray) -> tuple[np.ndarray, ...]:
    return posing.out(np.float32([mean]), IDENTITY[None], np.zeros((1, 1, 3), np.float32), transforms)


@pytest.mark.parametrize("beyond", [1.0, 1.005, 1.02, 3.0], ids="L01-{}".format)
def test_a_point_outside_the_grid_moves_with_its_neighbour(beyond: float) -> None:
    # Zero padding on the exact box: weights sum to 0.5 / 0.34 / 0, and the point is pulled to the origin.
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
    weights = np.zeros((8, 24))
    weights[np.arange(8), np.where(corners[:, 0] > 0, 3, 5)] = 1
    found = build_weight_grid(corners, weights, 8, 0.15).query(np.array([[beyond * 1.3, 1.0, 1.0]]))
    assert found.sum() == pytest.approx(1, abs=1e-6)
    assert found[0, 3] > 0.85


@pytest.mark.parametrize("axis", [0, 1, 2], ids=["L02-x", "L03-y", "L03-z"])
def test_the_grid_reads_back_the_coordinates_it_was_built_from(axis: int) -> None:
    # A builder and a sampler that disagree on corners shift by 15 mm in a 2 m box; swapped axes read 0 instead of 1.
    resolution = 16
    spacing = 2.0 / (resolution - 1)
    nodes = np.stack(np.meshgrid(*[-1 + spacing * np.arange(resolution)] * 3, indexing="ij"), axis=-1)
    share = (nodes[..., axis] + 1) / 2
    grid = WeightGrid(np.full(3, -1.0), spacing, np.stack([share, 1 - share], axis=-1).astype(np.float32))
    points = np.random.default_rng(0).uniform(-1, 1, (200, 3))
    assert np.abs(2 * grid.query(points)[:, 0] - 1 - points[:, axis]).max() < 1e-4


@pytest.mark.parametrize(
    ("angle_deg", "left"),
    [(0.0, 1.0), (90.0, 0.7071), (150.0, 0.2588), (180.0, 0.0)],
    ids=["L04-0", "L04-90", "L04-150", "L04-180"],
)
def test_a_collapsing_twist_is_reported_and_still_turns_by_a_rotation(angle_deg: float, left: float) -> None:
    # The blend's determinant is 4e-33 at 180°: its polar factor does not exist, and inverting it gives noise.
    posing, transforms = twisted(angle_deg)
    means, quaternions, _ = pose_one(posing, transforms, np.array([0.1, 0.1, 0.0]))
    turn = posing.turn[0]
    assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(turn) == pytest.approx(1, abs=1e-9)
    assert np.isfinite(means).all()
    assert np.linalg.norm(quaternions) == pytest.approx(1, abs=1e-6)
    # The radius about the twist's axis shrinks to what is reported.
    assert thinnest(posing)[0] == pytest.approx(left, abs=1e-4)
    assert np.linalg.norm(means[0, 1:]) == pytest.approx(0.1 * left, abs=1e-5)


@pytest.mark.parametrize("angle_deg", [120.0, 170.0], ids="L05-{:g}".format)
def test_a_twist_keeps_the_axes_of_a_gaussian(angle_deg: float) -> None:
    # The blended matrix itself shrinks 10 mm axes to 5.0 and 0.87 mm.
    posing, transforms = twisted(angle_deg)
    pose_one(posing, transforms, np.zeros(3))
    axes_mm = np.linalg.norm(posing.turn[0] @ np.diag([10.0, 10.0, 10.0]), axis=0)
    assert np.allclose(axes_mm, 10, atol=1e-6)
    half = Rotation.from_euler("x", angle_deg / 2, degrees=True).as_matrix()
    assert np.allclose(posing.turn[0], half, atol=1e-6)


def test_l06_surface_weights_keep_the_legs_apart(body: BodyModel) -> None:
    """A 64³ voxel (3 cm) mixes 18.5 % of the other leg where they are 2 cm apart; the surface's own weights never
    do."""
    legs = {"left": [1, 4, 7, 10], "right": [2, 5, 8, 11]}
    rest = body.rest_vertices(np.zeros(10))
    shins = (rest[:, 1] < body.rest_joints(np.zeros(10))[4, 1]) & (np.abs(rest[:, 0]) < 0.4)
    own = body.weights[shins][:, legs["left"]].sum(1), body.weights[shins][:, legs["right"]].sum(1)
    other = np.where(rest[shins, 0] > 0, own[1], own[0])
    assert other.max() < 0.02
    # The canonical pose stands with its legs apart (U46), so that below the knee not even the grid mixes them.
    gridded = build_weight_grid(rest, body.weights, 64, 0.15).query(rest[shins])
    mixed = np.where(rest[shins, 0] > 0, gridded[:, legs["right"]].sum(1), gridded[:, legs["left"]].sum(1))
    assert mixed.max() < 0.02


def test_l07_kept_weights_sum_to_one_in_single_precision(body: BodyModel) -> None:
    """Half floats leave the sum off by 3.8e-4, which moves a point 5 m from the origin by 1.9 mm."""
    _, kept = strongest_weights(body.weights, 4)
    assert kept.dtype == np.float32
    assert np.abs(kept.astype(np.float64).sum(axis=1) - 1).max() < 1e-6


def test_l08_the_zero_pose_is_the_identity(body: BodyModel) -> None:
    """Joint transforms without the inverse bind double every offset."""
    bones, weights = strongest_weights(body.weights, 4)
    rest = body.rest_vertices(np.zeros(10)).astype(np.float32)
    pelvis = body.rest_joints(np.zeros(10))[:1]
    transforms = body.joint_transforms(np.zeros((1, 72)), np.zeros(10), pelvis)[0]
    quaternions = np.tile(IDENTITY, (len(rest), 1))
    means, turned, _ = Posing(bones, weights).out(
        rest, quaternions, np.zeros((len(rest), 1, 3), np.float32), transforms
    )
    assert np.abs(means - rest).max() < 1e-6
    assert np.abs(turned - quaternions).max() < 1e-6
