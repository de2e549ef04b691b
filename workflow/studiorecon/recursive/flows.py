# SPDX-License-Identifier: Apache-2.0
"""The optical flow of the setting ``enhance.flow``: dense inverse search, or an upstream network."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.images.flow import dis_flow, grey_levels
from studiorecon.models.choices import FlowName
from studiorecon.models.loading import load
from studiorecon.models.protocols import Flow

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

Preset = Literal["ultrafast", "fast", "medium"]


@dataclass(frozen=True)
class DisFlow:
    """Dense inverse search on luminance; deterministic inside ``images.flow.one_thread``."""

    preset: Preset

    def flow(
        self, first: Integer[np.ndarray, "H W 3"], second: Integer[np.ndarray, "H W 3"]
    ) -> Float[np.ndarray, "H W 2"]:
        """Optical flow; see ``models.protocols.Flow``."""
        return dis_flow(grey_levels(first), grey_levels(second), self.preset)


def load_flow(name: FlowName, preset: Preset, weights: Path, device: str) -> Flow:
    """The flow of that name on ``device``; raises UserError when a network's weights, package or memory are missing."""
    if name == "dis":
        return DisFlow(preset)
    return load("flow", name, weights, device)
