# SPDX-License-Identifier: Apache-2.0
"""Settings that several steps of the stage share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from studiorecon.configuration.setting import setting


@dataclass(frozen=True)
class StartSettings:
    """How a person's Gaussians are initialised."""

    gaussians: int = setting(
        10000,
        "Gaussians per person.",
        minimum=16,
        paper="6890, appendix D",
        paper_value=6890,
    )
    placement: Literal["evenly", "vertices"] = setting(
        "evenly",
        "Start of Gaussians: evenly over the surface, or one at every vertex of the body model.",
        paper="at SMPL's vertices, appendix D",
        paper_value="vertices",
    )
    seed: int = setting(0, "Random seed.", minimum=0)
