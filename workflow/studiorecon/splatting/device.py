# SPDX-License-Identifier: Apache-2.0
"""Chooses the back end: the CPU's kernels, or gsplat on a CUDA device."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING, Literal

from studiorecon.errors import UserError
from studiorecon.machine.gpu import claim_gpu
from studiorecon.progress import say

if TYPE_CHECKING:
    from studiorecon.splatting.cpu.rasterise import Rasteriser
    from studiorecon.splatting.cuda.rasterise import GsplatRasteriser

Device = Literal["cpu", "cuda"]
# Near limit of depth at which a finished scene is drawn, metres, as in 3DGS: nearer, one Gaussian would cover a film.
DRAWN_FROM_M = 0.2


def resolve(setting: str, what: str = "Gaussians are drawn") -> Device:
    """The device for ``setting`` (auto, cpu or cuda); logs it with ``what`` it is for, once per call.

    auto uses CUDA where gsplat is installed and torch detects a device; without gsplat torch is not even imported.
    Raises UserError when cuda is set and not available.
    """
    if setting not in ("auto", "cpu", "cuda"):
        raise UserError(f"setting device is {setting!r}; it must be auto, cpu or cuda")
    missing = "" if setting == "cpu" else _missing_for_cuda()
    if setting == "cuda" and missing:
        raise UserError(f"device: cuda needs {missing}; or set device: auto")
    device: Device = "cpu" if setting == "cpu" or missing else "cuda"
    say(f"{what} on the {'CUDA device' if device == 'cuda' else 'CPU'}")
    return device


def rasteriser(
    device: str, *, near_m: float, threads: int | None = None, antialias: bool = False
) -> Rasteriser | GsplatRasteriser:
    """The rasteriser of a resolved ``device``; ``draw`` and ``gather``, for training on the CPU, exist there only."""
    if (resolve(device) if device == "auto" else device) == "cuda":
        from studiorecon.splatting.cuda.rasterise import GsplatRasteriser

        return GsplatRasteriser(near_m=near_m, antialias=antialias)
    from studiorecon.splatting.cpu.rasterise import Rasteriser

    return Rasteriser(near_m=near_m, threads=threads, antialias=antialias)


def _missing_for_cuda() -> str:
    """The missing requirements of CUDA and how to install them; empty when nothing is missing."""
    for name in ("gsplat", "torch"):
        if importlib.util.find_spec(name) is None:
            return (
                f"the package {name}, which is not installed (uv sync --inexact --extra "
                "gpu, or pip install 'studiorecon[gpu]')"
            )
    claim_gpu()
    import torch

    return (
        "" if torch.cuda.is_available() else "an NVIDIA GPU and its driver, but torch finds none; check with nvidia-smi"
    )
