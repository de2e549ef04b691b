# SPDX-License-Identifier: Apache-2.0
"""Difix3D+ with a reference photo (Wu et al., CVPR 2025): one denoising step on a render, and Fixer, its successor under a freer licence.

Difix floors sizes to multiples of 8 and wants the reference at the picture's size; its VAE samples, so every picture gets a generator of
its own and the same picture the same result. Fixer works at 576×1024 and takes no reference.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.models.preflight import attribute, device, finite, staged, upstream
from studiorecon.models.protocols import Moment
from studiorecon.models.sizes import as_float, grown, resampled

PROMPT = "remove degradation"
STEP = 199
"""The paper's τ = 200 counted from zero."""
MULTIPLE_PX = 8
FIXER_HW, FIXER_STEP = (576, 1024), 250
_LOWER = "set enhance.enhancer to residual"
# A gap in brightness between a picture and its repair beyond which the network has failed (half precision overflows to black or white).
_LARGEST_SHIFT = 0.25


def pre(image: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two (1, 3, h, w) float32 tensors in [0, 1], sides multiples of 8, of a render (H, W, 3) and a photo of any size."""
    picture, photo = as_float(image), as_float(reference)
    photo = resampled(photo, picture.shape[:2])
    return tuple(np.ascontiguousarray(grown(p, MULTIPLE_PX).transpose(2, 0, 1)[None]) for p in (picture, photo))


def post(made: np.ndarray, image: np.ndarray, name: str = "difix") -> np.ndarray:
    """(H, W, 3) float32 picture in [0, 1] from the network's (1, 3, h, w); Refusal when it made nothing of the picture."""
    height, width = image.shape[:2]
    if made.ndim != 4 or made.shape[:2] != (1, 3) or made.shape[2] < height or made.shape[3] < width:
        raise Refusal(f"the enhancer {name} returned shape {made.shape}, expected (1, 3, ≥ {height}, ≥ {width}); use upstream at its pin")
    picture = np.clip(finite(name, "a picture", made[0, :, :height, :width]), 0, 1).transpose(1, 2, 0).astype(np.float32)
    shift = abs(float(picture.mean()) - float(as_float(image).mean()))
    if shift > _LARGEST_SHIFT:
        raise Refusal(f"the enhancer {name} changed a picture's brightness by {shift:.2f}: it failed there; run it in full precision")
    return np.ascontiguousarray(picture)


class Difix:
    """The pipeline ``difix_ref``, loaded once; satisfies ``Enhancer``. Weights: ``difix/difix_ref/`` below ``weights``."""

    def __init__(self, weights: Path, seed: int, where: str = "cuda") -> None:
        folder = staged("difix", weights) / "difix/difix_ref"
        pipeline = attribute("difix", upstream("difix", "pipeline_difix"), "DifixPipeline")
        import torch

        self._device, self._seed = device("difix", where, _LOWER), seed
        kind = torch.float16 if self._device.type == "cuda" else torch.float32
        self._pipeline = pipeline.from_pretrained(str(folder), trust_remote_code=True, torch_dtype=kind, local_files_only=True)
        self._pipeline.to(self._device)
        self._pipeline.set_progress_bar_config(disable=True)

    def enhance(self, image: np.ndarray, reference: np.ndarray, moment: Moment) -> np.ndarray:
        """See ``models.protocols.Enhancer``; the camera and the depth of ``moment`` are not used."""
        return post(denoised(self._pipeline, *pre(image, reference), self._seed, self._device), image)


def denoised(pipeline: Any, picture: np.ndarray, photo: np.ndarray, seed: int, where: Any) -> np.ndarray:
    """(1, 3, h, w) float32 from upstream's pipeline; the generator starts anew, so a picture's result does not depend on those before."""
    import torch

    made = pipeline(
        PROMPT,
        image=torch.from_numpy(picture).to(where),
        ref_image=torch.from_numpy(photo).to(where),
        num_inference_steps=1,
        timesteps=[STEP],
        guidance_scale=0.0,
        generator=torch.Generator(device=where).manual_seed(seed),
        output_type="pt",
    )
    return made.images.float().cpu().numpy()


def pre_fixer(image: np.ndarray) -> tuple[np.ndarray, tuple[int, int]]:
    """(1, 3, 576, 1024) float32 in [-1, 1] of a picture scaled to fit, its border repeated beside it, and its size (h, w) there."""
    picture = as_float(image)
    scale = min(side / own for side, own in zip(FIXER_HW, picture.shape[:2]))
    taken = tuple(min(round(own * scale), side) for side, own in zip(FIXER_HW, picture.shape[:2]))
    inside = resampled(picture, taken)
    full = np.pad(inside, ((0, FIXER_HW[0] - taken[0]), (0, FIXER_HW[1] - taken[1]), (0, 0)), mode="edge")
    return np.ascontiguousarray(full.transpose(2, 0, 1)[None]) * 2 - 1, taken


def post_fixer(made: np.ndarray, taken: tuple[int, int], image: np.ndarray) -> np.ndarray:
    """(H, W, 3) float32 picture in [0, 1] from Fixer's (1, 3, 576, 1024) in [-1, 1]."""
    if made.shape != (1, 3, *FIXER_HW):
        raise Refusal(f"Fixer returned shape {made.shape}, expected {(1, 3, *FIXER_HW)}; use upstream at its pin")
    inside = np.clip((finite("fixer", "a picture", made)[0, :, : taken[0], : taken[1]] + 1) / 2, 0, 1).transpose(1, 2, 0)
    return post(resampled(inside, image.shape[:2]).transpose(2, 0, 1)[None], image, "fixer")


class Fixer:
    """Fixer, loaded once; satisfies ``Enhancer`` and ignores the reference. Weights: ``fixer/`` below ``weights``."""

    def __init__(self, weights: Path, where: str = "cuda") -> None:
        folder = staged("fixer", weights) / "fixer"
        module = upstream("fixer", "pix2pix_turbo_nocond_cosmos_base_faster_tokenizer")
        self._device = device("fixer", where, _LOWER)
        import torch

        # Upstream has the places of its base model in a module's constant; there is no argument for them.
        config = attribute("fixer", module, "config")
        config.dit_path = str(folder / "base/model_fast_tokenizer.pt")
        config.tokenizer["vae_pth"] = str(folder / "base/tokenizer_fast.pth")
        network = attribute("fixer", module, "Pix2Pix_Turbo")
        self._model = network(
            pretrained_path=str(folder / "pretrained/pretrained_fixer.pkl"), timestep=FIXER_STEP, vae_skip_connection=False, batch_size=1
        ).to(device=self._device, dtype=torch.bfloat16)

    def enhance(self, image: np.ndarray, reference: np.ndarray, moment: Moment) -> np.ndarray:
        """See ``models.protocols.Enhancer``."""
        import torch

        tensor, taken = pre_fixer(image)
        with torch.no_grad(), torch.autocast(device_type=self._device.type, dtype=torch.bfloat16):
            made = self._model(torch.from_numpy(tensor).to(self._device, torch.bfloat16))
        return post_fixer(made.float().cpu().numpy(), taken, image)
