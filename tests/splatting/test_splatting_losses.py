# SPDX-License-Identifier: Apache-2.0
"""Losses against float64 autograd and against scikit-image; masks that leave no trace."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.splatting.train.perceptual import PerceptualSettings
from studiorecon.splatting.train.schedule import TrainingSettings
from studiorecon.splatting.train.targets import Target
from studiorecon.splatting.train.terms import Density, L1AndSsim, LpipsTerm, TensorView, active_terms

from tests.made.cameras import look_at
from tests.made.training import of_alpha, photometric

SIZES = [(40, 53), (33, 64), (7, 5)]


def pair(hw: tuple[int, int], seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rendering, noisy target, and weights of which 30 % are 0."""
    rng = np.random.default_rng(seed)
    rendered = rng.random((*hw, 3)).astype(np.float32)
    target = np.clip(rendered + rng.normal(0, 0.1, rendered.shape), 0, 1).astype(np.float32)
    weight = (rng.random(hw) < 0.7) * rng.uniform(0.5, 3, hw)
    return rendered, target, weight.astype(np.float32)


def autograd_photometric(
    rendered: np.ndarray, target: np.ndarray, weight: np.ndarray, l1: float, ssim: float
) -> tuple[float, np.ndarray]:
    import torch

    x = torch.tensor(rendered, dtype=torch.float64, requires_grad=True)
    y, w = torch.tensor(target, dtype=torch.float64), torch.tensor(weight, dtype=torch.float64)[..., None]
    filled = torch.where(w > 0, x, y).permute(2, 0, 1)[:, None]
    wanted = y.permute(2, 0, 1)[:, None]
    taps = torch.exp(-0.5 * ((torch.arange(11, dtype=torch.float64) - 5) / 1.5) ** 2)
    window = (taps[:, None] * taps / taps.sum() ** 2)[None, None]

    def blur(image):
        return torch.nn.functional.conv2d(image, window, padding=5)

    mx, my = blur(filled), blur(wanted)
    vx, vy, cov = blur(filled * filled) - mx * mx, blur(wanted * wanted) - my * my, blur(filled * wanted) - mx * my
    similarity = (2 * mx * my + 1e-4) * (2 * cov + 9e-4) / ((mx * mx + my * my + 1e-4) * (vx + vy + 9e-4))
    used = 3 * (w > 0).sum()
    loss = l1 * (w * (x - y).abs()).sum() / used + ssim * (w * (1 - similarity[:, 0].permute(1, 2, 0))).sum() / used
    loss.backward()
    return loss.item(), x.grad.numpy()


@pytest.mark.parametrize("hw", SIZES)
@pytest.mark.parametrize(("l1", "ssim"), [(0.7, 0.3), (1.0, 0.0), (0.0, 1.0)])
def test_photometric_loss_agrees_with_autograd(hw: tuple[int, int], l1: float, ssim: float) -> None:
    rendered, target, weight = pair(hw, 0)
    loss, gradient = photometric(rendered, target, weight, l1, ssim)
    expected, by_rendered = autograd_photometric(rendered, target, weight, l1, ssim)
    assert loss == pytest.approx(expected, abs=1e-6)
    assert np.linalg.norm(gradient - by_rendered) < 2e-6 * np.linalg.norm(by_rendered)


def test_the_papers_density_counts_masked_pixels_like_all_others() -> None:
    import torch

    hw = (20, 30)
    alpha = np.random.default_rng(7).random(hw).astype(np.float32)
    _, _, weight = pair(hw, 7)
    weight = np.where(weight > 0, np.float32(3), np.float32(0))
    assert (weight == 0).any()
    loss, gradient = of_alpha(Density(0.1, everywhere=True), alpha, weight)
    again, same = of_alpha(Density(0.1), alpha, None)
    assert loss == again != of_alpha(Density(0.1), alpha, weight)[0]
    np.testing.assert_array_equal(gradient, same)
    assert (gradient[weight == 0] != 0).any()
    of = Target(
        look_at("c", np.array([4.0, 0, 1]), [0, 0, 1]).resized(hw[::-1]), np.zeros((*hw, 3), np.float32), weight
    )
    seen = TensorView(
        of,
        0,
        np.random.default_rng(0),
        torch.zeros((*hw, 3)),
        torch.tensor(alpha),
        torch.zeros((3, *hw)),
        torch.tensor(weight),
        "view",
    )
    assert float(Density(0.1, everywhere=True).on_cuda(seen)) == pytest.approx(loss, rel=1e-5)


def test_the_paper_weighs_photometric_terms_alone() -> None:
    literal, plain = (
        active_terms(TrainingSettings(density=0.1, weighing=weighing, lpips=PerceptualSettings(weight=0.1)))
        for weighing in ("photometric", "picture")
    )
    assert [type(term) for term in literal] == [type(term) for term in plain] == [L1AndSsim, Density, LpipsTerm]
    assert (literal[1].everywhere, literal[2].weighed) == (True, True)
    assert (plain[1].everywhere, plain[2].weighed) == (False, False)


@pytest.mark.parametrize("hw", SIZES)
def test_density_prior_agrees_with_autograd(hw: tuple[int, int]) -> None:
    import torch

    alpha = np.random.default_rng(6).random(hw).astype(np.float32)
    _, _, weight = pair(hw, 6)
    loss, gradient = of_alpha(Density(0.1), alpha, weight)
    a, w = torch.tensor(alpha, dtype=torch.float64, requires_grad=True), torch.tensor(weight)
    prior = -torch.log(torch.exp(-a) + torch.exp(a - 1)) + np.log1p(np.exp(-1))
    expected = (w * 0.1 * prior).sum() / (w > 0).sum()
    expected.backward()
    assert loss == pytest.approx(expected.item(), abs=1e-6)
    assert np.linalg.norm(gradient - a.grad.numpy()) < 2e-6 * np.linalg.norm(a.grad.numpy())
