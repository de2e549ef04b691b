# SPDX-License-Identifier: Apache-2.0
"""Difix and Fixer: sizes there and back, what a pipeline is asked, and failures that are sentences."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.images.sizes import as_float, pad_to_multiple, resample, resample_nearest
from studiorecon.models.adapters import difix, fixer
from studiorecon.models.adapters.difix import PROMPT, STEP, denoise, postprocess, preprocess
from studiorecon.models.loading import load
from studiorecon.models.protocols import Moment
from studiorecon.scene.camera import Camera

from tests.made.networks import upstream_sources


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


def test_bytes_and_floats_are_one_picture() -> None:
    image = picture((32, 40))
    levels = np.rint(image * 255).astype(np.uint8)
    np.testing.assert_allclose(preprocess(levels, levels)[0], preprocess(image, image)[0], atol=0.5 / 255 + 1e-6)
    with pytest.raises(ValueError, match=r"expected \(H, W, 3\)"):
        as_float(np.zeros((4, 5)))


def test_the_pipeline_runs_one_reproducible_step() -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    requested = []

    def pipeline(prompt: str, **given: object) -> SimpleNamespace:
        requested.append((prompt, given))
        noise = torch.rand(given["image"].shape, generator=given["generator"])
        return SimpleNamespace(images=given["image"] + noise)

    tensor, photo = preprocess(picture((30, 40)), picture((30, 40)))
    first, second = (denoise(pipeline, tensor, photo, 3, "cpu") for _ in range(2))
    np.testing.assert_array_equal(first, second)
    prompt, given = requested[0]
    assert prompt == PROMPT
    assert given["timesteps"] == [STEP] == [199]
    assert (given["num_inference_steps"], given["guidance_scale"], given["output_type"]) == (1, 0.0, "pt")
    assert given["image"].shape == given["ref_image"].shape == (1, 3, 32, 40)


def test_difix_runs_on_a_gpu_in_a_range_that_does_not_overflow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    requested = {}

    class Pipeline:
        @staticmethod
        def from_pretrained(folder: str, **given: object) -> Pipeline:
            requested.update(given)
            return Pipeline()

        def to(self, where: object) -> None:
            requested["where"] = where

        def set_progress_bar_config(self, disable: bool) -> None: ...

    monkeypatch.setitem(
        sys.modules, "pipeline_difix", SimpleNamespace(DifixPipeline=Pipeline, __name__="pipeline_difix")
    )
    monkeypatch.setattr(difix, "torch_device", lambda *_: torch.device("cuda"))
    for file in difix.CARD.weights:
        (tmp_path / file.path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file.path).touch()
    difix.Difix(difix.CARD, tmp_path, "cuda", 0)
    # float16 ends at 65504, which activations of the decoder pass: the picture is black.
    assert requested["torch_dtype"] is torch.bfloat16
    assert (requested["local_files_only"], requested["where"].type) == (True, "cuda")


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
    with pytest.raises(UserError, match="returned a picture of"):
        postprocess(tensor[:, :, :8], image)
    broken = tensor.copy()
    broken[0, 0, 0, 0] = np.nan
    with pytest.raises(UserError, match="1 values of a picture that are no numbers"):
        postprocess(broken, image)
    with pytest.raises(UserError, match="brightness"):
        postprocess(np.zeros_like(tensor), image)


def test_nearest_and_grown_only_repeat_pixels() -> None:
    labels = np.arange(12).reshape(3, 4)
    np.testing.assert_array_equal(resample_nearest(labels, (6, 8)), labels.repeat(2, 0).repeat(2, 1))
    np.testing.assert_array_equal(resample_nearest(labels.repeat(3, 0).repeat(3, 1), (3, 4)), labels)
    assert pad_to_multiple(labels, 14).shape == (14, 14)
    assert (pad_to_multiple(labels, 14)[:3, 4:] == labels[:, -1:]).all()


@pytest.mark.parametrize("hw", [(45, 80), (33, 59), (180, 320), (61, 200), (90, 160)])
def test_resampling_is_that_of_torch_with_antialias(hw: tuple[int, int]) -> None:
    """Which is PIL's, and what the networks were trained on. kornia's blurs with a Gaussian first."""
    torch = pytest.importorskip("torch", reason="torch is not installed")
    noise = np.random.default_rng(0).random((90, 160, 3), dtype=np.float32)
    tensor = torch.from_numpy(np.ascontiguousarray(noise.transpose(2, 0, 1)[None]))
    theirs = torch.nn.functional.interpolate(tensor, hw, mode="bilinear", antialias=True)[0].numpy().transpose(1, 2, 0)
    np.testing.assert_allclose(resample(noise, hw), theirs, atol=1e-5)


# What the hub's folder brings beside the weights, in the form that the pipeline asks for: a VAE that keeps what its
# encoder made on the way down.
_VAE = """
from diffusers import AutoencoderKL as Plain


