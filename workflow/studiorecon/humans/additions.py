# SPDX-License-Identifier: Apache-2.0
"""Settings of the training of a person that the paper does not have; each can be switched off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from studiorecon.configuration.setting import setting


@dataclass(frozen=True)
class Additions:
    """Measures against ambiguities of four views; ``presets/paper.yaml`` has none of them."""

    background: Literal["random", "black"] = setting(
        "random",
        "Background in training: another random colour at every step, or black.",
        paper="not stated; U52",
        paper_value="black",
    )
    unseen_colours: Literal["filled", "trained"] = setting(
        "filled",
        "Unseen Gaussians: filled with the colour of the surrounding body, or as trained.",
        paper="trained, appendix D",
        paper_value="trained",
    )
    pose_joints: Literal["limbs", "all"] = setting(
        "limbs",
        "Joints that are refined: limbs = all but feet, head and hands.",
        paper="all, appendix D",
        paper_value="all",
    )
    edge_px: int = setting(
        1,
        "Pixels on both sides of a mask's outline that training ignores.",
        unit="px",
        minimum=0,
        paper="0",
        paper_value=0,
    )
    limit_scales: bool = setting(
        True,
        "Keep standard deviations between 0.08 and 1.6 of the Gaussians' spacing.",
        paper="no such limit",
        paper_value=False,
    )
