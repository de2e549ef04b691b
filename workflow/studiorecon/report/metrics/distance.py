# SPDX-License-Identifier: Apache-2.0
"""LPIPS of pictures if the user gave its weights, and the reason why it, or ꟻLIP, is missing otherwise."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from studiorecon.images.flip import SMALLEST_PX, is_available
from studiorecon.models.protocols import SMALLEST_MEASURED_PX, PerceptualDistance

NO_PACKAGE = "flip-evaluator does not load: it has no wheel for every Python and machine"
TOO_SMALL = f"pictures are under {SMALLEST_MEASURED_PX} pixels a side"
Net = Literal["none", "alex", "vgg"]


def missing_flip_reason() -> str:
    """The reason why ꟻLIP is null."""
    return f"pictures are under {SMALLEST_PX} pixels a side" if is_available() else NO_PACKAGE


def open_lpips(net: Net, weights: Path, threads: int, without: str, device: str = "cpu") -> PerceptualDistance | None:
    """LPIPS on ``net`` and a torch ``device``, or None when none is selected.

    Raises UserError when its files are not in the folder ``weights``, and says how to continue ``without``.
    """
    if net == "none":
        return None
    from studiorecon.models.adapters.lpips import read_lpips

    return read_lpips(weights, threads, net, without, device)
