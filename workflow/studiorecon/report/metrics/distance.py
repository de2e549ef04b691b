# SPDX-License-Identifier: Apache-2.0
"""LPIPS of pictures where the user has brought its weights, and why it is missing where not."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from studiorecon.models.protocols import SMALLEST_MEASURED_PX, PerceptualDistance

TOO_SMALL = f"pictures are under {SMALLEST_MEASURED_PX} pixels a side"
Net = Literal["none", "alex", "vgg"]


def opened(net: Net, weights: Path, threads: int, without: str) -> PerceptualDistance | None:
    """LPIPS on ``net``, or None when none is wanted; UserError when its files are not in the folder ``weights``, with
    how to go on ``without``."""
    if net == "none":
        return None
    from studiorecon.models.adapters.lpips import read_lpips

    return read_lpips(weights, threads, net, without)
