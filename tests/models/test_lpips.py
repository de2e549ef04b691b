# SPDX-License-Identifier: Apache-2.0
"""The perceptual term: its gradient, its normalisation, its files, and what a training loop makes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.models.adapters.lpips import TRUNKS, Lpips, Net, normalise_features, read_lpips
from studiorecon.splatting.train.perceptual import PerceptualSettings, perceptual, perceptual_of_tensors

from tests.made.vgg import random_weights

VGG = TRUNKS["vgg"]
WHOLE = PerceptualSettings(weight=0.1, whole=True)
CROPS = PerceptualSettings(weight=0.1, crop_px=24)


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
        slope = (network.distance(x + step * direction, y) - network.distance(x - step * direction, y)).item() / (
            2 * step
        )
        assert (gradient.transpose(2, 0, 1)[None] * direction.numpy()).sum() == pytest.approx(slope, rel=1e-4)


# Naive, epsilon outside the root: a dead position gives 0/0 in the slope, NaN; float16 squares of 50 over 512 channels
# are infinite.
@pytest.mark.parametrize("level", [1e-25, 1e-4, 50.0, 0.0, 1e12], ids=lambda level: f"I06 features {level:g}")
def test_normalised_features_and_their_slope_are_finite(level: float) -> None:
    import torch

    features = torch.full((1, 512, 2, 3), level, dtype=torch.float32, requires_grad=True)
    unit = normalise_features(features)
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
    first = perceptual(network, WHOLE, rendered, target, weight, np.random.default_rng(0))
    second = perceptual(network, WHOLE, other, target, weight, np.random.default_rng(0))
    assert first[0] == second[0] > 0
    np.testing.assert_array_equal(first[1], second[1])
    assert not first[1][:, 20:].any()
    assert np.isfinite(first[1]).all()


def test_where_the_paper_weighs_it_a_photo_counts_as_often_as_its_pixels_do() -> None:
    import torch

    network = Lpips(*random_weights(torch.float32))
    rendered, target = pictures((32, 40))
    weight = np.full((32, 40), 3, np.float32)
    weight[:, 20:] = 0
    plain, weighed = (
        perceptual(network, WHOLE, rendered, target, weight, np.random.default_rng(0), weighed)
        for weighed in (False, True)
    )
    assert weighed[0] == pytest.approx(3 * plain[0], rel=1e-6)
    np.testing.assert_allclose(weighed[1], 3 * plain[1], rtol=1e-5)
    nothing = perceptual(network, WHOLE, rendered, target, 0 * weight, np.random.default_rng(0), True)
    assert nothing[0] == 0


@pytest.mark.parametrize("weighed", [False, True])
@pytest.mark.parametrize("settings", [WHOLE, CROPS], ids=["whole", "crops"])
def test_tensors_on_a_device_give_what_pictures_on_the_cpu_do(settings: PerceptualSettings, weighed: bool) -> None:
    import torch

    network = Lpips(*random_weights(torch.float32))
    rendered, target = pictures((40, 48))
    weight = np.where(np.arange(48) < 30, np.float32(3), np.float32(0)) * np.ones((40, 1), np.float32)
    target[:, 36:] = np.nan
    loss, gradient = perceptual(network, settings, rendered, target, weight, np.random.default_rng(2), weighed)
    moved = torch.tensor(rendered.transpose(2, 0, 1), requires_grad=True)
    wanted = torch.nan_to_num(torch.tensor(target.transpose(2, 0, 1)))
    found = perceptual_of_tensors(
        network, settings, moved, wanted, torch.tensor(weight), np.random.default_rng(2), weighed
    )
    found.backward()
    assert found.item() == pytest.approx(loss, rel=1e-5)
    np.testing.assert_allclose(moved.grad.numpy().transpose(1, 2, 0), gradient, atol=1e-5 * np.abs(gradient).max())


def test_a_crop_is_all_that_moves_and_rare_steps_weigh_more() -> None:
    import torch

    network = Lpips(*random_weights(torch.float32))
    rendered, target = pictures((48, 64))
    loss, gradient = perceptual(network, CROPS, rendered, target, None, np.random.default_rng(3))
    rows, columns = (np.flatnonzero(gradient.any(axis=(2, axis))) for axis in (1, 0))
    assert np.ptp(rows) == np.ptp(columns) == 23
    alone, _ = network(
        rendered[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1],
        target[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1],
    )
    assert loss == pytest.approx(0.1 * 4 * alone, rel=1e-5)
    small = perceptual(network, WHOLE, *pictures((12, 40)), None, np.random.default_rng(0))
    assert small[0] == 0


@pytest.mark.parametrize("net", ["alex", "vgg"])
def test_what_is_measured_is_what_is_trained_with(net: Net) -> None:
    import torch

    network = Lpips(*random_weights(torch.float32, net=net), net)
    rendered, target = (np.rint(255 * p).astype(np.uint8) for p in pictures((64, 70)))
    value = network.measure(rendered, target)
    assert value == pytest.approx(network(rendered / np.float32(255), target / np.float32(255))[0], rel=1e-5)
    assert network.measure(target, target) == 0
    assert network.measure(rendered[:63], target[:63]) is None
    with pytest.raises(ValueError, match="truth has shape"):
        network.measure(rendered, target[:, 1:])


def test_alexnet_is_cut_where_torchvisions_layers_end() -> None:
    """Features after the activations 1, 4, 7, 9 and 11 of ``alexnet().features``, written down here once more."""
    import torch
    from torch import nn

    features, heads = random_weights(torch.float32, net="alex")
    alexnet = nn.Sequential(
        nn.Conv2d(3, 64, 11, 4, 2),
        nn.ReLU(),
        nn.MaxPool2d(3, 2),
        nn.Conv2d(64, 192, 5, padding=2),
        nn.ReLU(),
        nn.MaxPool2d(3, 2),
        nn.Conv2d(192, 384, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(384, 256, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(256, 256, 3, padding=1),
        nn.ReLU(),
        nn.MaxPool2d(3, 2),
    )
    alexnet.load_state_dict({name.removeprefix("features."): value for name, value in features.items()})
    picture = 2 * pictures((65, 79))[0].transpose(2, 0, 1) - 1
    shift, scale = (torch.tensor(v)[:, None, None] for v in ([-0.030, -0.088, -0.188], [0.458, 0.448, 0.450]))
    x = (torch.from_numpy(picture) - shift) / scale
    expected = []
    with torch.no_grad():
        for index, layer in enumerate(alexnet):
            x = layer(x[None])[0]
            if index in (1, 4, 7, 9, 11):
                expected.append(x.numpy().copy())
    taken = Lpips(features, heads, "alex")._features(torch.from_numpy(picture)[None])
    layers = [layer[0].numpy() for layer in taken]
    assert [layer.shape for layer in layers] == [layer.shape for layer in expected]
    for ours, theirs in zip(layers, expected):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4)


def test_files_are_read_and_wrong_ones_are_named(tmp_path: Path) -> None:
    import torch

    features, heads = random_weights(torch.float32)
    with pytest.raises(UserError, match=r"needs .*vgg16\.pth, which is missing"):
        read_lpips(tmp_path, 1)
    torch.save(features, tmp_path / VGG.features_file)
    with pytest.raises(UserError, match=r"needs .*lpips_vgg\.pth, which is missing"):
        read_lpips(tmp_path, 1)
    (tmp_path / VGG.heads_file).write_bytes(b"not a state dict")
    with pytest.raises(UserError, match=r"lpips_vgg\.pth is not a readable state dict"):
        read_lpips(tmp_path, 1)
    torch.save({**heads, "lin2.model.1.weight": torch.zeros(1, 7, 1, 1)}, tmp_path / VGG.heads_file)
    with pytest.raises(UserError, match=r"lin2\.model\.1\.weight has shape"):
        read_lpips(tmp_path, 1)
    torch.save(heads, tmp_path / VGG.heads_file)
    pair = pictures((20, 24))
    assert read_lpips(tmp_path, 1)(*pair)[0] == Lpips(features, heads)(*pair)[0]
    with pytest.raises(UserError, match=r"needs .*alexnet\.pth, which is missing; put it there or leave it out"):
        read_lpips(tmp_path, 1, "alex", "leave it out")
    for name, values in zip((TRUNKS["alex"].features_file, TRUNKS["alex"].heads_file), (features, heads)):
        torch.save(values, tmp_path / name)
    with pytest.raises(
        UserError,
        match=r"alexnet\.pth and .* are not what LPIPS v0\.1 \(alex\) is made of: features\.0\.weight has shape",
    ):
        read_lpips(tmp_path, 1, "alex")
