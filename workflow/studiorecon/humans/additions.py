# SPDX-License-Identifier: Apache-2.0
"""Settings of the training of a person that the paper does not have; each can be switched off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from studiorecon.configuration.setting import setting


@dataclass(frozen=True)
class Additions:
    """Measures against ambiguities of four views; ``presets/paper.yaml`` has none of them."""

    behind: Literal["random", "black"] = setting(
        "random",
        "Background behind the person in training: random = another colour at every step, so that no colour passes "
        "for transparent; black.",
        paper="not said: the masked picture over black, as in the work it follows; U52",
        paper_value="black",
    )
    unseen: Literal["filled", "trained"] = setting(
        "filled",
        "Gaussians that no camera saw: filled = coloured like the surrounding body, constant over time; trained = as "
        "training leaves them, with the temporal network's residuals.",
        paper="trained, appendix D",
        paper_value="trained",
    )
    pose_joints: Literal["limbs", "all"] = setting(
        "limbs",
        "Joints whose turns are refined: limbs = all but feet, head and hands, which move hardly any surface.",
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
    scales_held: bool = setting(
        True,
        "Standard deviations stay between 0.08 and 1.6 of the Gaussians' spacing.",
        paper="no such limit",
        paper_value=False,
    )
