# SPDX-License-Identifier: Apache-2.0
"""Relocation: the picture stays, the number stays, moments start anew; the random walk goes along a Gaussian's own
axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.train.density import relocate, scale_factor, shared_opacity
from studiorecon.splatting.train.still import train_still as train
from studiorecon.splatting.train.targets import Target

from tests.made.gaussians import rasterise, room
from tests.made.splatting_settings import SETTINGS
from tests.made.splatting_training import FIELDS, lesson, psnr_db

__all__ = ["lesson"]


def published(opacity: float, copies: int) -> float:
    """The paper's double sum, term by term."""
    from math import comb

    o = 1 - (1 - opacity) ** (1 / copies)
    return opacity / sum(
        comb(i - 1, k) * (-1) ** k * o ** (k + 1) / np.sqrt(k + 1) for i in range(1, copies + 1) for k in range(i)
    )


@pytest.mark.parametrize("copies", [1, 2, 5, 17])
@pytest.mark.parametrize("opacity", [0.01, 0.5, 0.99])
def test_copies_together_are_what_the_one_was(opacity: float, copies: int) -> None:
    shared, factor = (
        shared_opacity(np.array([opacity]), np.array([copies]))[0],
        scale_factor(np.array([opacity]), np.array([copies]))[0],
    )
    assert 1 - (1 - shared) ** copies == pytest.approx(opacity, rel=1e-12)
    assert factor == pytest.approx(published(opacity, copies), rel=1e-9)
    # The blend of the copies has the integral of the one, along a line through the centre.
    x = np.linspace(-12, 12, 48001)
    one = opacity * np.exp(-0.5 * x**2)
    blend = 1 - (1 - shared * np.exp(-0.5 * (x / factor) ** 2)) ** copies
    assert blend.sum() == pytest.approx(one.sum(), rel=1e-6)
    # Naive (opacities and scales kept): the integral of two copies of 0.99 is 1.6 times that of one.


def test_the_picture_hardly_changes_and_the_number_not_at_all(lesson: tuple[Gaussians, list[Target]]) -> None:
    _, targets = lesson
    scene = room(1200, 3).with_sh_degree(1)
    logits = scene.logit_opacities.copy()
    logits[::10] = -9.0
    dead = replace(scene, logit_opacities=logits)
    pictures = [replace(t, rgb=rendered(dead, t)) for t in targets]
    moved = relocate(dead, dead_opacity=0.005, rng=np.random.default_rng(0))
    assert moved.gaussians.count == 1200
    assert moved.pruned == np.count_nonzero(1 / (1 + np.exp(-dead.logit_opacities)) <= 0.005)
    naive = dead.take(moved.parent)
    assert psnr_db(moved.gaussians, pictures) > psnr_db(naive, pictures) + 5
    assert psnr_db(moved.gaussians, pictures) > 30
    np.testing.assert_array_equal(moved.gaussians.means_m, dead.means_m[moved.parent])
    assert not moved.fresh[(np.bincount(moved.parent, minlength=1200)[moved.parent] == 1)].any()
    assert moved.fresh[::10].all()


def rendered(gaussians: Gaussians, target: Target) -> np.ndarray:
    return rasterise(gaussians, target.camera, near_m=0.01, threads=1).rgb.clip(0, 1)


def test_nothing_alive_or_nothing_dead_changes_nothing() -> None:
    scene = room(50, 1)
    for logit in (-20.0, 4.0):
        given = replace(scene, logit_opacities=np.full(50, logit))
        moved = relocate(given, dead_opacity=0.005, rng=np.random.default_rng(0))
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(moved.gaussians, name), getattr(given, name))
        assert not moved.fresh.any()


def test_training_with_relocation_keeps_the_number_and_repeats(lesson: tuple[Gaussians, list[Target]]) -> None:
    begin, targets = lesson
    settings = replace(
        SETTINGS,
        iterations=60,
        densify="relocate",
        densify_every=20,
        densify_from=20,
        densify_until=60,
        prune_opacity=0.2,
    )
    runs = [train(begin, targets, settings, np.random.default_rng(0), extent_m=1.0, threads=2) for _ in range(2)]
    assert runs[0].gaussians.count == begin.count
    assert len(np.unique(runs[0].source)) < begin.count, "some have moved"
    assert psnr_db(runs[0].gaussians, targets) > psnr_db(begin, targets) + 3
    for name in FIELDS:
        assert getattr(runs[0].gaussians, name).tobytes() == getattr(runs[1].gaussians, name).tobytes()
