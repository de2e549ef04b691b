# SPDX-License-Identifier: Apache-2.0
"""Rotations: inverse pairs, agreement with scipy, determinants."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from studiorecon.geometry import rotations


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
