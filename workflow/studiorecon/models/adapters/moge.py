# SPDX-License-Identifier: Apache-2.0
"""MoGe-2 (Wang et al. 2025): depth of one picture, roughly in metres, of an independent scale.

Outside its mask upstream returns +inf. It takes a known focal length as the horizontal field of view in degrees, and
assumes a centred principal point and square pixels.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.images.sizes import as_float
from studiorecon.models.catalogue.card import HUB, Card, Memory, Runtime, Terms, WeightFile
from studiorecon.models.catalogue.preflight import (
    attribute,
    failed,
    import_upstream,
    loading,
    other_version,
    staged_weights,
    torch_device,
)

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

MOGE = Card(
    name="moge",
    title="MoGe-2 (ViT-L, normals)",
    kind="monocular depth",
    terms=Terms(code="MIT, DINOv2 part Apache-2.0", weights="MIT", commercial="yes"),
    weights=(
        WeightFile(
            "moge/moge-2-vitl-normal.pt",
            HUB,
            "Ruicheng/moge-2-vitl-normal",
            1.32,
            "model.pt",
            revision="cb0e8bbd6b1e243589717c78e750b1ba4c093acf",
            sha256="280741fd09bc3f403ccff9967784c2a391b52d2c0742ae3efdb21d9f90cc1a01",
        ),
    ),
    runtime=Runtime(
        image="moge", python=">=3.10", torch=">=2.0", pins=("utils3d at the commit MoGe pins",), commit="0744441"
    ),
    memory=Memory(6.0, "one picture at a time, ViT-L in half precision; our estimate"),
    tried="random weights",
    unchecked="a GPU",
    instead="set depth.source to embedded",
)
CARDS = (MOGE,)


def preprocess(picture: Integer[np.ndarray, "H W 3"]) -> Float[np.ndarray, "3 H W"]:
    """Float32 RGB in [0, 1]; any size, upstream makes its own grid of tokens."""
    return np.ascontiguousarray(as_float(picture).transpose(2, 0, 1))


def fov_deg(focal_px: float, width: int) -> float:
    """Horizontal field of view in degrees of a pinhole with its principal point in the middle."""
    return float(np.degrees(2 * np.arctan(width / (2 * focal_px))))


def postprocess(
    depth: Float[np.ndarray, "H W"], mask: Bool[np.ndarray, "H W"], card: Card = MOGE
) -> Float[np.ndarray, "H W"]:
    """Float32 depth, 0 where it is infinite, not positive or outside the mask.

    Raises UserError when no depth remains or much is NaN.
    """
    if depth.shape != mask.shape or depth.ndim != 2:
        raise other_version(card, f"returned depth {depth.shape} and mask {mask.shape}")
    if nan := int(np.isnan(depth).sum()):
        raise failed(card, f"returned {nan} depths that are no numbers")
    known = np.isfinite(depth) & (depth > 0) & mask
    if not known.any():
        raise failed(card, "sees no surface in the whole picture")
    return np.where(known, depth, 0).astype(np.float32)


class Moge:
    """The network, loaded once; satisfies ``MonocularDepth``. Weights: ``moge/`` below ``weights``."""

    def __init__(self, card: Card, weights: Path, where: str) -> None:
        file = staged_weights(card, weights) / card.weights[0].path
        network = attribute(card, import_upstream(card, "moge.model.v2"), "MoGeModel")
        self._card, self._device = card, torch_device(card, where)
        with loading(card, file):
            self._network = network.from_pretrained(str(file)).to(self._device).eval()

    def depth(self, picture: Integer[np.ndarray, "H W 3"], focal_px: float | None) -> Float[np.ndarray, "H W"]:
        """Depth of one picture; see ``models.protocols.MonocularDepth``."""
        field = fov_deg(focal_px, picture.shape[1]) if focal_px else None
        return postprocess(*infer(self._network, preprocess(picture), field, self._device), self._card)


def infer(
    network: Any, picture: Float[np.ndarray, "3 H W"], field_deg: float | None, where: Any, **options: Any
) -> tuple[Float[np.ndarray, "H W"], Bool[np.ndarray, "H W"]]:
    """Depth, +inf outside the mask, and the mask, from upstream's ``infer``; half precision on a GPU only."""
    import torch

    with torch.inference_mode():
        half = torch.device(where).type == "cuda"
        made = network.infer(
            torch.from_numpy(picture).to(where), fov_x=field_deg, apply_mask=True, use_fp16=half, **options
        )
    mask = made["mask"] if "mask" in made else torch.isfinite(made["depth"])
    return made["depth"].float().cpu().numpy(), mask.bool().cpu().numpy()


ADAPTER = Moge
