# SPDX-License-Identifier: Apache-2.0
"""Settings of the training of a person."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from studiorecon.configuration.setting import setting
from studiorecon.humans.additions import Additions
from studiorecon.humans.appearance import OverTime
from studiorecon.humans.start_settings import StartSettings
from studiorecon.humans.training import GaussianLimits, Growing, Losses, Rates
from studiorecon.scene.effects import TEMPORAL_APPEARANCE, thresholds


@dataclass(frozen=True)
class TrainSettings(StartSettings):
    """How a person is initialised and trained; ``checkpoint_every_s`` is as in ``TrainingSettings``."""

    sh_degree: int = setting(
        1,
        "Degree of spherical harmonics; four cameras determine degree 1 at most (G15).",
        minimum=0,
        maximum=2,
        paper="2, appendix D",
        paper_value=2,
    )
    limit_sh_to_views: bool = setting(
        True,
        "Limit sh_degree to what the viewing directions of the turning body resolve.",
        paper="no limit",
        paper_value=False,
    )
    skinning: Literal["surface", "grid"] = setting(
        "surface",
        "surface = the body's four strongest weights at the start; grid = all of a voxel grid at the current position.",
        paper="grid, appendix D; U45",
        paper_value="grid",
    )
    grid_resolution: int = 64
    grid_margin: float = 0.15
    iterations: int = setting(1500, "Training steps.", minimum=1, paper="10,000, appendix D", paper_value=10000)
    pose_from: int = setting(300, "Step from which poses are refined too.", minimum=0)
    margin_px: int = 12
    occluder_px: int = 6
    smallest_px: int = 60
    near_m: float = 0.05
    checkpoint_every_s: float = 30.0
    temporal: OverTime = setting(OverTime(), "A small network for what changes over time.")
    losses: Losses = setting(Losses(), "Weights of the loss.")
    rates: Rates = setting(Rates(), "Learning rates (Adam).")
    densify: Growing = setting(Growing(), "How the number of Gaussians grows.")
    additions: Additions = setting(Additions(), "Additions to the paper's training.")
    limits: GaussianLimits = GaussianLimits()


@dataclass(frozen=True)
class Settings(TrainSettings):
    """The same, and the threshold of the temporal network, which ``survey.effects.EffectSettings`` declares."""

    thresholds: Mapping[Literal["temporal_appearance"], float] = thresholds([TEMPORAL_APPEARANCE])

    @property
    def drift(self) -> float:
        """Share of the body whose colours must drift."""
        return self.thresholds.get("temporal_appearance", TEMPORAL_APPEARANCE.threshold)
