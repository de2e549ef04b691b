# SPDX-License-Identifier: Apache-2.0
"""Smoothing: what it keeps, what it costs, what it does to gaps and at other frame rates. Hard cases are in
tests/hard."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from studiorecon.geometry import rotations, smoothing
from studiorecon.geometry.smoothing import Smoothing


@settings(deadline=None)
@given(st.floats(0.05, 1), st.floats(0, 3), st.integers(1, 40))
def test_constants_are_fixed_points(alpha: float, sigma: float, frames: int) -> None:
    np.testing.assert_allclose(smoothing.smooth_vectors(np.full((frames, 2), 3.7), alpha, sigma), 3.7, rtol=1e-12)
    same = np.broadcast_to(rotations.exp([0.3, 2.8, -0.4]), (frames, 3, 3))
    np.testing.assert_allclose(smoothing.smooth_rotations(same, alpha, sigma), same, atol=1e-12)


def test_no_smoothing_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(20, 4))
    np.testing.assert_array_equal(smoothing.smooth_vectors(values, 1.0, 0.0), values)
    turns = rotations.exp(rng.normal(size=(20, 5, 3)))
    np.testing.assert_allclose(smoothing.smooth_rotations(turns, 1.0, 0.0), turns, atol=1e-14)


def test_time_reversal_commutes() -> None:
    values = np.random.default_rng(1).normal(size=(30, 3))
    np.testing.assert_allclose(
        smoothing.smooth_vectors(values[::-1], 0.5, 1)[::-1], smoothing.smooth_vectors(values, 0.5, 1), atol=1e-14
    )


def test_rotation_smoothing_follows_the_choice_of_world() -> None:
    rng = np.random.default_rng(2)
    turns = rotations.exp(np.cumsum(rng.normal(size=(40, 3)) * 0.1, axis=0))
    world = rotations.exp([0.4, -2.0, 1.0])
    np.testing.assert_allclose(
        smoothing.smooth_rotations(world @ turns, 0.5, 1), world @ smoothing.smooth_rotations(turns, 0.5, 1), atol=1e-10
    )


def test_interior_equals_the_two_exponential_passes() -> None:
    values = np.random.default_rng(3).normal(size=400)
    alpha, passed = 0.5, values.copy()
    for _ in range(2):
        for t in range(1, len(passed)):
            passed[t] = alpha * passed[t] + (1 - alpha) * passed[t - 1]
        passed = passed[::-1].copy()
    np.testing.assert_allclose(smoothing.smooth_vectors(values, alpha, 0)[60:-60], passed[60:-60], atol=5e-4)


@pytest.mark.parametrize("fps", [15.0, 60.0, 120.0])
def test_smoothing_keeps_its_length_in_seconds(fps: float) -> None:
    reference = Smoothing(1 / (30 * np.log(2)), 1 / 30, "cascade", True, "rotations")
    alpha, sigma = smoothing.at_frame_rate(reference, fps)
    # A motion of two seconds keeps the same share at every frame rate.
    assert smoothing.gain(alpha, sigma, 2 * fps) == pytest.approx(smoothing.gain(0.5, 1.0, 60), abs=0.01)
    assert smoothing.at_frame_rate(reference, 30.0) == pytest.approx((0.5, 1.0))


def test_gaps_are_filled_along_the_shortest_way_and_ends_held() -> None:
    turns = rotations.exp(np.linspace(0, 1.8, 10)[:, None] * np.array([0, 0, 1.0]))
    values = np.linspace(0, 9, 10)[:, None]
    valid = np.array([0, 1, 1, 0, 0, 0, 1, 1, 0, 0], dtype=bool)
    broken = np.where(valid[:, None, None], turns, np.eye(3))
    filled = smoothing.fill_rotations(broken, valid)
    np.testing.assert_allclose(filled[1:8], turns[1:8], atol=1e-12)
    np.testing.assert_array_equal(filled[valid], turns[valid])
    np.testing.assert_array_equal(smoothing.fill_vectors(values, valid)[:, 0], [1, 1, 2, 3, 4, 5, 6, 7, 7, 7])
    np.testing.assert_allclose(filled[9], turns[7], atol=1e-12)
    with pytest.raises(ValueError, match="no valid frame"):
        smoothing.fill_vectors(values, np.zeros(10, dtype=bool))


def test_impossible_strengths_are_refused() -> None:
    with pytest.raises(ValueError, match="alpha"):
        smoothing.kernel(0.0, 1.0)
