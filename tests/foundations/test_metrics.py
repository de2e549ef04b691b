# SPDX-License-Identifier: Apache-2.0
"""Picture measures against scikit-image and against planted errors."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from studiorecon.images import metrics


@pytest.fixture
def pair() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    truth = rng.random((61, 83, 3))
    return np.clip(truth + rng.normal(0, 0.1, truth.shape), 0, 1), truth


def test_psnr_equals_scikit_image(pair: tuple[np.ndarray, np.ndarray]) -> None:
    prediction, truth = (metrics.levels(p) for p in pair)
    assert metrics.psnr(*pair) == pytest.approx(peak_signal_noise_ratio(truth, prediction, data_range=1), abs=1e-4)


def test_ssim_equals_scikit_image(pair: tuple[np.ndarray, np.ndarray]) -> None:
    prediction, truth = (metrics.levels(p) for p in pair)
    expected = structural_similarity(
        prediction, truth, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1, channel_axis=2
    )
    assert metrics.ssim(metrics.ssim_map(*pair)) == pytest.approx(expected, abs=1e-5)


def test_zero_padded_ssim_differs_from_the_valid_one_near_the_border_only(pair: tuple[np.ndarray, np.ndarray]) -> None:
    similarity = metrics.ssim_map(*pair)
    from_zero_padding = np.pad(metrics.levels(pair[0]), ((5, 5), (5, 5), (0, 0))), np.pad(metrics.levels(pair[1]), ((5, 5), (5, 5), (0, 0)))
    expected = metrics.ssim_map(*from_zero_padding)[5:-5, 5:-5]
    np.testing.assert_allclose(similarity, expected, atol=1e-12)
    assert metrics.ssim_3dgs(similarity) != pytest.approx(metrics.ssim(similarity), abs=1e-4)


def test_masked_psnr_divides_by_the_mask_and_not_by_the_picture() -> None:
    truth = np.full((100, 100, 3), 0.4)
    mask = np.zeros((100, 100), bool)
    mask[:20, :25] = True
    prediction = truth + np.where(mask, 0.2, 0)[..., None]
    assert metrics.psnr(prediction, truth, mask) == pytest.approx(-20 * np.log10(0.2), abs=1e-9)
    assert metrics.psnr(prediction, truth, ~mask) == metrics.PSNR_CAP_DB
    assert metrics.psnr(prediction, truth) > metrics.psnr(prediction, truth, mask) + 12


def test_a_mask_too_small_is_not_measured() -> None:
    picture = np.zeros((40, 40, 3))
    mask = np.zeros((40, 40), bool)
    mask[:15, :17] = True
    assert metrics.psnr(picture, picture, mask) is None
    assert metrics.ssim(metrics.ssim_map(picture, picture), mask) is None
    assert metrics.ssim(metrics.ssim_map(picture[:10], picture[:10])) is None
    assert metrics.warp_error(picture, picture, mask) is None


def test_warp_error_counts_only_valid_pixels() -> None:
    current, previous = np.full((32, 32, 3), 0.6), np.full((32, 32, 3), 0.4)
    valid = np.zeros((32, 32), bool)
    valid[:16] = True
    previous[16:] = np.nan
    mean_absolute, mean_square = metrics.warp_error(current, previous, valid)
    assert (mean_absolute, mean_square) == pytest.approx((0.2, 0.04), abs=1e-9)
