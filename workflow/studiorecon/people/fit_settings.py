# SPDX-License-Identifier: Apache-2.0
"""Settings that several steps of the stage share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from studiorecon.configuration.setting import setting
from studiorecon.geometry.smoothing import Smoothing
from studiorecon.people.fitting.points import Triangulation


@dataclass(frozen=True)
class TriangulationSettings:
    """How keypoints are triangulated."""

    triangulation: Triangulation = setting(Triangulation(), "What counts as agreement of views.")


@dataclass(frozen=True)
class HandSettings:
    """Whether fingers are reconstructed."""

    hands: Literal["auto", "on", "off"] = setting(
        "auto",
        "Fingers: auto = of hands of 40 pixels of the film in two views; on = of all hands; off = of none.",
        paper="none",
        paper_value="off",
    )


@dataclass(frozen=True)
class SmoothingSettings:
    """How motion is smoothed."""

    smooth: Smoothing = setting(
        Smoothing(), "Both-way exponential, then Gaussian smoothing of the fitted motion (U40 to U42)."
    )
