# SPDX-License-Identifier: Apache-2.0
"""One percent of what report reads is NaN, infinite or zero: it ends, counts, and the rest stays what it was."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.report.metrics import jitter, truth
from studiorecon.report.metrics.bodies import compare_bodies

from tests.made.scene import ring

FAULTS = [pytest.param(value, id=name) for name, value in (("nan", np.nan), ("inf", np.inf), ("zero", 0.0))]


def struck(rng: np.random.Generator, values: np.ndarray, fault: float) -> tuple[np.ndarray, np.ndarray]:
    """A copy with a random 1 % of its entries replaced, and where."""
    where = rng.random(values.shape) < 0.01
    assert where.any()
    return np.where(where, fault, values), where


@pytest.mark.parametrize("fault", FAULTS)
def test_training_depth(fault: float) -> None:
    """A pixel without depth, and its neighbours as depth edges where it is a hole, see nothing; all others as
    before."""
    rng = np.random.default_rng(2)
    camera = ring([0.0], "c")[0]
    depth = np.full((camera.wh[1], camera.wh[0]), 2.0)
    points = camera.unproject(camera.pixel_centres(), depth)
    known = np.ones(depth.shape, bool)
    before = truth.is_visible(points, known, camera, depth, 0.05)[0]
    broken, where = struck(rng, depth, fault)
    after = truth.is_visible(points, known, camera, broken, 0.05)[0]
    assert not after[where].any()
    near = np.zeros_like(where)
    for row, column in np.argwhere(where):
        near[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2] = True
    np.testing.assert_array_equal(after[~near], before[~near])


@pytest.mark.parametrize("fault", FAULTS)
def test_joints_and_poses(fault: float) -> None:
    rng = np.random.default_rng(3)
    # A person who stays: a joint at the world's origin is then far away, but finite, and no reader of joints can know.
    true = rng.normal(0, 0.4, (1, 24, 3)) + np.array([0, 0, 1.0]) + np.zeros((300, 1, 1))
    fitted, valid = true + rng.normal(0, 0.01, true.shape), np.ones(300, bool)
    frames = rng.random(300) < 0.01
    broken, poses = fitted.copy(), np.full((300, 72), 0.1)
    broken[frames, 7], poses[frames, 5] = fault, fault
    clean, found = (
        compare_bodies({"p0": (fitted, valid)}, {"p0": true}),
        compare_bodies({"p0": (broken, valid)}, {"p0": true}),
    )
    jumpy = jitter.jitter(broken, poses, valid, 30.0)
    if fault == 0:
        assert found["mpjpe_world_mm"] == pytest.approx(clean["mpjpe_world_mm"], rel=0.5)
        assert (found["people"]["p0"]["not_finite"], jumpy["not_finite"]) == (0, 0)
    else:
        assert found["people"]["p0"]["not_finite"] == jumpy["not_finite"] == frames.sum() > 0
        assert found["mpjpe_world_mm"] == pytest.approx(clean["mpjpe_world_mm"], rel=0.01)
        assert jumpy["pose_deg_f2"] == pytest.approx(0, abs=1e-9)
        assert jumpy["joints_mm_f2"] == pytest.approx(jitter.jitter(fitted, poses, ~frames, 30.0)["joints_mm_f2"])
