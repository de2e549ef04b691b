# SPDX-License-Identifier: Apache-2.0
"""LPIPS of pictures where the user has brought its weights, and why it is missing where not."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from studiorecon.images.perceptual import SMALLEST_SIDE_PX
from studiorecon.models.protocols import PerceptualDistance

TOO_SMALL = f"pictures are under {SMALLEST_SIDE_PX} pixels a side"


@dataclass(frozen=True)
class DistanceSettings:
    """Attributes:
    net: the network that LPIPS is measured with; papers mean ``alex`` where they say LPIPS, and ``vgg`` in the lineage of 3DGS.
    weights: folder with the network's weights.
    """

    net: Literal["none", "alex", "vgg"]
    weights: str


def opened(settings: DistanceSettings, threads: int, without: str) -> PerceptualDistance | None:
    """The network, or None when none is wanted; Refusal when its weights are missing, with how to go on ``without``."""
    if settings.net == "none":
        return None
    from studiorecon.models.lpips import read_lpips

    return read_lpips(Path(settings.weights), threads, settings.net, without)
