# SPDX-License-Identifier: Apache-2.0
"""Settings that several steps of the stage share."""

from __future__ import annotations

from dataclasses import dataclass

from studiorecon.configuration.setting import setting
from studiorecon.geometry.smoothing import Smoothing
from studiorecon.people.fitting.points import Triangulation


@dataclass(frozen=True)
class TriangulationSettings:
    """How keypoints are triangulated."""

    triangulation: Triangulation = setting(Triangulation(), "What counts as agreement of views.")


@dataclass(frozen=True)
class SmoothingSettings:
    """How motion is smoothed."""

    smooth: Smoothing = setting(
        Smoothing(), "Both-way exponential, then Gaussian smoothing of the fitted motion (U40 to U42)."
    )
