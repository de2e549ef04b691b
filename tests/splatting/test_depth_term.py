# SPDX-License-Identifier: Apache-2.0
"""The depth term: its gradient, what it leaves alone, and that it brings a room to the depth it is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.train.still import train_still
from studiorecon.splatting.train.targets import Target
from studiorecon.splatting.train.terms import Depth

from tests.made.gaussians import room
from tests.made.splatting_settings import SETTINGS
from tests.made.splatting_training import FIELDS, lesson
from tests.made.training import of_term, plane_view

__all__ = ["lesson"]


def test_the_slope_is_that_of_finite_differences() -> None:
    rng = np.random.default_rng(7)
    planes = np.zeros((5, 12, 19), np.float32)
    planes[4] = rng.uniform(0.05, 0.6, (12, 19))
    planes[3] = (1 - planes[4]) * rng.uniform(1, 4, (12, 19))
    wanted = np.where(rng.random((12, 19)) < 0.7, rng.uniform(1, 4, (12, 19)), 0).astype(np.float32)
    _, gradient = of_term(Depth(100.0), plane_view(planes, depth_m=wanted))
    assert not gradient[3:, wanted == 0].any()
    # gradient[4] is by alpha, planes[4] is transmittance: the sign turns.
    for plane, sign in ((3, 1), (4, -1)):
        y, x = np.argwhere(wanted > 0)[5]
        values = []
        for step in (-1e-3, 1e-3):
            moved = planes.copy()
            moved[plane, y, x] += step
            values.append(of_term(Depth(100.0), plane_view(moved, depth_m=wanted))[0])
        assert gradient[plane, y, x] == pytest.approx(sign * (values[1] - values[0]) / 2e-3, rel=2e-2)


def test_targets_without_depth_pull_at_nothing(lesson: tuple[Gaussians, list[Target]]) -> None:
    begin, targets = lesson
    kinds = [None, np.zeros((53, 97), np.float32), np.full((53, 97), np.inf, np.float32)]
    runs = []
    for depth_m in kinds:
        given = [replace(target, depth_m=depth_m) for target in targets]
        settings = replace(SETTINGS, iterations=10, depth=0.5)
        runs.append(train_still(begin, given, settings, np.random.default_rng(0), extent_m=1.0, threads=1).gaussians)
    for name in FIELDS:
        for other in runs[1:]:
            np.testing.assert_array_equal(getattr(other, name), getattr(runs[0], name))


def test_a_room_comes_nearer_to_the_depth_it_is_told(lesson: tuple[Gaussians, list[Target]]) -> None:
    begin, targets = lesson
    rasteriser = Rasteriser(near_m=0.01, threads=1)
    truth_m = [rasteriser.forward(room(1200, 3), target.camera).depth_m for target in targets]
    told = [replace(target, depth_m=depth_m) for target, depth_m in zip(targets, truth_m, strict=True)]
    errors = []
    for depth in (0.0, 0.5):
        settings = replace(SETTINGS, iterations=120, depth=depth)
        trained = train_still(begin, told, settings, np.random.default_rng(0), extent_m=1.0, threads=1).gaussians
        shown_m = [rasteriser.forward(trained, target.camera).depth_m for target in targets]
        known = [depth_m > 0 for depth_m in truth_m]
        gaps = [np.abs(a[k] / b[k] - 1) for a, b, k in zip(shown_m, truth_m, known, strict=True)]
        errors.append(float(np.median(np.concatenate(gaps))))
    assert errors[1] < 0.8 * errors[0]
