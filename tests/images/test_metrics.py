# SPDX-License-Identifier: Apache-2.0
"""Picture measures against scikit-image, torchmetrics and planted errors."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from studiorecon.images import metrics
from studiorecon.images.channels import channel_max, channel_sum
from studiorecon.images.flow import is_flow_consistent
from studiorecon.images.temporal import forward_backward_consistent
from studiorecon.images.warp import warp

SCORE_SIZES = [(61, 83), (11, 11), (12, 300), (200, 13)]


def pairs(wh: tuple[int, int] = (61, 83)) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Random and adversarial pairs of uint8 pictures."""
    rng = np.random.default_rng(0)
    truth = rng.integers(0, 256, (*wh, 3), dtype=np.uint8)
    noisy = np.clip(truth + rng.normal(0, 25, truth.shape), 0, 255).astype(np.uint8)
    board = np.broadcast_to((np.indices(wh).sum(axis=0) % 2 * 255)[..., None], truth.shape).astype(np.uint8)
    one = np.zeros_like(truth)
    one[wh[0] // 2, wh[1] // 2] = 255
    return {
        "noise": (noisy, truth),
        "negative": (255 - truth, truth),
        "black and white": (np.zeros_like(truth), np.full_like(truth, 255)),
        "flat, one level off": (np.full_like(truth, 77), np.full_like(truth, 76)),
        "chessboard moved by one": (255 - board, board),
        "one white pixel": (one, np.zeros_like(truth)),
        "dark": (noisy // 16, truth // 16),
    }


@pytest.fixture(params=list(pairs()))
def pair(request: pytest.FixtureRequest) -> tuple[np.ndarray, np.ndarray]:
    return pairs()[request.param]


def test_psnr_equals_scikit_image_and_torchmetrics(pair: tuple[np.ndarray, np.ndarray]) -> None:
    from torchmetrics.functional.image import peak_signal_noise_ratio as torch_psnr

    prediction, truth = pair
    assert metrics.psnr(prediction, truth) == pytest.approx(
        peak_signal_noise_ratio(truth, prediction, data_range=255), abs=1e-4
    )
    tensors = (torch.from_numpy(p / 255) for p in pair)
    assert metrics.psnr(prediction, truth) == pytest.approx(float(torch_psnr(*tensors, data_range=1.0)), abs=1e-4)


@pytest.mark.parametrize("size", SCORE_SIZES)
def test_ssim_equals_scikit_image(size: tuple[int, int]) -> None:
    for prediction, truth in pairs(size).values():
        expected = structural_similarity(
            prediction / 255,
            truth / 255,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
            data_range=1,
            channel_axis=2,
        )
        assert metrics.ssim(metrics.ssim_map(prediction, truth)) == pytest.approx(expected, abs=1e-9)


def test_zero_padded_ssim_is_that_of_pictures_in_a_black_frame(pair: tuple[np.ndarray, np.ndarray]) -> None:
    similarity = metrics.ssim_map(*pair)
    framed = metrics.ssim_map(*(np.pad(p, ((5, 5), (5, 5), (0, 0))) for p in pair))[5:-5, 5:-5]
    np.testing.assert_allclose(similarity, framed, atol=1e-12)
    tensors = [torch.from_numpy(p / 255).permute(2, 0, 1)[None] for p in pair]
    np.testing.assert_allclose(metrics.ssim_3dgs(similarity), _lineage(*tensors), atol=1e-9)


def _lineage(first: torch.Tensor, second: torch.Tensor) -> float:
    """SSIM as the 3DGS lineage defines it: zero-padded convolutions, mean over everything."""
    line = torch.exp(-((torch.arange(11, dtype=torch.float64) - 5) ** 2) / (2 * 1.5**2))
    window = torch.outer(line, line)
    window = (window / window.sum()).expand(3, 1, 11, 11)

    def blur(image: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.conv2d(image, window, padding=5, groups=3)

    a, b = blur(first), blur(second)
    va, vb, cov = blur(first * first) - a * a, blur(second * second) - b * b, blur(first * second) - a * b
    return float((((2 * a * b + 1e-4) * (2 * cov + 9e-4)) / ((a * a + b * b + 1e-4) * (va + vb + 9e-4))).mean())


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
    assert metrics.mean_inside(np.ones((40, 40)), mask) is None


def test_change_counts_only_valid_pixels_and_follows_the_flow() -> None:
    rng = np.random.default_rng(2)
    previous = rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)
    flow = rng.uniform(-3, 3, (48, 64, 2)).astype(np.float32)
    moved, inside = warp(previous.astype(np.float64), flow)
    current = np.clip(moved + 20, 0, 255).astype(np.uint8)
    absolute, square = metrics.change_maps(current, previous, flow, inside)
    expected = np.abs(current - moved) / 255
    # OpenCV reads at 1/32 of a pixel; ours is exact.
    np.testing.assert_allclose(absolute[inside], expected.mean(axis=-1)[inside], atol=0.03)
    assert metrics.mean_inside(absolute, inside) == pytest.approx(expected[inside].mean(), abs=5e-4)
    assert np.isnan(absolute[~inside]).all()
    assert (square[inside] >= absolute[inside] ** 2 - 1e-12).all()


def test_where_a_flow_leads_back_is_the_published_rule() -> None:
    rng = np.random.default_rng(3)
    flow = cv2.GaussianBlur(rng.normal(0, 30, (60, 80, 2)).astype(np.float32), (0, 0), 4)
    reverse = -flow + rng.normal(0, 0.4, flow.shape).astype(np.float32)
    flow[5, 5], reverse[20, 20] = np.nan, np.inf
    back, inside = warp(np.nan_to_num(reverse, posinf=1e6), flow)
    safe = np.where(inside[..., None], flow, 0)
    motion = (safe**2).sum(axis=-1) + (back**2).sum(axis=-1)
    expected = inside & (((safe + back) ** 2).sum(axis=-1) < 0.01 * motion + 0.5)
    ours = forward_backward_consistent(flow, reverse)
    np.testing.assert_array_equal(ours, is_flow_consistent(flow, reverse))
    assert 0.2 < ours.mean() < 0.95
    assert (ours != expected).mean() < 0.01, "OpenCV reads the reverse flow at 1/32 of a pixel"
    assert not ours[5, 5]


# ---- Sums and maxima over channels are numpy's own, to the bit ----


@pytest.mark.parametrize("shape", [(37, 53, 3), (5, 2), (2, 3, 4, 7), (0, 4, 3)])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_numpys_own_reductions_to_the_bit(shape: tuple[int, ...], kind: type) -> None:
    rng = np.random.default_rng(0)
    picture = (rng.normal(size=shape) * 10.0 ** rng.integers(-6, 6, shape)).astype(kind)
    if picture.size:
        picture.flat[0], picture.flat[-1] = np.nan, -np.inf
    assert channel_sum(picture).tobytes() == picture.sum(axis=-1).tobytes()
    assert channel_max(picture).tobytes() == picture.max(axis=-1).tobytes()
