# SPDX-License-Identifier: Apache-2.0
"""Hard cases S01 to S05 of the scene's scale from bones."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.geometry.rotations import exp
from studiorecon.geometry.scale import SceneScale, fit_scale, scene_scale

# Pelvis, head, then hip, knee, ankle, toe, shoulder, elbow, wrist, fingertip of both sides.
_SIDE = np.array([[0, 0.1, 0.92], [0, 0.1, 0.5], [0, 0.1, 0.09], [0.05, 0.1, 0.06]])
_ARM = np.array([[0, 0.18, 1.42], [0, 0.25, 1.15], [0.1, 0.24, 0.92], [0.15, 0.24, 0.9]])
TEMPLATE = np.concatenate([[[0, 0, 0.95], [0, 0, 1.6]], _SIDE, _SIDE * [1, -1, 1], _ARM, _ARM * [1, -1, 1]])
BONES = np.array(
    [[0, 1], *[[b + i, b + i + 1] for b in (2, 6, 10, 14) for i in range(3)], [2, 6], [10, 14], [2, 10], [6, 14]]
)


def made(scale: float, people: int = 1, frames: int = 20, noise_m: float = 0.0, seed: int = 0) -> np.ndarray:
    """(P, T, J, 3) the template turned and shifted at random in a scene of ``scale`` units per metre, with noise."""
    rng = np.random.default_rng(seed)
    turns, shifts = exp(rng.normal(size=(people, frames, 3))), rng.uniform(-3, 3, (people, frames, 1, 3))
    metres = np.einsum("ptij,nj->ptni", turns, TEMPLATE) + shifts
    return scale * (metres + noise_m * rng.normal(size=metres.shape))


def solve(joints: np.ndarray, **changed: object) -> SceneScale:
    people = joints.shape[0]
    given = {
        "valid": np.ones(joints.shape[:3], bool),
        "template_joints_m": np.tile(TEMPLATE, (people, 1, 1)),
        **changed,
    }
    return scene_scale(joints, bones=BONES, **given)


# S01 naive, delta 0.05 for every scale: +111 % at 1e-4, +149 % at 1e-2, no better than least squares.
@pytest.mark.parametrize("scale", [1e-4, 1e-2, 1.0, 1e2, 1e4], ids=lambda s: f"S01-{s:g}")
def test_a_third_of_wrong_bones_moves_the_scale_little_at_every_scale(scale: float) -> None:
    rng = np.random.default_rng(1)
    # Every bone stands alone here, so that exactly 30 % of them are five times too long.
    first, second = BONES[rng.integers(0, len(BONES), 400)].T
    ends = scale * np.stack([TEMPLATE[first], TEMPLATE[second]], axis=1)
    wrong = rng.random(400) < 0.3
    ends[wrong, 1] = ends[wrong, 0] + 5 * (ends[wrong, 1] - ends[wrong, 0])
    pairs = np.arange(800).reshape(400, 2)
    template = np.stack([TEMPLATE[first], TEMPLATE[second]], axis=1).reshape(1, 800, 3)
    found = scene_scale(ends.reshape(1, 1, 800, 3), template, pairs, np.ones((1, 1, 800), bool))
    assert found.world_per_metre == pytest.approx(scale, rel=0.15)
    assert found.world_per_metre == pytest.approx(solve(made(scale)).world_per_metre, rel=0.06)


# S02 naive, L-BFGS without line search from 1: -77 % at 100, -99.8 % at 1e4; in logarithms +241 % at 1e-4.
@pytest.mark.parametrize("scale", [1e-4, 1.0, 100.0, 1e4], ids=lambda s: f"S02-{s:g}")
def test_exact_bones_give_the_exact_scale(scale: float) -> None:
    assert solve(made(scale)).world_per_metre == pytest.approx(scale, rel=1e-9)


def none_measured() -> SceneScale:
    return solve(np.full((1, 5, len(TEMPLATE), 3), np.nan))


def none_valid() -> SceneScale:
    return solve(made(1.0), valid=np.zeros((1, 20, len(TEMPLATE)), bool))


def all_in_one_place() -> SceneScale:
    return solve(np.full((1, 5, len(TEMPLATE), 3), 1.7))


def three_bones() -> SceneScale:
    valid = np.zeros((1, 20, len(TEMPLATE)), bool)
    valid[:, :, [2, 3, 4]] = True
    return solve(made(1.0), valid=valid)


def beyond_any_scene() -> SceneScale:
    return solve(made(1e7))


# S03 naive: NaN, and exactly 0, by which everything is divided later.
@pytest.mark.parametrize(
    "case",
    [none_measured, none_valid, all_in_one_place, three_bones, beyond_any_scene],
    ids=lambda c: f"S03-{c.__name__}",
)
def test_bones_that_do_not_tell_are_undetermined(case) -> None:
    found = case()
    assert not found.determined
    assert found.reason
    assert np.isnan(found.world_per_metre)
    assert np.isnan(found.per_person).all()


# S04 naive: the mean of ratios is infinite.
@pytest.mark.parametrize("short_m", [0.0, 1e-9, 0.01], ids=lambda v: f"S04-{v:g}")
def test_a_bone_of_no_length_changes_nothing(short_m: float) -> None:
    template = TEMPLATE.copy()
    template[5] = template[4] + [short_m, 0, 0]
    joints = made(3.0, noise_m=0.01)
    assert solve(joints, template_joints_m=template[None]).world_per_metre == solve(joints).world_per_metre


def test_s05_noise_does_not_make_people_larger() -> None:
    # Naive: bones of 5 cm read 2.44 times too long, of 10 cm 1.47, of 40 cm 1.03; mean ratio +32 %, least squares +10
    # %.
    scales = [solve(made(2.0, frames=400, noise_m=0.05, seed=s), sigma=0.1).world_per_metre for s in range(5)]
    assert np.abs(np.array(scales) / 2.0 - 1).max() < 0.02
    assert abs(np.mean(scales) / 2.0 - 1) < 0.01
    assert solve(made(2.0, frames=400, noise_m=0.05)).world_per_metre > 1.02 * 2.0  # what the correction is worth


def test_s05_the_expected_excess_of_a_bone_is_taken_off_exactly() -> None:
    template, scale, variance = np.linspace(0.2, 0.5, 40), 3.0, np.linspace(0.0, 0.02, 40)
    lengths = scale * template + variance / (scale * template)
    assert fit_scale(lengths, template, variance) == pytest.approx(scale, rel=1e-9)
    # Both ends' deviations count, each as often as the other.
    sigma = np.zeros((1, 20, len(TEMPLATE)))
    sigma[..., BONES[:, 0]] = 0.05
    noisy = made(1.0) + sigma[..., None] * np.random.default_rng(0).normal(size=(1, 20, len(TEMPLATE), 3))
    turned = scene_scale(noisy, TEMPLATE[None], BONES[:, ::-1], np.ones((1, 20, len(TEMPLATE)), bool), sigma)
    assert turned.world_per_metre == pytest.approx(solve(noisy, sigma=sigma).world_per_metre, rel=1e-12)


def test_one_scale_for_the_scene_and_every_persons_own_ratio_beside_it() -> None:
    joints = made(0.5, people=3)
    joints[2] *= 1.08
    found = solve(joints)
    assert found.world_per_metre == pytest.approx(0.5, rel=0.04)
    assert found.per_person[2] / found.per_person[0] == pytest.approx(1.08, rel=1e-6)
