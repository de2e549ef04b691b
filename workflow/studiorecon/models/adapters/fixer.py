# SPDX-License-Identifier: Apache-2.0
"""Fixer, the successor of Difix under a freer licence: one step on a render of 576×1024, without a reference photo."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.images.sizes import as_float, resample
from studiorecon.models.adapters import difix
from studiorecon.models.catalogue.card import HUB, Card, Memory, Runtime, Terms, WeightFile
from studiorecon.models.catalogue.preflight import (
    attribute,
    import_upstream,
    loading,
    other_version,
    require_finite,
    staged_weights,
    torch_device,
)
from studiorecon.models.protocols import Moment

if TYPE_CHECKING:
    from jaxtyping import Float, Num

CARD = Card(
    name="fixer",
    title="Fixer",
    kind="picture enhancer",
    terms=Terms(
        code="Apache-2.0",
        weights="NVIDIA Open Model License",
        commercial="with conditions",
        condition="clause on bypassing guardrails; trained on driving, no reference photo",
    ),
    weights=tuple(
        WeightFile(
            f"fixer/{name}", HUB, "nvidia/Fixer", remote=name, revision="ca20a25b55baa15dfc557db4c9b99168da8c2e14"
        )
        for name in ("pretrained/pretrained_fixer.pkl", "base/model_fast_tokenizer.pt", "base/tokenizer_fast.pth")
    ),
    # torch and packages compiled against it come from the base image: cosmos-predict2-container 1.2, as in upstream's
    # build.
    runtime=Runtime(image="fixer", python="3.12", torch=">=2.6", pins=("cosmos-predict2==1.0.9",), commit="b39dfca"),
    memory=Memory(16.0, "576×1024; our estimate"),
    tried="never",
    unchecked="NVIDIA's base image",
    instead="set enhance.enhancer to residual",
)
CARDS = (CARD,)

HW, STEP = (576, 1024), 250


def preprocess(image: Num[np.ndarray, "H W 3"]) -> tuple[Float[np.ndarray, "1 3 576 1024"], tuple[int, int]]:
    """Float32 in [-1, 1] of a picture scaled to fit and padded by its border, and its size (h, w) there."""
    picture = as_float(image)
    scale = min(side / own for side, own in zip(HW, picture.shape[:2]))
    taken = tuple(min(round(own * scale), side) for side, own in zip(HW, picture.shape[:2]))
    inside = resample(picture, taken)
    full = np.pad(inside, ((0, HW[0] - taken[0]), (0, HW[1] - taken[1]), (0, 0)), mode="edge")
    return np.ascontiguousarray(full.transpose(2, 0, 1)[None]) * 2 - 1, taken


def postprocess(
    made: Float[np.ndarray, "1 3 576 1024"], taken: tuple[int, int], image: Num[np.ndarray, "H W 3"]
) -> Float[np.ndarray, "H W 3"]:
    """Float32 picture in [0, 1] from Fixer's in [-1, 1]."""
    if made.shape != (1, 3, *HW):
        raise other_version(CARD, f"returned a picture of {made.shape}, expected {(1, 3, *HW)}")
    inside = np.clip((require_finite(CARD, "a picture", made)[0, :, : taken[0], : taken[1]] + 1) / 2, 0, 1).transpose(
        1, 2, 0
    )
    return difix.postprocess(resample(inside, image.shape[:2]).transpose(2, 0, 1)[None], image, CARD)


class Fixer:
    """Fixer, loaded once; satisfies ``Enhancer`` and ignores the reference. Weights: ``fixer/`` below ``weights``."""

    def __init__(self, card: Card, weights: Path, where: str, seed: int = 0) -> None:
        folder = staged_weights(card, weights) / "fixer"
        module = import_upstream(card, "pix2pix_turbo_nocond_cosmos_base_faster_tokenizer")
        self._device = torch_device(card, where)
        import torch

        # Upstream keeps the paths of its base model in a module's constant; there is no argument for them.
        config = attribute(card, module, "config")
        config.dit_path = str(folder / "base/model_fast_tokenizer.pt")
        config.tokenizer["vae_pth"] = str(folder / "base/tokenizer_fast.pth")
        network = attribute(card, module, "Pix2Pix_Turbo")
        with loading(card, folder):
            self._model = network(
                pretrained_path=str(folder / "pretrained/pretrained_fixer.pkl"),
                timestep=STEP,
                vae_skip_connection=False,
                batch_size=1,
            ).to(device=self._device, dtype=torch.bfloat16)

    def enhance(
        self, image: Float[np.ndarray, "H W 3"], reference: Num[np.ndarray, "h w 3"], moment: Moment
    ) -> Float[np.ndarray, "H W 3"]:
        """The repaired picture; see ``models.protocols.Enhancer``."""
        import torch

        tensor, taken = preprocess(image)
        with torch.no_grad(), torch.autocast(device_type=self._device.type, dtype=torch.bfloat16):
            made = self._model(torch.from_numpy(tensor).to(self._device, torch.bfloat16))
        return postprocess(made.float().cpu().numpy(), taken, image)


ADAPTER = Fixer
