# SPDX-License-Identifier: Apache-2.0
"""The perceptual term: its gradient, its normalisation, its files, and what a training loop makes of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.errors import Refusal
from studiorecon.models.lpips import FEATURES_FILE, HEADS_FILE, Lpips, normalised, read_lpips
from studiorecon.splatting.perceptual import PerceptualSettings, perceptual

from tests.foundations.splatting_vgg import random_weights

SETTINGS = PerceptualSettings(weight=0.1, every=4, crop_px=0, weights="")


def pictures(hw: tuple[int, int], seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.random((*hw, 3), np.float32), rng.random((*hw, 3), np.float32)


def test_equal_pictures_have_no_distance_and_no_gradient() -> None:
    import torch

    network = Lpips(*random_weights(torch.float32))
    rendered, _ = pictures((24, 32))
    distance, gradient = network(rendered, rendered)
    assert distance == 0
    assert not gradient.any()


def test_the_gradient_agrees_with_finite_differences() -> None:
    import torch

    network = Lpips(*random_weights(torch.float64))
    x, y = (torch.tensor(p.transpose(2, 0, 1)[None].astype(np.float64)) for p in pictures((16, 18)))
    rendered, target = pictures((16, 18))
    _, gradient = network(rendered, target)
    rng = np.random.default_rng(1)
    for _ in range(4):
        direction = torch.tensor(rng.normal(size=x.shape))
        step = 1e-6
        slope = (network.distance(x + step * direction, y) - network.distance(x - step * direction, y)).item() / (2 * step)
        assert (gradient.transpose(2, 0, 1)[None] * direction.numpy()).sum() == pytest.approx(slope, rel=1e-4)


# Naive, epsilon outside the root: a dead position gives 0/0 in the slope, NaN; float16 squares of 50 over 512 channels are infinite.
@pytest.mark.parametrize("level", [1e-25, 1e-4, 50.0, 0.0, 1e12], ids=lambda level: f"I06 features {level:g}")
def test_normalised_features_and_their_slope_are_finite(level: float) -> None:
    import torch

    features = torch.full((1, 512, 2, 3), level, dtype=torch.float32, requires_grad=True)
    unit = normalised(features)
    unit.sum().backward()
    assert torch.isfinite(unit).all()
    assert torch.isfinite(features.grad).all()
    if level >= 1e-4:
        assert unit.square().sum(dim=1).max().item() == pytest.approx(1.0, rel=1e-4)


def test_masked_pixels_neither_count_nor_disturb() -> None:
    import torch

    network = Lpips(*random_weights(torch.float32))
    rendered, target = pictures((32, 40))
    weight = np.ones((32, 40), np.float32)
    weight[:, 20:] = 0
    target[:, 30:] = np.nan
    other = rendered.copy()
    other[:, 20:] = 0.5
    first = perceptual(network, SETTINGS, rendered, target, weight, np.random.default_rng(0))
    second = perceptual(network, SETTINGS, other, target, weight, np.random.default_rng(0))
    assert first[0] == second[0] > 0
    np.testing.assert_array_equal(first[1], second[1])
    assert not first[1][:, 20:].any()
    assert np.isfinite(first[1]).all()


def test_a_crop_is_all_that_moves_and_rare_steps_weigh_more() -> None:
    import torch

    network = Lpips(*random_weights(torch.float32))
    rendered, target = pictures((48, 64))
    loss, gradient = perceptual(network, replace(SETTINGS, crop_px=24), rendered, target, None, np.random.default_rng(3))
    rows, columns = (np.flatnonzero(gradient.any(axis=(2, axis))) for axis in (1, 0))
    assert np.ptp(rows) == np.ptp(columns) == 23
    alone, _ = network(
        rendered[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], target[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    )
    assert loss == pytest.approx(0.1 * 4 * alone, rel=1e-5)
    small = perceptual(network, SETTINGS, *pictures((12, 40)), None, np.random.default_rng(0))
    assert small[0] == 0


def test_files_are_read_and_wrong_ones_are_named(tmp_path: Path) -> None:
    import torch

    features, heads = random_weights(torch.float32)
    with pytest.raises(Refusal, match=r"needs .*vgg16\.pth, which is missing"):
        read_lpips(tmp_path, 1)
    torch.save(features, tmp_path / FEATURES_FILE)
    with pytest.raises(Refusal, match=r"needs .*lpips_vgg\.pth, which is missing"):
        read_lpips(tmp_path, 1)
    (tmp_path / HEADS_FILE).write_bytes(b"not a state dict")
    with pytest.raises(Refusal, match=r"lpips_vgg\.pth is not a readable state dict"):
        read_lpips(tmp_path, 1)
    torch.save({**heads, "lin2.model.1.weight": torch.zeros(1, 7, 1, 1)}, tmp_path / HEADS_FILE)
    with pytest.raises(Refusal, match=r"lin2\.model\.1\.weight has shape"):
        read_lpips(tmp_path, 1)
    torch.save(heads, tmp_path / HEADS_FILE)
    pair = pictures((20, 24))
    assert read_lpips(tmp_path, 1)(*pair)[0] == Lpips(features, heads)(*pair)[0]