class AutoencoderKL(Plain):
    def encode(self, x, return_dict=True):
        self.encoder.current_down_blocks = []
        return super().encode(x, return_dict)

    def decode(self, z, return_dict=True, generator=None):
        return super().decode(z, return_dict)
"""


@pytest.mark.weights
@pytest.mark.filterwarnings("ignore")  # of diffusers and transformers as old as the pipeline asks for
def test_upstreams_pipeline_with_random_weights_repairs_a_picture_by_a_photo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Upstream's own pipeline and network of several views, small, from a folder as the hub's to a picture."""
    torch = pytest.importorskip("torch", reason="torch is not installed")
    diffusers = pytest.importorskip("diffusers", reason="diffusers is not installed")
    transformers = pytest.importorskip("transformers", reason="transformers is not installed")
    source = upstream_sources("nv-tlabs+Difix3D", "src")
    from mv_unet import UNet2DConditionModel

    folder = tmp_path / "difix/difix_ref"
    for name in ("vae", "unet", "tokenizer"):
        (folder / name).mkdir(parents=True)
    (folder / "vae/autoencoder_kl.py").write_text(_VAE)
    shutil.copy(source / "mv_unet.py", folder / "unet/mv_unet.py")
    torch.manual_seed(0)
    wide = {"block_out_channels": (32, 64), "norm_num_groups": 8}
    blocks = {
        "down_block_types": ("CrossAttnDownBlock2D", "DownBlock2D"),
        "up_block_types": ("UpBlock2D", "CrossAttnUpBlock2D"),
    }
    unet = UNet2DConditionModel(sample_size=64, cross_attention_dim=32, attention_head_dim=4, **wide, **blocks)
    unet.save_pretrained(folder / "unet")
    levels = {"down_block_types": ("DownEncoderBlock2D",) * 2, "up_block_types": ("UpDecoderBlock2D",) * 2}
    diffusers.AutoencoderKL(latent_channels=4, **wide, **levels).save_pretrained(folder / "vae")
    letters = [letter + end for letter in "abcdefghijklmnopqrstuvwxyz" for end in ("", "</w>")]
    words = ["<|startoftext|>", "<|endoftext|>", *letters]
    (folder / "tokenizer/vocab.json").write_text(json.dumps({word: k for k, word in enumerate(words)}))
    (folder / "tokenizer/merges.txt").write_text("#version: 0.2\n")
    vocabulary = folder / "tokenizer/vocab.json", folder / "tokenizer/merges.txt"
    transformers.CLIPTokenizer(*vocabulary, model_max_length=77).save_pretrained(folder / "tokenizer")
    text = transformers.CLIPTextConfig(
        vocab_size=len(words), hidden_size=32, intermediate_size=64, num_hidden_layers=1, num_attention_heads=4
    )
    transformers.CLIPTextModel(text).save_pretrained(folder / "text_encoder")
    diffusers.DDPMScheduler(clip_sample=False, steps_offset=1).save_pretrained(folder / "scheduler")
    parts = {
        "vae": ["autoencoder_kl", "AutoencoderKL"],
        "unet": ["mv_unet", "UNet2DConditionModel"],
        "scheduler": ["diffusers", "DDPMScheduler"],
        "tokenizer": ["transformers", "CLIPTokenizer"],
        "text_encoder": ["transformers", "CLIPTextModel"],
        **{name: [None, None] for name in ("safety_checker", "feature_extractor", "image_encoder")},
    }
    index = {"_class_name": "DifixPipeline", "requires_safety_checker": False, **parts}
    (folder / "model_index.json").write_text(json.dumps(index))
    monkeypatch.setattr(difix, "staged_weights", lambda _, where: where)  # these files are not what is published
    monkeypatch.setattr(difix, "_LARGEST_SHIFT", 1.0)  # weights that have learnt nothing make any picture
    enhancer = load("picture enhancer", "difix", tmp_path, "cpu", seed=0)
    render, photo = picture((70, 100)), picture((135, 240))[:, ::-1]
    nothing = np.zeros((70, 100), np.float32)
    moment = Moment(Camera("c", (100, 70), np.eye(3), np.eye(4)), 0.0, nothing, nothing)
    first, again = (enhancer.enhance(render, photo, moment) for _ in range(2))
    assert first.shape == (70, 100, 3)
    np.testing.assert_array_equal(first, again)
    # The photo is looked at: another one changes the picture.
    assert np.abs(enhancer.enhance(render, 1 - photo, moment) - first).max() > 1e-4
