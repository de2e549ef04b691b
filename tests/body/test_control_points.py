# SPDX-License-Identifier: Apache-2.0
"""Control points carry what changes slowly over a body, and their gradient is the transpose of what they spread."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.body.avatar.control_points import ControlPoints, farthest_point_sample
from studiorecon.body.avatar.temporal import TemporalNetwork


@pytest.fixture(scope="module")
def places() -> np.ndarray:
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(4000, 3))
    return 0.5 * ball / np.linalg.norm(ball, axis=1, keepdims=True)


def test_points_are_spread_over_the_body(places: np.ndarray) -> None:
    chosen = places[farthest_point_sample(places, 200)]
    apart = np.linalg.norm(chosen[:, None] - chosen, axis=2) + np.eye(200) * 9
    # Two hundred points of a sphere of half a metre are 12 cm apart at best.
    assert apart.min() > 0.08
    assert np.linalg.norm(places[:, None] - chosen, axis=2).min(axis=1).max() < 0.1


def test_what_is_the_same_everywhere_stays_and_what_is_smooth_is_met(places: np.ndarray) -> None:
    control = ControlPoints.on(places, 400)
    np.testing.assert_allclose(control.spread(np.ones((400, 2))), 1, atol=1e-6)
    smooth = np.sin(3 * control.points_m[:, :1])
    assert np.abs(control.spread(smooth) - np.sin(3 * places[:, :1])).mean() < 0.05


def test_the_gradient_is_the_transpose(places: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    control = ControlPoints.on(places, 100)
    values, by_gaussian = rng.normal(size=(100, 4)), rng.normal(size=(len(places), 4))
    ahead = np.vdot(control.spread(values).astype(np.float64), by_gaussian)
    back = np.vdot(values, control.gather_gradient(by_gaussian).astype(np.float64))
    assert ahead == pytest.approx(back, rel=1e-4)


@pytest.mark.parametrize("count", [1, 2, 4, 5])
def test_few_gaussians_have_few_points(places: np.ndarray, count: int) -> None:
    control = ControlPoints.on(places[:count], 400)
    assert len(control.points_m) == count
    spread = control.spread(np.arange(count, dtype=np.float32)[:, None])
    assert spread.min() >= 0
    assert spread.max() <= count - 1
    if count < 5:
        np.testing.assert_allclose(np.sort(spread[:, 0]), np.arange(count), atol=1e-3)


@pytest.mark.parametrize("poison", [np.nan, np.inf])
def test_one_poisoned_gradient_teaches_nothing_and_spoils_nothing(places: np.ndarray, poison: float) -> None:
    control = ControlPoints.on(places, 100)
    gradient = np.ones((len(places), 4), np.float32)
    gradient[7] = poison
    assert np.isfinite(control.gather_gradient(gradient)).all()
    assert control.gather_gradient(gradient).sum() == pytest.approx(4 * (len(places) - 1), rel=1e-4)


def test_a_network_at_control_points_learns_what_drifts_and_survives_its_file(places: np.ndarray) -> None:
    """Brightness that a lamp on one side takes away over the clip is found again between the points."""
    frames, rng = 20, np.random.default_rng(2)
    network = TemporalNetwork.start(places.min(0), places.max(0), frames, rng, 32, 4, ControlPoints.on(places, 200))
    truth = np.clip(places[:, 0], 0, None)
    moments = rng.integers(0, frames, 600)
    step = np.zeros_like(network.flat)
    for frame in moments:
        colour, logit = network.residuals(places, float(frame))
        error = colour - (truth * frame / frames)[:, None]
        slope = network.gradient(2 * error / len(places), np.zeros_like(logit))
        step = 0.9 * step + slope
        network.flat -= 0.02 * step
    left = [np.abs(network.residuals(places, float(f))[0] - (truth * f / frames)[:, None]).mean() for f in (5, 10, 19)]
    assert max(left) < 0.04 < np.abs(truth * 19 / frames).mean()
    again = TemporalNetwork.from_arrays(network.to_arrays())
    np.testing.assert_array_equal(again.residuals(places, 7.5)[0], network.residuals(places, 7.5)[0])


def test_other_gaussians_than_those_of_the_points_are_refused(places: np.ndarray) -> None:
    network = TemporalNetwork.start(
        places.min(0), places.max(0), 9, np.random.default_rng(0), 16, 2, ControlPoints.on(places, 50)
    )
    with pytest.raises(ValueError, match="means_m"):
        network.residuals(places[:-1], 0.0)
