# SPDX-License-Identifier: Apache-2.0
"""Types of the settings that may name a network: Literals of the stage's own values and of those networks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from studiorecon.models.catalogue.selection import CHOICES

if TYPE_CHECKING:
    CalibrationSource = str
    DetectionSource = str
    MaskSource = str
    DepthSource = str
    Synthesizer = str
    EnhancerName = str
    FlowName = str
else:
    CalibrationSource = Literal[CHOICES["calibration.source"].values]
    DetectionSource = Literal[CHOICES["detect.source"].values]
    MaskSource = Literal[CHOICES["masks.source"].values]
    DepthSource = Literal[CHOICES["depth.source"].values]
    Synthesizer = Literal[CHOICES["views.synthesizer"].values]
    EnhancerName = Literal[CHOICES["enhance.enhancer"].values]
    FlowName = Literal[CHOICES["enhance.flow"].values]
