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

from tests.made.gaussians import camera, room
from tests.made.splatting_limits import NEAR_M, one


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
