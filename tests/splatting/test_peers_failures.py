# SPDX-License-Identifier: Apache-2.0
"""Failures that other rasterisers' issue trackers tell of (design, splats.md §9), as properties that ours must have.

Infinite scales, needles, depth ties, poisoned and degenerate Gaussians are in ``test_splatting``; compensation's
gradient in ``test_splat_numbers``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.splatting.cpu import tiles
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.train import state
from studiorecon.splatting.train.still import train_still as train
from studiorecon.splatting.train.targets import Target

from tests.made.gaussians import camera, camera_on_ring, hard, room
from tests.made.splatting_gradients import FIELDS, reference
from tests.made.splatting_limits import NEAR_M, one
from tests.made.splatting_settings import SETTINGS


# ROCm/gsplat 10 and 11, fvdb-core 708, LichtFeld-Studio 2185: a count of intersections beyond int32 is negative or
# wraps to a small one.
@pytest.mark.parametrize("per_cell", [1 << 30, (1 << 31) + 5, (1 << 32) - 1])
def test_pairs_are_counted_in_64_bits(per_cell: int) -> None:
    cursor, starts = np.full(2 * 3, per_cell, np.uint32), np.zeros(4, np.uint32)
    assert tiles.place_tiles(cursor, 2, starts) == 6 * per_cell


# XingtongGe/gsplat 6: tile ranges sized by the number of intersections: an image with fewer of them than tiles is read
# out of bounds.
def test_one_gaussian_on_a_thousand_tiles() -> None:
    view, rasteriser = camera(640, 400), Rasteriser(near_m=NEAR_M, threads=2)
    rendering = rasteriser.forward(one(log_scales=np.log(0.01)), view)
    assert 0 < rasteriser.pair_count < 5
    drawn = np.argwhere(rendering.alpha > 0)
    assert len(drawn) > 3
    assert (np.ptp(drawn, axis=0) < 32).all()


# gsplat 153 and 155: the backward pass left out the normalisation of quaternions.
@pytest.mark.parametrize("norm", [1e-3, 1.0, 50.0])
def test_quaternions_are_pulled_across_their_direction_and_in_proportion_to_their_norm(norm: float) -> None:
    scene, view = room(400, 3), camera(64, 48)
    by = np.random.default_rng(0).normal(size=(*view.hw, 3)).astype(np.float32)
    unit = scene.quaternions / np.linalg.norm(scene.quaternions, axis=1, keepdims=True)
    found = []
    for length in (1.0, norm):
        rasteriser = Rasteriser(near_m=NEAR_M, threads=1)
        rasteriser.forward(replace(scene, quaternions=np.float32(length) * unit), view)
        found.append(rasteriser.backward(by).quaternions.astype(np.float64))
    along = np.abs((found[1] * unit).sum(axis=1)).max() / np.abs(found[1]).max()
    assert along < 1e-5
    assert np.linalg.norm(found[1] * norm - found[0]) < 1e-4 * np.linalg.norm(found[0])


# gsplat 136 and OpenSplat: the off-diagonal term of the covariance's gradient was wrong or halved; kernel by kernel
# nobody noticed.
def test_a_single_tilted_ellipse_has_the_gradients_of_float64_autograd() -> None:
    view = camera(64, 48)
    tilted = one(
        means_m=[0.1, 0.05, 2.0],
        quaternions=[np.cos(0.4), 0.1, -0.2, np.sin(0.4)],
        log_scales=np.log([0.4, 0.05, 0.02]),
        logit_opacities=1.5,
    )
    by = np.random.default_rng(1).normal(size=(*view.hw, 5)).astype(np.float32)
    by[..., 4] = (
        0  # a lone Gaussian's expected depth does not depend on alpha: its gradient is a difference of equal numbers
    )
    rasteriser = Rasteriser(near_m=NEAR_M, threads=1)
    rasteriser.forward(tilted, view, (0.2, 0.5, 0.7))
    gradients, (_, wanted) = rasteriser.backward(by[..., :3], by[..., 3], by[..., 4]), reference(tilted, view, by)
    for name in FIELDS:
        assert np.linalg.norm(getattr(gradients, name) - wanted[name]) < 2e-5 * np.linalg.norm(wanted[name]), name


# gsplat 378: three sigma choose the tiles, and every pixel of a chosen tile is evaluated, so that the picture depends
# on where tiles lie.
@pytest.mark.parametrize("shift_px", [(5, 3), (-7, 11)])
def test_the_picture_does_not_depend_on_where_tiles_begin(shift_px: tuple[int, int]) -> None:
    scene, large = room(1500, 5), camera(128, 96)
    left, top = 16 + shift_px[0], 16 + shift_px[1]
    intrinsics = large.intrinsics.copy()
    intrinsics[:2, 2] -= left, top
    small = replace(large, wh=(80, 60), intrinsics=intrinsics)
    # What lies outside of a frame is linearised at its border.
    pixels, depth_m = small.project(scene.means_m.astype(np.float64))
    scene = scene.take((depth_m > 0) & (pixels > 0).all(axis=1) & (pixels < small.wh).all(axis=1))
    whole = Rasteriser(near_m=NEAR_M, threads=1).forward(scene, large).rgb
    part = Rasteriser(near_m=NEAR_M, threads=1).forward(scene, small).rgb
    np.testing.assert_allclose(part, whole[top : top + 60, left : left + 80], atol=2e-5)


# gsplat 248: gradients become NaN after some hundred steps although everything that went in was finite.
def test_three_hundred_steps_on_a_hard_scene_stay_finite() -> None:
    truth, rasteriser = hard(600, 1).with_sh_degree(1), Rasteriser(near_m=NEAR_M, threads=1)
    views = [camera_on_ring(i, 4, 64, 48) for i in range(4)]
    targets = [Target(view, rasteriser.forward(room(800, 4), view).rgb.clip(0, 1)) for view in views]
    trained = train(
        truth, targets, replace(SETTINGS, iterations=300), np.random.default_rng(0), extent_m=4.0, threads=1
    )
    assert trained.refused == trained.left_out == 0
    assert state.finite(trained.gaussians).all()
    assert trained.gaussians.count == truth.count
