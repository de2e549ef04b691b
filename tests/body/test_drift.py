# SPDX-License-Identifier: Apache-2.0
"""What a network adds at the moments of a film: its own answer at whole frames, the straight line between them, and
each frame asked once."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.body.avatar.control_points import ControlPoints
from studiorecon.body.avatar.drift import Drift
from studiorecon.body.avatar.temporal import TemporalNetwork

FRAMES = 12


def taught(places: np.ndarray, control: ControlPoints | None) -> TemporalNetwork:
    rng = np.random.default_rng(2)
    made = TemporalNetwork.start(-np.ones(3), np.ones(3), FRAMES, rng, 16, 3, control)
    made.flat[:] = rng.normal(0, 0.3, len(made.flat))
    return made


@pytest.mark.parametrize("points", [None, 40])
def test_whole_frames_are_the_networks_and_others_lie_between(points: int | None) -> None:
    places = np.random.default_rng(0).uniform(-1, 1, (300, 3)).astype(np.float32)
    network = taught(places, ControlPoints.on(places, points) if points else None)
    drift = Drift(network, places)
    for frame in (0, 5, FRAMES - 1):
        for found, expected in zip(drift.residuals(float(frame)), network.residuals(places, frame)):
            np.testing.assert_array_equal(found, expected)
    (low, low_logit), (high, high_logit) = network.residuals(places, 4), network.residuals(places, 5)
    colour, logit = drift.residuals(4.25)
    np.testing.assert_allclose(colour, 0.75 * low + 0.25 * high, atol=1e-6)
    np.testing.assert_allclose(logit, 0.75 * low_logit + 0.25 * high_logit, atol=1e-6)
    assert np.abs(high - low).max() > 0.01
    for beyond, last in ((-3.0, 0.0), (99.0, FRAMES - 1.0)):
        np.testing.assert_array_equal(drift.residuals(beyond)[0], drift.residuals(last)[0])
