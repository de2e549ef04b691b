# SPDX-License-Identifier: Apache-2.0
"""Settings of the training of the room."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from studiorecon.background.refinement import Refinement
from studiorecon.configuration.setting import setting
from studiorecon.splatting.train.schedule import TrainingSettings


@dataclass(frozen=True)
class Settings:
    """How the background is initialised and trained."""

    start: Literal["depth", "random"] = setting(
        "depth",
        "Start of Gaussians: discs on the training cameras' depth, or random (the 4-view baseline).",
        paper="Pi3's points",
        paper_value="depth",
    )
    random_count: int = 56000
    random_size_m: float = 0.06
    stride: int = setting(2, "One Gaussian per this many pixels in each direction of every plate.", minimum=1)
    seed_size: float = 0.6
    seed_opacity: float = 0.7
    measured_confidence: float = 0.2
    room_targets: Literal["plates", "first_frames"] = setting(
        "plates",
        "Image of a training camera: its clean plate, or its first picture without people.",
        paper="first frames, (1 - M), Eq. 5",
        paper_value="first_frames",
    )
    dilation_px: int = setting(
        21,
        "With first_frames: side of the square that dilates people's masks; 1 = none.",
        unit="px",
        minimum=1,
        odd=True,
        paper="21, appendix A; U24",
        paper_value=21,
    )
    fill_unseen: bool = setting(
        True,
        "Cover unseen floor, walls and ceiling with discs painted from their surroundings (marked invented).",
        paper="none, appendix C",
        paper_value=False,
    )
    fill_step_m: float = setting(
        0.04,
        "Grid of those discs; coarser beyond fill_limit, twice as coarse on faces that no camera sees.",
        unit="m",
        above=0,
    )
    fill_limit: int = setting(150000, "Maximum number of nodes of that grid.", minimum=1)
    views_share: float = setting(
        0.75,
        "Share of the steps that train on synthesized views.",
        minimum=0,
        below=1,
        paper="all; photos replace frames at their poses; U16",
        paper_value=0.99,
    )
    hole_weight: float = setting(
        0.3,
        "Weight of inpainted pixels of synthesized views.",
        minimum=0,
        maximum=1,
        paper="1",
        paper_value=1.0,
    )
    photo_weight: float = setting(
        2.0,
        "Weight of a photo's pixels relative to synthesized views; views near a photo share it.",
        minimum=0,
        paper="λ_gt 2, appendix C",
        paper_value=2.0,
    )
    limit_sh_to_views: bool = setting(
        True,
        "Limit training.sh_degree to what the cameras resolve: degree d needs (d + 1)² directions (G15).",
        paper="no limit",
        paper_value=False,
    )
    seed: int = setting(0, "Random seed.", minimum=0)
    refinement: Refinement = setting(Refinement(), "Iterative refinement, half-way.")
    training: TrainingSettings = setting(TrainingSettings(), "The training loop.")
