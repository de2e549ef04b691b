# SPDX-License-Identifier: Apache-2.0
"""The temporal network: shape, start, gradients by finite differences, and that it can learn what changes over time."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.body.avatar.temporal import LAYERS, SKIP, WIDTH, TemporalNetwork

LOW, HIGH = np.array([-0.9, -0.3, -1.0]), np.array([0.9, 0.3, 1.0])


def network(rng: np.random.Generator, **shape: int) -> TemporalNetwork:
    return TemporalNetwork.start(LOW, HIGH, 30, rng, **shape)


def test_it_has_the_papers_shape_and_enters_without_a_jump() -> None:
    """Appendix D: 8 x 256, skip at 4, 63 + 21 inputs; U48: the last layer starts at zero."""
    rng = np.random.default_rng(0)
    made = network(rng)
    assert (made.layers, WIDTH, LAYERS, SKIP) == (8, 256, 8, 4)
    assert [w.shape for w, _ in made.matrices()] == [
        (84, 256),
        *[(256, 256)] * 4,
        (84 + 256, 256),
        *[(256, 256)] * 2,
        (256, 4),
    ]
    colour, logit = made.residuals(rng.uniform(LOW, HIGH, (50, 3)), 3)
    assert colour.shape == (50, 3)
    assert logit.shape == (50,)
    assert not colour.any()
    assert not logit.any()


@pytest.mark.parametrize("frame", [0, 7.25, 29])
def test_gradients_are_the_slopes(frame: float) -> None:
    rng = np.random.default_rng(1)
    made = network(rng, width=12)
    # In double precision, so that differences are exact to nine digits.
    made.flat = made.flat + 0.1 * rng.standard_normal(len(made.flat))
    points, by_colour, by_logit = rng.uniform(LOW, HIGH, (9, 3)), rng.standard_normal((9, 3)), rng.standard_normal(9)

    def loss() -> float:
        colour, logit = made.residuals(points, frame)
        return float((colour * by_colour).sum() + (logit * by_logit).sum())

    loss()
    found = made.gradient(by_colour, by_logit)
    for at in rng.choice(len(made.flat), 200, replace=False):
        kept, step = made.flat[at], 1e-6
        made.flat[at] = kept + step
        above = loss()
        made.flat[at] = kept - step
        below = loss()
        made.flat[at] = kept
        # The position code is single precision.
        assert found[at] == pytest.approx((above - below) / (2 * step), rel=1e-6, abs=1e-6)


def test_it_survives_its_file_and_a_poisoned_gaussian() -> None:
    rng = np.random.default_rng(3)
    made = network(rng, width=16)
    made.matrices()[-1][0][...] = rng.standard_normal((16, 4))
    points = rng.uniform(LOW, HIGH, (20, 3))
    back = TemporalNetwork.from_arrays(made.to_arrays())
    np.testing.assert_array_equal(back.residuals(points, 4.5)[0], made.residuals(points, 4.5)[0])
    clean = made.residuals(points, 4)[0]
    points[3] = np.nan
    colour, _ = made.residuals(points, 4)
    np.testing.assert_allclose(np.delete(colour, 3, 0), np.delete(clean, 3, 0), rtol=1e-5, atol=1e-6)
    by_colour = np.ones((20, 3))
    by_colour[3] = np.nan
    assert np.isfinite(made.gradient(by_colour, np.zeros(20))).all()
    with pytest.raises(ValueError, match=r"means_m has shape \(20,\)"):
        made.residuals(points[:, 0], 0)
