# SPDX-License-Identifier: Apache-2.0
"""Difix and Fixer: sizes there and back, what a pipeline is asked, and failures that are sentences."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from studiorecon.errors import Refusal
from studiorecon.models.difix import FIXER_HW, PROMPT, STEP, denoised, post, post_fixer, pre, pre_fixer
from studiorecon.models.sizes import as_float, grown, nearest, resampled


def picture(hw: tuple[int, int]) -> np.ndarray:
    v, u = (np.arange(size) / size for size in hw)
    return np.stack(np.broadcast_arrays(v[:, None], u, 0.5 + 0.3 * np.sin(6 * v[:, None] + 9 * u)), axis=-1).astype(np.float32)


@pytest.mark.parametrize("hw", [(70, 100), (64, 96), (704, 1280), (9, 17)])
def test_sizes_that_are_no_multiples_of_8_come_back_whole(hw: tuple[int, int]) -> None:
    image = picture(hw)
    tensor, photo = pre(image, picture((135, 240)))
    # Naive: upstream floors 70×100 to 64×96, and the picture loses its border.
    assert tensor.shape == photo.shape == (1, 3, *(-(-side // 8) * 8 for side in hw))
    np.testing.assert_array_equal(post(tensor, image), image)


def test_the_reference_keeps_its_place_at_the_pictures_size() -> None:
    _, photo = pre(picture((64, 96)), picture((192, 288)))
    np.testing.assert_allclose(photo[0].transpose(1, 2, 0)[2:-2, 2:-2], picture((64, 96))[2:-2, 2:-2], atol=0.02)


def test_bytes_and_floats_are_one_picture() -> None:
    image = picture((32, 40))
    levels = np.rint(image * 255).astype(np.uint8)
    np.testing.assert_allclose(pre(levels, levels)[0], pre(image, image)[0], atol=0.5 / 255 + 1e-6)
    with pytest.raises(ValueError, match=r"expected \(H, W, 3\)"):
        as_float(np.zeros((4, 5)))


def test_the_pipeline_is_asked_for_one_reproducible_step() -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    asked = []

    def pipeline(prompt: str, **given: object) -> SimpleNamespace:
        asked.append((prompt, given))
        noise = torch.rand(given["image"].shape, generator=given["generator"])
        return SimpleNamespace(images=given["image"] + noise)

    tensor, photo = pre(picture((30, 40)), picture((30, 40)))
    first, second = (denoised(pipeline, tensor, photo, 3, "cpu") for _ in range(2))
    np.testing.assert_array_equal(first, second)
    prompt, given = asked[0]
    assert prompt == PROMPT
    assert given["timesteps"] == [STEP] == [199]
    assert (given["num_inference_steps"], given["guidance_scale"], given["output_type"]) == (1, 0.0, "pt")
    assert given["image"].shape == given["ref_image"].shape == (1, 3, 32, 40)


@pytest.mark.parametrize("hw", [(176, 320), (90, 160), (720, 400)])
def test_fixers_letterbox_is_undone(hw: tuple[int, int]) -> None:
    image = picture(hw)
    tensor, taken = pre_fixer(image)
    assert tensor.shape == (1, 3, *FIXER_HW)
    assert tensor.min() >= -1 - 1e-6
    assert abs(taken[0] / taken[1] - hw[0] / hw[1]) < 0.01
    assert np.abs(post_fixer(tensor, taken, image) - image)[2:-2, 2:-2].max() < 0.02


def test_what_an_enhancer_gets_wrong_is_a_sentence() -> None:
    image = picture((16, 24))
    tensor, _ = pre(image, image)
    with pytest.raises(Refusal, match="returned shape"):
        post(tensor[:, :, :8], image)
    broken = tensor.copy()
    broken[0, 0, 0, 0] = np.nan
    with pytest.raises(Refusal, match="1 values of a picture that are no numbers"):
        post(broken, image)
    with pytest.raises(Refusal, match="brightness"):
        post(np.zeros_like(tensor), image)


@pytest.mark.parametrize("factor", [0.5, 0.37, 1.0, 2.0, 3.3])
def test_resampling_keeps_borders_and_levels(factor: float) -> None:
    image = picture((60, 80))
    small = resampled(image, (round(60 * factor), round(80 * factor)))
    assert small.mean() == pytest.approx(image.mean(), abs=2e-3)
    rows = (np.arange(len(small)) + 0.5) / len(small)
    # Naive corner-aligned scaling is off by up to half a pixel at the borders.
    inner = slice(2, -2)
    np.testing.assert_allclose(small[inner, 0, 0], rows[inner] - 0.5 / 60, atol=1e-3)


def test_nearest_and_grown_only_repeat_pixels() -> None:
    labels = np.arange(12).reshape(3, 4)
    np.testing.assert_array_equal(nearest(labels, (6, 8)), labels.repeat(2, 0).repeat(2, 1))
    np.testing.assert_array_equal(nearest(labels.repeat(3, 0).repeat(3, 1), (3, 4)), labels)
    assert grown(labels, 14).shape == (14, 14)
    assert (grown(labels, 14)[:3, 4:] == labels[:, -1:]).all()
