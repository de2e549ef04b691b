# SPDX-License-Identifier: Apache-2.0
"""Difix3D+ with a reference photo (Wu et al., CVPR 2025): one denoising step on a render.

Difix rounds sizes down to multiples of 8 and needs the reference at the picture's size. Its VAE samples, so every
picture has its own generator: the same picture gives the same result.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.images.sizes import as_float, pad_to_multiple, resample
from studiorecon.models.catalogue.card import HUB, Card, Memory, Runtime, Terms, WeightFile
from studiorecon.models.catalogue.preflight import (
    attribute,
    failed,
    import_upstream,
    other_version,
    require_finite,
    staged_weights,
    torch_device,
)
from studiorecon.models.protocols import Moment

if TYPE_CHECKING:
    from jaxtyping import Float, Num

# Selects the whole repository, including code that the client runs.
_BRINGS_ALL = "model_index.json"

CARD = Card(
    name="difix",
    title="Difix3D+ (difix_ref)",
    kind="picture enhancer",
    terms=Terms(
        code="NVIDIA non-commercial",
        weights="NVIDIA non-commercial, SD-Turbo licence",
        commercial="no",
        condition="non-commercial code and weights",
        alternative="fixer",
    ),
    weights=tuple(
        WeightFile(
            f"difix/difix_ref/{name}",
            HUB,
            "nvidia/difix_ref",
            size_gb,
            name,
            how="snapshot" if name == _BRINGS_ALL else "hub",
            revision="d4830559772a5795c9d136302c5b197d6418d3fb",
        )
        for name, size_gb in (
            (_BRINGS_ALL, None),
            ("unet/diffusion_pytorch_model.safetensors", 3.46),
            ("vae/diffusion_pytorch_model.safetensors", 0.34),
            ("text_encoder/model.safetensors", None),
        )
    ),
    runtime=Runtime(
        image="difix",
        python=">=3.10",
        torch=">=2.0",
        pins=("diffusers==0.25.1", "transformers==4.38.0", "huggingface-hub==0.25.1", "peft==0.9.0", "numpy<2"),
        commit="c76edc5",
    ),
    memory=Memory(10.0, "1280×704 in half precision; our estimate"),
    tried="random weights",
    unchecked="the VAE's code on the hub; bfloat16",
    instead="set enhance.enhancer to residual",
)
CARDS = (CARD,)


PROMPT = "remove degradation"
STEP = 199
"""The paper's τ = 200 counted from zero."""
MULTIPLE_PX = 8
# Change of brightness beyond which the network has failed: half precision overflows to black or white.
_LARGEST_SHIFT = 0.25


def preprocess(
    image: Num[np.ndarray, "H W 3"], reference: Num[np.ndarray, "r c 3"]
) -> tuple[Float[np.ndarray, "1 3 h w"], Float[np.ndarray, "1 3 h w"]]:
    """Two float32 tensors in [0, 1], sides multiples of 8, of a render and a photo of any size."""
    picture, photo = as_float(image), as_float(reference)
    photo = resample(photo, picture.shape[:2])
    return _tensor(picture), _tensor(photo)


def _tensor(picture: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(pad_to_multiple(picture, MULTIPLE_PX).transpose(2, 0, 1)[None])


def postprocess(
    made: Float[np.ndarray, "1 3 h w"], image: Num[np.ndarray, "H W 3"], card: Card = CARD
) -> Float[np.ndarray, "H W 3"]:
    """Float32 picture in [0, 1] from the network's; raises UserError when the result is unusable."""
    height, width = image.shape[:2]
    if made.ndim != 4 or made.shape[:2] != (1, 3) or made.shape[2] < height or made.shape[3] < width:
        raise other_version(card, f"returned a picture of {made.shape}, expected (1, 3, ≥ {height}, ≥ {width})")
    picture = (
        np.clip(require_finite(card, "a picture", made[0, :, :height, :width]), 0, 1)
        .transpose(1, 2, 0)
        .astype(np.float32)
    )
    shift = abs(float(picture.mean()) - float(as_float(image).mean()))
    if shift > _LARGEST_SHIFT:
        raise failed(card, f"changed a picture's brightness by {shift:.2f}")
    return np.ascontiguousarray(picture)


class Difix:
    """The pipeline ``difix_ref``, loaded once; satisfies ``Enhancer``. Weights: ``difix/difix_ref/``."""

    def __init__(self, card: Card, weights: Path, where: str, seed: int) -> None:
        folder = staged_weights(card, weights) / "difix/difix_ref"
        pipeline = attribute(card, import_upstream(card, "pipeline_difix"), "DifixPipeline")
        import torch

        self._device, self._seed = torch_device(card, where), seed
        # Upstream trains in bfloat16 and shows float32; float16 overflows to black pictures.
        kind = torch.bfloat16 if self._device.type == "cuda" else torch.float32
        self._pipeline = pipeline.from_pretrained(
            str(folder), trust_remote_code=True, torch_dtype=kind, local_files_only=True
        )
        self._pipeline.to(self._device)
        self._pipeline.set_progress_bar_config(disable=True)

    def enhance(
        self, image: Float[np.ndarray, "H W 3"], reference: Num[np.ndarray, "h w 3"], moment: Moment
    ) -> Float[np.ndarray, "H W 3"]:
        """The repaired picture; see ``models.protocols.Enhancer``. Camera and depth of ``moment`` are not used."""
        return postprocess(denoise(self._pipeline, *preprocess(image, reference), self._seed, self._device), image)


def denoise(
    pipeline: Any, picture: Float[np.ndarray, "1 3 h w"], photo: Float[np.ndarray, "1 3 h w"], seed: int, where: Any
) -> Float[np.ndarray, "1 3 h w"]:
    """Float32 from upstream's pipeline; the generator restarts, so that earlier pictures have no influence."""
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


ADAPTER = Difix
