# SPDX-License-Identifier: Apache-2.0
"""MoGe-2 and MoGe-3 (Wang et al. 2025): depth of one picture, in metres more or less; nothing ties one picture's scale to the next one's.

Outside its mask upstream returns +inf. A known focal length goes in as the horizontal field of view in degrees; a centred principal point
and square pixels are assumed there.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.models.preflight import attribute, device, staged, upstream
from studiorecon.models.registry import model
from studiorecon.models.sizes import as_float

_MODULES = {"moge": "moge.model.v2", "moge3": "moge.model.v3"}
_FILES = {"moge": "moge/moge-2-vitl-normal.pt", "moge3": "moge/moge-3-vitl.pt"}


def pre(picture: np.ndarray) -> np.ndarray:
    """(3, H, W) float32 RGB in [0, 1]; any size, upstream makes its own grid of tokens."""
    return np.ascontiguousarray(as_float(picture).transpose(2, 0, 1))


def fov_deg(focal_px: float, width: int) -> float:
    """Horizontal field of view in degrees of a pinhole with its principal point in the middle."""
    return float(np.degrees(2 * np.arctan(width / (2 * focal_px))))


def post(depth: np.ndarray, mask: np.ndarray, name: str = "moge") -> np.ndarray:
    """(H, W) float32 depth, 0 where it is infinite, not positive or outside the mask; Refusal when nothing is left or much is NaN."""
    if depth.shape != mask.shape or depth.ndim != 2:
        raise Refusal(f"{model(name).title} returned depth {depth.shape} and mask {mask.shape}; use upstream at its pin")
    nan = int(np.isnan(depth).sum())
    if nan:
        raise Refusal(f"{model(name).title} returned {nan} depths that are no numbers; run it in full precision (device: cpu)")
    known = np.isfinite(depth) & (depth > 0) & mask
    if not known.any():
        raise Refusal(f"{model(name).title} sees no surface in the whole picture; look at it, or set depth.source to embedded")
    return np.where(known, depth, 0).astype(np.float32)


class Moge:
    """The network, loaded once; satisfies ``MonocularDepth``. Weights: ``moge/`` below ``weights``."""

    def __init__(self, name: str, weights: Path, where: str) -> None:
        file = staged(name, weights) / _FILES[name]
        network = attribute(name, upstream(name, _MODULES[name]), "MoGeModel")
        self._name, self._device = name, device(name, where, "set depth.source to embedded")
        try:
            self._network = network.from_pretrained(str(file)).to(self._device).eval()
        except (KeyError, TypeError, RuntimeError) as error:
            raise Refusal(
                f"{file} is not a checkpoint of {model(name).title} ({str(error).splitlines()[0]}); run snakemake weights"
            ) from None

    def depth(self, picture: np.ndarray, focal_px: float | None) -> np.ndarray:
        """See ``models.protocols.MonocularDepth``."""
        field = fov_deg(focal_px, picture.shape[1]) if focal_px else None
        return post(*inferred(self._network, pre(picture), field, self._device), self._name)


def inferred(network: Any, picture: np.ndarray, field_deg: float | None, where: Any, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) depth, +inf outside the mask, and the mask, from upstream's ``infer``; half precision on a GPU only."""
    import torch

    with torch.inference_mode():
        half = torch.device(where).type == "cuda"
        made = network.infer(torch.from_numpy(picture).to(where), fov_x=field_deg, apply_mask=True, use_fp16=half, **options)
    mask = made["mask"] if "mask" in made else torch.isfinite(made["depth"])
    return made["depth"].float().cpu().numpy(), mask.bool().cpu().numpy()
