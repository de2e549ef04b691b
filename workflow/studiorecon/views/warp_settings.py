# SPDX-License-Identifier: Apache-2.0
"""Settings that several steps of the stage share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from studiorecon.configuration.setting import setting
from studiorecon.models.choices import Synthesizer


@dataclass(frozen=True)
class ViewSource:
    """The source of the views."""

    synthesizer: Synthesizer = setting(
        "warp",
        "Source of new views: warp (photos through their depth), gen3c, or precomputed films of gen3c.",
        paper="gen3c",
        paper_value="gen3c",
    )
    key_frames: Literal["plates", "first_frames"] = setting(
        "plates",
        "Input of a network: clean plates, or first pictures, whose people are masked later.",
        paper="first frames, people masked",
        paper_value="first_frames",
    )


@dataclass(frozen=True)
class PeopleInViews:
    """The people in the views."""

    people: Literal["bodies", "network"] = setting(
        "bodies",
        "With first_frames, masks from the fitted bodies or from masks.source's network.",
        paper="SAM 3 on every view",
        paper_value="network",
    )


@dataclass(frozen=True)
class Warping:
    """Settings of warping photos by their depth: all of them into each view (paper: all N, section on view synthesis).

    Attributes:
        oversampling: samples per pixel side when a photo is splatted.
        z_tolerance: share of depth within which surfaces count as one.
        depth_jump: pixels next to a larger relative jump in depth are not warped: they mix two surfaces.
        fade_deg: photos fade with the angle between their ray and the view's, exp(-angle / fade).
        inpaint_radius: distance in pixels from a hole's rim within which it is inpainted; the mask still marks it.
    """

    oversampling: int = 3
    z_tolerance: float = 0.02
    depth_jump: float = 0.04
    fade_deg: float = 15.0
    inpaint_radius: int = 4
