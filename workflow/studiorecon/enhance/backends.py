# SPDX-License-Identifier: Apache-2.0
"""What a configuration's ``enhancer`` and ``flow`` stand for: the embedded ones, or an upstream network with its weights."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from studiorecon.enhance.enhancer import Unchanged
from studiorecon.images.flow import dis_flow, grey_levels
from studiorecon.models.protocols import Enhancer, Flow

Preset = Literal["ultrafast", "fast", "medium"]


@dataclass(frozen=True)
class DisFlow:
    """Dense inverse search on luminance; the same everywhere inside ``images.flow.one_thread``."""

    preset: Preset

    def flow(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """See ``models.protocols.Flow``."""
        return dis_flow(grey_levels(first), grey_levels(second), self.preset)


def flow_of(name: Literal["dis", "raft"], preset: Preset, weights: Path, device: str) -> Flow:
    """The flow of that name; ``weights``: folder of upstream weights, ``device``: auto, cpu or cuda.

    RAFT enlarges pictures under 128 pixels by whole numbers (numerics E12). Raises Refusal when its weights are missing.
    """
    if name == "dis":
        return DisFlow(preset)
    from studiorecon.models.raft import Raft

    return Raft(weights, device)


def network(name: Literal["difix", "fixer", "none"], weights: Path, device: str, seed: int) -> Enhancer:
    """The enhancer of that name that needs nothing but a picture and a photo; ``none`` leaves pictures as they are.

    Raises Refusal when a network's weights, package or memory are missing.
    """
    if name == "none":
        return Unchanged()
    from studiorecon.models.difix import Difix, Fixer

    return Difix(weights, seed, device) if name == "difix" else Fixer(weights, device)
