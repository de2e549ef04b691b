# SPDX-License-Identifier: Apache-2.0
"""Reading images at fractional pixels: the identity is exact, directions are right, and what is not real says so."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.images.warp import sample, warp


@pytest.fixture
def picture() -> np.ndarray:
    return np.random.default_rng(0).random((23, 31, 3)).astype(np.float32)


@pytest.mark.parametrize("how", ["nearest", "linear", "cubic"], ids=lambda h: f"E07-{h}")
def test_identity_warp_is_the_image(picture: np.ndarray, how: str) -> None:
    # An align_corners grid read by the default sampler moves half a pixel; 30 such warps leave 0.43 of the contrast.
    warped = picture
    for _ in range(30):
        warped, valid = warp(warped, np.zeros((23, 31, 2)), how)
        assert valid.all()
    assert np.array_equal(warped, picture)


def test_e09_backward_flow_moves_the_image_back(picture: np.ndarray) -> None:
    moved = np.roll(picture, (2, 3), axis=(0, 1))
    flow = np.broadcast_to([3.0, 2.0], (23, 31, 2))
    back, valid = warp(moved, flow)
    assert np.abs(back - picture)[valid].max() < 1e-6
    assert valid.mean() == pytest.approx(21 * 28 / (23 * 31))


def test_e06_outside_is_the_border_and_not_valid(picture: np.ndarray) -> None:
    warped, valid = warp(picture, np.broadcast_to([40.0, 0.0], (23, 31, 2)))
    assert not valid.any()
    # linear reads at the last centre; zero padding would put black columns into the mean
    assert np.abs(warped - picture[:, -1:]).max() < 1e-6


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30], ids=lambda b: f"E13-{b}")
def test_coordinates_that_are_not_numbers_are_invalid(picture: np.ndarray, bad: float) -> None:
    flow = np.zeros((23, 31, 2))
    flow[4, 5] = bad
    warped, valid = warp(picture, flow)
    assert np.isfinite(warped).all()
    assert not valid[4, 5]
    assert valid.sum() == valid.size - 1


def test_linear_sampling_of_a_ramp_is_exact() -> None:
    columns, rows = np.meshgrid(np.arange(40) + 0.5, np.arange(30) + 0.5)
    ramp = (0.01 * columns + 0.02 * rows).astype(np.float32)
    pixels = np.random.default_rng(1).uniform([0.5, 0.5], [39.5, 29.5], (50, 20, 2))
    read, valid = sample(ramp, pixels)
    assert valid.all()
    # OpenCV interpolates at 1/32 of a pixel
    assert np.abs(read - (0.01 * pixels[..., 0] + 0.02 * pixels[..., 1])).max() < 0.03 / 32 + 1e-6


def test_nearest_sampling_takes_the_pixel_that_holds_the_point() -> None:
    image = np.arange(12.0).reshape(3, 4)
    read, valid = sample(image, np.array([[[0.0, 0.0], [1.0, 0.99], [3.99, 2.99], [4.0, 1.0], [4.1, 1.0]]]), "nearest")
    assert read[0, :3].tolist() == [0, 1, 11]
    assert valid[0].tolist() == [True, True, True, True, False]


@pytest.mark.parametrize("channels", [(), (3,)])
def test_a_long_list_of_points_is_read_like_a_short_one(channels: tuple[int, ...]) -> None:
    # OpenCV refuses maps of 32767 columns or more.
    rng = np.random.default_rng(1)
    image = rng.random((23, 31, *channels)).astype(np.float32)
    pixels = rng.uniform(0, 31, (1, 70001, 2))
    values, valid = sample(image, pixels)
    parts = [sample(image, pixels[:, i : i + 10000]) for i in range(0, 70001, 10000)]
    np.testing.assert_array_equal(values, np.concatenate([v for v, _ in parts], axis=1))
    np.testing.assert_array_equal(valid, np.concatenate([v for _, v in parts], axis=1))
