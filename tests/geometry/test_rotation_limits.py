# SPDX-License-Identifier: Apache-2.0
"""Rows R and F of the table of hard cases: rotations at their singular angles, and smoothing on SO(3)."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from studiorecon.geometry import rotations, smoothing
from studiorecon.geometry.camera_path import look_at


def about_z(degrees: float | np.ndarray) -> np.ndarray:
    return rotations.exp(np.deg2rad(np.asarray(degrees, dtype=float))[..., None] * np.array([0, 0, 1.0]))


def angle_z_deg(rotation: np.ndarray) -> np.ndarray:
    return np.rad2deg(np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0]))


def test_r01_slerp_of_equal() -> None:
    # Naive: sin 0 / sin 0, NaN.
    q = rotations.exp([0.3, -0.2, 0.9])
    np.testing.assert_allclose(rotations.slerp(q, q, 0.37), q, atol=1e-12)


def test_r02_slerp_of_rounded_rotations() -> None:
    # Naive: q·q > 1 in 20 % of float32 quaternions, arccos NaN.
    rounded = Rotation.random(2000, random_state=0).as_matrix().astype(np.float32)
    middle = rotations.slerp(rounded, rounded, np.full(2000, 0.5))
    np.testing.assert_allclose(middle, rounded, atol=1e-6)
    unit = Rotation.random(2000, random_state=0).as_quat().astype(np.float32)
    assert ((unit * unit).sum(-1) > 1).mean() > 0.05
    exact = rotations.from_quaternion(unit)
    np.testing.assert_allclose(rotations.slerp(exact, exact, np.full(2000, 0.5)), exact, atol=1e-12)


def test_r03_slerp_of_opposite_quaternions() -> None:
    # Naive: q and −q cancel, norm 0. Matrices do not know the sign; quaternions enter through from_quaternion.
    q = np.array([0.5, 0.5, -0.5, 0.5])
    np.testing.assert_allclose(
        rotations.slerp(rotations.from_quaternion(q), rotations.from_quaternion(-q), 0.5), rotations.from_quaternion(q)
    )


def test_r04_slerp_takes_the_short_way() -> None:
    # Naive: 0° and 60° given as −q has its middle at −150°.
    assert angle_z_deg(rotations.slerp(about_z(0), about_z(60), 0.5)) == pytest.approx(30, abs=1e-10)


def test_r05_slerp_of_half_a_turn_is_deterministic() -> None:
    # Naive: −90° or +90° by the sign of the noise.
    middles = [
        angle_z_deg(rotations.slerp(about_z(0), about_z(180 + np.rad2deg(noise)), 0.5)) for noise in (-1e-9, 0.0, 1e-9)
    ]
    np.testing.assert_allclose(middles, 90, atol=1e-6)
    # Half a turn about a horizontal axis has no way about up; it is deterministic all the same.
    level = [rotations.slerp(np.eye(3), rotations.exp([np.pi + noise, 0, 0]), 0.5) for noise in (-1e-9, 1e-9)]
    np.testing.assert_allclose(level[0], level[1], atol=1e-6)


def test_r06_slerp_of_tiny_angles() -> None:
    # Naive float32 at 3e-4 rad: 2.3 % off.
    for tiny in (1e-3, 3e-4, 1e-9, 0.0):
        assert rotations.angle(
            np.eye(3), rotations.slerp(np.eye(3), rotations.exp([tiny, 0, 0]), 0.5)
        ) == pytest.approx(tiny / 2, rel=1e-6)


def test_r09_exp_at_zero_and_its_generators() -> None:
    # Naive: θ in the denominator, NaN.
    np.testing.assert_array_equal(rotations.exp(np.zeros(3)), np.eye(3))
    for axis in np.eye(3):
        generator = (rotations.exp(1e-7 * axis) - rotations.exp(-1e-7 * axis)) / 2e-7
        np.testing.assert_allclose(generator, rotations.cross_matrix(axis), atol=1e-9)


def test_r10_exp_keeps_the_second_order_term() -> None:
    # Naive: (1 − cos θ)/θ² is 0.477 at 1e-3 and 0 at 1e-4 in float32.
    for angle in (1e-3, 3e-4, 1e-4, 1e-6, 1e-9):
        x, y, _ = axis_angle = angle * np.array([0.6, 0.8, 0.0])
        assert rotations.exp(axis_angle)[0, 1] / (x * y) == pytest.approx(0.5, rel=1e-6)


def test_r11_log_of_small_float32_rotations() -> None:
    # Naive arccos: 0 at 3e-4 in float32, NaN for 0.3 % of RᵀR.
    rotation = rotations.exp([3e-4, 0, 0]).astype(np.float32)
    assert np.linalg.norm(rotations.log(rotation)) == pytest.approx(3e-4, rel=1e-3)
    many = Rotation.random(3000, random_state=1).as_matrix().astype(np.float32)
    near_zero = rotations.log(np.swapaxes(many, -1, -2) @ many)
    assert np.isfinite(near_zero).all()
    assert np.abs(near_zero).max() < 1e-6


def test_r12_log_near_half_a_turn() -> None:
    # Naive: error 0.108 at π − 1e-3, 3597 at π − 1e-4 (float32), 12.1 at π (float64).
    axis = np.array([0.48, -0.6, 0.64])
    for short, tolerance, kind in (
        (1e-3, 1e-6, np.float32),
        (1e-4, 1e-6, np.float32),
        (0.0, 1e-6, np.float32),
        (1e-7, 2e-8, np.float64),
        (0.0, 2e-8, np.float64),
    ):
        found = rotations.log(Rotation.from_rotvec((np.pi - short) * axis).as_matrix().astype(kind))
        found = found if found @ axis > 0 else -found
        np.testing.assert_allclose(found, (np.pi - short) * axis, atol=tolerance)


def test_r13_quaternion_near_half_a_turn() -> None:
    # Naive trace branch: norm 0.965, inf, NaN.
    for short in (1e-3, 1e-4, 0.0):
        for axis in np.vstack([np.eye(3), [[0.6, 0.0, 0.8]]]):
            q = rotations.to_quaternion(Rotation.from_rotvec((np.pi - short) * axis).as_matrix())
            assert np.linalg.norm(q) == pytest.approx(1, abs=1e-12)
            np.testing.assert_allclose(np.abs(q[1:]), np.abs(axis) * np.cos(short / 2), atol=1e-9)


def test_r14_quaternion_of_length_zero() -> None:
    # Naive: NaN at 0, inf and NaN at 1e-23.
    for length in (0.0, 1e-23):
        np.testing.assert_array_equal(rotations.from_quaternion(np.full(4, length)), np.eye(3))


def test_r15_distance_of_equal_rotations_has_a_gradient() -> None:
    # Naive arccos of the trace: gradient −inf; clamped at 1 − 1e-7 the value floors at 4.9e-4 rad and the gradient is
    # 0.
    start = rotations.exp([0.3, -0.2, 0.9])
    squared = lambda w: float(rotations.angle(start, start @ rotations.exp(w)) ** 2)  # noqa: E731
    assert squared(np.zeros(3)) < 1e-30
    for axis in np.eye(3):
        assert abs(squared(1e-6 * axis) - squared(-1e-6 * axis)) / 2e-6 < 1e-9
        for tiny in (1e-4, 1e-6):  # no floor: the curvature is that of θ²
            assert squared(tiny * axis) == pytest.approx(tiny**2, rel=1e-6)
    # Half a turn apart is as far as it gets, and still a number.
    assert rotations.angle(start, start @ rotations.exp([np.pi, 0, 0])) == pytest.approx(np.pi, abs=1e-7)


def test_r20_parallel_vectors_still_span_a_rotation() -> None:
    # Naive: the camera's right is forward × up, NaN once it is normalised where it looks straight up or down.
    eye = np.array([0.4, -1.0, 2.0])
    for down in ([0, 0, -2.0], [0, 0, 3.0], [1e-9, 0, -2.0], [0, 0, 0]):
        found = look_at(eye, eye + down)
        np.testing.assert_allclose(found.T @ found, np.eye(3), atol=1e-9)
        assert np.linalg.det(found) == pytest.approx(1, abs=1e-9)
        if np.any(down):
            np.testing.assert_allclose(found[:, 2], down / np.linalg.norm(down), atol=1e-9)


def test_r16_mean_does_not_mind_signs() -> None:
    # Naive component mean of q(10°) and −q(12°): −169°.
    half = np.deg2rad([5.0, 6.0])
    quaternions = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=-1) * np.array([[1], [-1]])
    mean, determined = rotations.mean(rotations.from_quaternion(quaternions))
    assert determined
    assert angle_z_deg(mean) == pytest.approx(11, abs=1e-9)


def test_r17_mean_of_thirds_is_undetermined() -> None:
    # Naive: an arbitrary 90°.
    assert not rotations.mean(about_z(np.array([0.0, 120, 240])))[1]


def test_r18_long_products_are_repaired() -> None:
    # Naive: |RᵀR − I| 7.7e-4 after 1e5 float32 products.
    step, product = rotations.exp([0.01, 0.02, 0.03]).astype(np.float32), np.eye(3, dtype=np.float32)
    for _ in range(100_000):
        product = product @ step
    repaired = rotations.project_to_so3(product)
    assert np.abs(repaired.T @ repaired - np.eye(3)).max() < 1e-12
    assert np.linalg.det(repaired) == pytest.approx(1, abs=1e-12)


def test_r19_kabsch_of_a_planar_torso() -> None:
    # Naive: det < 0 in 49 % of noisy draws, 100 % of exactly planar ones.
    rng = np.random.default_rng(0)
    torso = np.array([[0.2, 0.5, 0], [-0.2, 0.5, 0], [0.12, 0, 0], [-0.12, 0, 0]])
    truth = rotations.exp(rng.normal(size=(300, 3)))
    for noise in (0.0, 0.01):
        target = np.einsum("tij,nj->tni", truth, torso) + rng.normal(0, noise, (300, 4, 3))
        rotation, _, determined = rotations.kabsch(torso, target, np.ones((300, 4)))
        assert determined.all()
        np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=1e-9)
        assert np.rad2deg(rotations.angle(rotation, truth)).max() < (1e-4 if noise == 0 else 20)


def test_r21_pitch_crosses_ninety() -> None:
    # Naive Euler angles: 108° error; rotation vectors 0.43°.
    pitch = np.deg2rad(np.linspace(80, 100, 41))
    turns = rotations.exp([0, 0, 0.5]) @ rotations.exp(pitch[:, None] * np.array([0, 1.0, 0]))
    smooth = smoothing.smooth_rotations(turns, 0.5, 1.0)
    assert np.rad2deg(rotations.angle(smooth, turns))[18:-18].max() < 1e-9


# ---- Rotations: inverse pairs, agreement with scipy, determinants ----


def test_exp_log_and_quaternions_agree_with_scipy() -> None:
    rng = np.random.default_rng(0)
    w = rng.normal(size=(500, 3)) * 2
    theirs = Rotation.from_rotvec(w)
    np.testing.assert_allclose(rotations.exp(w), theirs.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(rotations.log(theirs.as_matrix()), theirs.as_rotvec(), atol=1e-9)
    quaternion = theirs.as_quat(canonical=True)[:, [3, 0, 1, 2]]
    np.testing.assert_allclose(rotations.to_quaternion(theirs.as_matrix()), quaternion, atol=1e-12)
    np.testing.assert_allclose(rotations.from_quaternion(3 * quaternion), theirs.as_matrix(), atol=1e-13)


def test_kabsch_recovers_a_motion_and_ignores_missing_points() -> None:
    rng = np.random.default_rng(2)
    source = rng.normal(size=(7, 10, 3))
    turn, shift = rotations.exp(rng.normal(size=(7, 3))), rng.normal(size=(7, 3))
    target = np.einsum("tij,tnj->tni", turn, source) + shift[:, None]
    weights = np.ones((7, 10))
    target[:, 3], weights[:, 3] = np.nan, 0
    rotation, translation, determined = rotations.kabsch(source, target, weights)
    assert determined.all()
    np.testing.assert_allclose(rotation, turn, atol=1e-12)
    np.testing.assert_allclose(translation, shift, atol=1e-12)


@pytest.mark.parametrize("points", [0, 1, 2, "line"])
def test_kabsch_says_when_points_fix_nothing(points: int | str) -> None:
    source = np.random.default_rng(3).normal(size=(1, 6, 3))
    weights = np.zeros((1, 6))
    if points == "line":
        source, weights = np.linspace(0, 1, 6)[None, :, None] * np.array([1.0, 2, 3]), np.ones((1, 6))
    else:
        weights[:, : int(points)] = 1
    rotation, _, determined = rotations.kabsch(source, source, weights)
    assert not determined.any()
    assert np.isfinite(rotation).all()
