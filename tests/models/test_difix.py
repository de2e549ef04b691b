# SPDX-License-Identifier: Apache-2.0
"""Difix and Fixer: sizes there and back, what a pipeline is asked, and failures that are sentences."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.images.sizes import as_float, grown, nearest, resampled
from studiorecon.models.adapters import difix, fixer
from studiorecon.models.adapters.difix import PROMPT, STEP, denoised, postprocess, preprocess


def picture(hw: tuple[int, int]) -> np.ndarray:
    v, u = (np.arange(size) / size for size in hw)
    return np.stack(np.broadcast_arrays(v[:, None], u, 0.5 + 0.3 * np.sin(6 * v[:, None] + 9 * u)), axis=-1).astype(
        np.float32
    )


@pytest.mark.parametrize("hw", [(70, 100), (64, 96), (704, 1280), (9, 17)])
def test_sizes_that_are_no_multiples_of_8_come_back_whole(hw: tuple[int, int]) -> None:
    image = picture(hw)
    tensor, photo = preprocess(image, picture((135, 240)))
    # Naive: upstream floors 70×100 to 64×96, and the picture loses its border.
    assert tensor.shape == photo.shape == (1, 3, *(-(-side // 8) * 8 for side in hw))
    np.testing.assert_array_equal(postprocess(tensor, image), image)


def test_the_reference_keeps_its_place_at_the_pictures_size() -> None:
    _, photo = preprocess(picture((64, 96)), picture((192, 288)))
    np.testing.assert_allclose(photo[0].transpose(1, 2, 0)[2:-2, 2:-2], picture((64, 96))[2:-2, 2:-2], atol=0.02)


def test_bytes_and_floats_are_one_picture() -> None:
    image = picture((32, 40))
    levels = np.rint(image * 255).astype(np.uint8)
    np.testing.assert_allclose(preprocess(levels, levels)[0], preprocess(image, image)[0], atol=0.5 / 255 + 1e-6)
    with pytest.raises(ValueError, match=r"expected \(H, W, 3\)"):
        as_float(np.zeros((4, 5)))


def test_the_pipeline_is_asked_for_one_reproducible_step() -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    asked = []

    def pipeline(prompt: str, **given: object) -> SimpleNamespace:
        asked.append((prompt, given))
        noise = torch.rand(given["image"].shape, generator=given["generator"])
        return SimpleNamespace(images=given["image"] + noise)

    tensor, photo = preprocess(picture((30, 40)), picture((30, 40)))
    first, second = (denoised(pipeline, tensor, photo, 3, "cpu") for _ in range(2))
    np.testing.assert_array_equal(first, second)
    prompt, given = asked[0]
    assert prompt == PROMPT
    assert given["timesteps"] == [STEP] == [199]
    assert (given["num_inference_steps"], given["guidance_scale"], given["output_type"]) == (1, 0.0, "pt")
    assert given["image"].shape == given["ref_image"].shape == (1, 3, 32, 40)


def test_difix_runs_on_a_gpu_in_a_range_that_does_not_overflow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    asked = {}

    class Pipeline:
        @staticmethod
        def from_pretrained(folder: str, **given: object) -> Pipeline:
            asked.update(given)
            return Pipeline()

        def to(self, where: object) -> None:
            asked["where"] = where

        def set_progress_bar_config(self, disable: bool) -> None: ...

    monkeypatch.setitem(
        sys.modules, "pipeline_difix", SimpleNamespace(DifixPipeline=Pipeline, __name__="pipeline_difix")
    )
    monkeypatch.setattr(difix, "device", lambda *_: torch.device("cuda"))
    for file in difix.CARD.weights:
        (tmp_path / file.path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file.path).touch()
    difix.Difix(difix.CARD, tmp_path, "cuda", 0)
    # float16 ends at 65504, which activations of the decoder pass: the picture is black.
    assert asked["torch_dtype"] is torch.bfloat16
    assert (asked["local_files_only"], asked["where"].type) == (True, "cuda")


@pytest.mark.parametrize("hw", [(176, 320), (90, 160), (720, 400)])
def test_fixers_letterbox_is_undone(hw: tuple[int, int]) -> None:
    image = picture(hw)
    tensor, taken = fixer.preprocess(image)
    assert tensor.shape == (1, 3, *fixer.HW)
    assert tensor.min() >= -1 - 1e-6
    assert abs(taken[0] / taken[1] - hw[0] / hw[1]) < 0.01
    assert np.abs(fixer.postprocess(tensor, taken, image) - image)[2:-2, 2:-2].max() < 0.02


def test_what_an_enhancer_gets_wrong_is_a_sentence() -> None:
    image = picture((16, 24))
    tensor, _ = preprocess(image, image)
    with pytest.raises(UserError, match="returned shape"):
        postprocess(tensor[:, :, :8], image)
    broken = tensor.copy()
    broken[0, 0, 0, 0] = np.nan
    with pytest.raises(UserError, match="1 values of a picture that are no numbers"):
        postprocess(broken, image)
    with pytest.raises(UserError, match="brightness"):
        postprocess(np.zeros_like(tensor), image)


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


@pytest.mark.parametrize("hw", [(45, 80), (33, 59), (180, 320), (61, 200), (90, 160)])
def test_resampling_is_that_of_torch_with_antialias(hw: tuple[int, int]) -> None:
    """Which is PIL's, and what the networks were trained on. kornia's blurs with a Gaussian first."""
    torch = pytest.importorskip("torch", reason="torch is not installed")
    noise = np.random.default_rng(0).random((90, 160, 3), dtype=np.float32)
    tensor = torch.from_numpy(np.ascontiguousarray(noise.transpose(2, 0, 1)[None]))
    theirs = torch.nn.functional.interpolate(tensor, hw, mode="bilinear", antialias=True)[0].numpy().transpose(1, 2, 0)
    np.testing.assert_allclose(resampled(noise, hw), theirs, atol=1e-5)
