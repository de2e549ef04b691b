# SPDX-License-Identifier: Apache-2.0
"""Settings that several steps of the stage share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from studiorecon.configuration.setting import setting
from studiorecon.images.transfer import Transfer
from studiorecon.models.choices import EnhancerName, FlowName
from studiorecon.recursive.flows import Preset
from studiorecon.recursive.injection import Injection


@dataclass(frozen=True)
class Enhancing:
    """The enhancer; ``seed`` is that of a network's noise."""

    enhancer: EnhancerName = setting(
        "residual",
        "residual = detail that renders miss at the photos; difix, fixer = networks; precomputed = "
        "films of another program; none.",
        paper="difix, one step at 199; U07",
        paper_value="difix",
    )
    seed: int = 0


@dataclass(frozen=True)
class Carrying:
    """Strength of the transferred residual; ``auto`` is estimated on ``judged_frames`` moments."""

    strength: float | Literal["auto"] = setting(
        "auto",
        "Share of the residual; auto = the share that best predicts each training camera from the others.",
        minimum=0,
        maximum=1,
    )
    judged_frames: int = 5
    transfer: Transfer = Transfer()


@dataclass(frozen=True)
class Injecting:
    """Settings of the injection of earlier outputs."""

    injection: Injection = setting(
        Injection(), "Earlier outputs, warped onto the current picture, enter the enhancer's input."
    )
    flow: FlowName = setting(
        "dis",
        "dis = dense inverse search; raft needs weights.",
        paper="raft, backward, on raw renders; U06",
        paper_value="raft",
    )
    flow_preset: Preset = setting("medium", "Quality of dis.")
