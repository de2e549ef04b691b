# SPDX-License-Identifier: Apache-2.0
"""Holes are closed with what a surface shows elsewhere: patterns go on in step, light without a seam."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from studiorecon.images.texture_fill import Scale, fill_by_texture

SCALE = Scale(light=12.0, patch=9, shift=4)


def wallpaper(hw: tuple[int, int] = (80, 120), light: float = 0.0) -> np.ndarray:
    """Stripes of 11 and dots of 13 pixels, brighter to the right by ``light``."""
    rows, columns = np.mgrid[: hw[0], : hw[1]]
    stripes = np.where(columns % 11 < 5, 0.65, 0.35)
    dots = 0.1 * ((rows % 13 < 3) & (columns % 11 == 2))
    shade = light * (columns / hw[1] - 0.5)
    return np.stack([stripes + dots, 0.8 * stripes, 0.5 * stripes + 0.2], axis=-1) + shade[..., None]


def hole(hw: tuple[int, int]) -> np.ndarray:
    known = np.ones(hw, bool)
    known[30:62, 40:82] = False
    return known


@pytest.mark.parametrize("light", [0.0, 0.3])
def test_wallpaper_goes_on_in_step(light: float) -> None:
    truth = wallpaper(light=light)
    known = hole(truth.shape[:2])
    given = np.where(known[..., None], truth, 0.9)
    ours = fill_by_texture(given, known, SCALE, np.random.default_rng(0))
    assert np.array_equal(ours[known], truth[known])
    error = np.abs(ours - truth)[~known].mean()
    stamp = np.rint(np.clip(given, 0, 1) * 255).astype(np.uint8)
    telea = cv2.inpaint(stamp, (~known).astype(np.uint8), 5, cv2.INPAINT_TELEA) / 255
    assert error < 0.25 * np.abs(telea - truth)[~known].mean()
    assert error < 0.02


def test_boards_without_a_pattern_stay_as_rough_as_they_are() -> None:
    rng = np.random.default_rng(1)
    boards = np.repeat(np.repeat(rng.uniform(0.3, 0.7, (20, 12)), 4, axis=0), 10, axis=1)
    truth = boards[..., None] * np.array([1.0, 0.8, 0.6])
    known = hole(truth.shape[:2])
    ours = fill_by_texture(truth, known, SCALE, np.random.default_rng(0))
    assert ours[~known].std(axis=0) == pytest.approx(truth[known].std(axis=0), rel=0.4)


def test_what_hangs_beside_a_hole_lends_it_no_light() -> None:
    truth = wallpaper()
    known = hole(truth.shape[:2])
    truth[30:62, 30:40] = [0.05, 0.02, 0.0]  # a cupboard's dark side, seen
    ours = fill_by_texture(truth, known, SCALE, np.random.default_rng(0))
    assert np.abs(ours - wallpaper())[~known].mean() < 0.05


def test_too_little_tells_no_shift_but_gives_a_colour() -> None:
    rgb, known = np.zeros((20, 30, 3)), np.zeros((20, 30), bool)
    rgb[3, 4], known[3, 4] = [0.2, 0.4, 0.6], True
    ours = fill_by_texture(rgb, known, SCALE, np.random.default_rng(0))
    np.testing.assert_allclose(ours, np.broadcast_to([0.2, 0.4, 0.6], ours.shape), atol=1e-9)


def test_nothing_known_is_refused() -> None:
    with pytest.raises(ValueError, match="no pixel is known"):
        fill_by_texture(np.zeros((9, 9, 3)), np.zeros((9, 9), bool), SCALE, np.random.default_rng(0))
