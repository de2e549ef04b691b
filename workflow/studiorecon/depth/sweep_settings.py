# SPDX-License-Identifier: Apache-2.0
"""Settings that several steps of the stage share."""

from __future__ import annotations

from dataclasses import dataclass

from studiorecon.configuration.setting import setting


@dataclass(frozen=True)
class NearLimit:
    """Least z-depth in metres of a surface."""

    near_m: float = 0.3


@dataclass(frozen=True)
class DefaultConfidence:
    """Upper limit of the confidence of pixels on a default wall, as a share of 1 (U23); measured ones are above."""

    default_confidence: float = 0.2


@dataclass(frozen=True)
class Matching(NearLimit):
    """How planes are compared with pictures; ``mean_weight``: cost of a difference of mean colour beside
    correlation."""

    far_m: float = setting(
        14.0,
        "Maximum z-depth of a surface; default walls are no further behind the cameras.",
        unit="m",
        above=0,
    )
    window: int = setting(7, "Side of the square matching window.", unit="px", minimum=3, maximum=31, odd=True)
    mean_weight: float = 1.5


@dataclass(frozen=True)
class FirstLook:
    """The size of the first pass."""

    sweep_width: int = setting(
        240,
        "Picture width of the first pass over all planes.",
        unit="px",
        minimum=32,
        maximum=4096,
        paper="Pi3 for the first frame, MoGe later; U21",
    )


@dataclass(frozen=True)
class Comparison(Matching):
    """How the photos are compared on the surfaces of the room: side of the square window, pixels."""

    refine_window: int = 5
