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
        "Where Gaussians start: depth = discs on the training cameras' depth; random = anywhere, the 4-view baseline.",
        paper="on Pi3's points",
        paper_value="depth",
    )
    random_count: int = 56000
    random_size_m: float = 0.06
    stride: int = setting(2, "One Gaussian per so many pixels in either direction of every plate.", minimum=1)
    seed_size: float = 0.6
    seed_opacity: float = 0.7
    measured_confidence: float = 0.2
    room_targets: Literal["plates", "first_frames"] = setting(
        "plates",
        "Image that a training camera contributes: plates = its clean plate; first_frames = its first picture "
        "without people and dilation_px around them.",
        paper="the first frames, (1 - M), Eq. 5",
        paper_value="first_frames",
    )
    dilation_px: int = setting(
        21,
        "With first_frames: side of the square by which masks of people are dilated; 1 = not at all.",
        unit="px",
        minimum=1,
        odd=True,
        paper="21, appendix A; U24",
        paper_value=21,
    )
    fill_unseen: bool = setting(
        True,
        "Cover the parts of floor, walls and ceiling that no camera sees with discs painted from their surroundings "
        "(marked invented).",
        paper="none, appendix C",
        paper_value=False,
    )
    fill_step_m: float = setting(
        0.04,
        "Grid of those discs; coarser when the room would need more than fill_limit nodes, and twice as coarse on "
        "faces of which nothing is seen.",
        unit="m",
        above=0,
    )
    fill_limit: int = setting(150000, "Most nodes of that grid.", minimum=1)
    views_share: float = setting(
        0.75,
        "Share of the steps that train on synthesized views.",
        minimum=0,
        below=1,
        paper="all of them, photos replace the frames at their own poses; U16",
        paper_value=0.99,
    )
    hole_weight: float = setting(
        0.3,
        "Weight of pixels of synthesized views that were inpainted.",
        minimum=0,
        maximum=1,
        paper="1",
        paper_value=1.0,
    )
    photo_weight: float = setting(
        2.0,
        "What pixels of photos weigh more than those of synthesized views; views near a photo share it.",
        minimum=0,
        paper="λ_gt 2, appendix C",
        paper_value=2.0,
    )
    limit_sh_to_views: bool = setting(
        True,
        "Lower training.sh_degree to what the real cameras can resolve: degree d needs (d + 1)² directions (G15).",
        paper="no limit",
        paper_value=False,
    )
    seed: int = setting(0, "Seed of all draws.", minimum=0)
    refinement: Refinement = setting(Refinement(), "Iterative refinement, half-way.")
    training: TrainingSettings = setting(TrainingSettings(), "The training loop.")
