# SPDX-License-Identifier: Apache-2.0
"""RAFT (Teed & Deng 2020) from torchvision: pictures at suitable sizes, and flow at the pictures' own size."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.models.catalogue.card import Card, Memory, Runtime, Terms, WeightFile
from studiorecon.models.catalogue.preflight import (
    attribute,
    import_upstream,
    loading,
    require_finite,
    staged_weights,
    torch_device,
)

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

CARD = Card(
    name="raft",
    title="RAFT large (torchvision)",
    kind="flow",
    terms=Terms(code="BSD-3-Clause", weights="BSD-3-Clause, trained on research data", commercial="yes"),
    weights=(
        WeightFile(
            "raft/raft_large_C_T_SKHT_V2.pth",
            "PyTorch model downloads, raft_large_C_T_SKHT_V2-ff5fadd5.pth",
            size_gb=0.02,
            remote="torchvision.models.optical_flow:Raft_Large_Weights.C_T_SKHT_V2",
            how="torchvision",
            sha256="ff5fadd5",
        ),
    ),
    runtime=Runtime(image="vision", python=">=3.10", torch=">=2.4", pins=("torchvision",), commit="torchvision 0.29.2"),
    memory=Memory(None, "runs on a CPU; on a GPU 1 GB at 1280×704, 5.6 GB at 1920×1080"),
    tried="random weights",
    unchecked="a GPU",
    instead="set enhance.flow to dis",
)
CARDS = (CARD,)


# The correlation pyramid halves an eighth-size feature map three times: below 128 px its top is one value, and the
# lookup divides by its size minus one (E12).
SMALLEST_PX = 128
# The encoder's stride.
MULTIPLE_PX = 8


@dataclass(frozen=True)
class Fitted:
    """The padding of pictures: their size (H, W), the integer enlargement, rows and columns added before them."""

    hw: tuple[int, int]
    enlarged: int
    before: tuple[int, int]


def preprocess(
    first: Integer[np.ndarray, "H W 3"], second: Integer[np.ndarray, "H W 3"]
) -> tuple[Float[np.ndarray, "2 3 h w"], Fitted]:
    """Float32 in [-1, 1] for the network from two uint8 RGB pictures, and the padding to undo.

    Pictures under 128 px a side are enlarged by an integer factor, by repeating pixels; then borders are repeated on
    both sides up to multiples of 8, as the authors do. Raises ValueError for pictures that differ in shape, are not
    RGB, not uint8 or empty.
    """
    if first.shape != second.shape or first.ndim != 3 or first.shape[2] != 3 or first.size == 0:
        raise ValueError(f"first and second have shapes {first.shape} and {second.shape}, expected one shape (H, W, 3)")
    if first.dtype != np.uint8 or second.dtype != np.uint8:
        raise ValueError(f"first and second are {first.dtype} and {second.dtype}, expected uint8")
    height, width = first.shape[:2]
    enlarged = -(-SMALLEST_PX // min(height, width)) if min(height, width) < SMALLEST_PX else 1
    missing = [-(side * enlarged) % MULTIPLE_PX for side in (height, width)]
    before = (missing[0] // 2, missing[1] // 2)
    pair = np.stack([first, second]).repeat(enlarged, axis=1).repeat(enlarged, axis=2)
    pair = np.pad(pair, ((0, 0), *((b, m - b) for b, m in zip(before, missing)), (0, 0)), mode="edge")
    return np.ascontiguousarray(pair.transpose(0, 3, 1, 2).astype(np.float32) / 127.5 - 1), Fitted(
        (height, width), enlarged, before
    )


def postprocess(flow: Float[np.ndarray, "2 h w"], fitted: Fitted) -> Float[np.ndarray, "H W 2"]:
    """Float32 flow in pixels of the pictures from the network's: cropped, averaged over enlarged pixels, rescaled.

    Raises ValueError when the flow is smaller than the result of ``preprocess``.
    """
    height, width = (side * fitted.enlarged for side in fitted.hw)
    top, left = fitted.before
    if flow.ndim != 3 or flow.shape[0] != 2 or flow.shape[1] < top + height or flow.shape[2] < left + width:
        raise ValueError(f"flow has shape {flow.shape}, expected (2, h, w) with h ≥ {top + height}, w ≥ {left + width}")
    own = flow[:, top : top + height, left : left + width].astype(np.float32)
    blocks = own.reshape(2, fitted.hw[0], fitted.enlarged, fitted.hw[1], fitted.enlarged)
    return np.ascontiguousarray(blocks.mean(axis=(2, 4)).transpose(1, 2, 0)) / np.float32(fitted.enlarged)


class Raft:
    """``raft_large``, loaded once; satisfies ``Flow``. Weights: ``raft/raft_large_C_T_SKHT_V2.pth``."""

    def __init__(self, card: Card, weights: Path, where: str) -> None:
        file = staged_weights(card, weights) / card.weights[0].path
        build = attribute(card, import_upstream(card, "torchvision.models.optical_flow"), "raft_large")
        import torch

        self._device = torch_device(card, where)
        self._network = build(weights=None, progress=False)
        with loading(card, file):
            self._network.load_state_dict(torch.load(file, map_location="cpu", weights_only=True))
        self._network.eval().to(self._device)

    def flow(
        self, first: Integer[np.ndarray, "H W 3"], second: Integer[np.ndarray, "H W 3"]
    ) -> Float[np.ndarray, "H W 2"]:
        """Optical flow; see ``models.protocols.Flow``."""
        pair, fitted = preprocess(first, second)
        return postprocess(require_finite(CARD, "flow", estimate_flow(self._network, pair, self._device)), fitted)


def estimate_flow(
    network: Any, pair: Float[np.ndarray, "2 3 h w"], where: Any, updates: int = 12
) -> Float[np.ndarray, "2 h w"]:
    """Float32 flow from the first to the second of float32 pictures in [-1, 1], after ``updates`` refinements."""
    import torch

    first, second = (torch.from_numpy(picture[None]).to(where) for picture in pair)
    with torch.inference_mode():
        return network(first, second, num_flow_updates=updates)[-1][0].float().cpu().numpy()


ADAPTER = Raft
