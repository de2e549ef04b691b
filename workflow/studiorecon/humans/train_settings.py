# SPDX-License-Identifier: Apache-2.0
"""Settings of the training of a person."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.humans.additions import Additions
from studiorecon.humans.appearance import OverTime
from studiorecon.humans.start_settings import StartSettings
from studiorecon.scene.effects import TEMPORAL_APPEARANCE, thresholds
from studiorecon.splatting.train.perceptual import PerceptualSettings


@dataclass(frozen=True)
class Losses:
    """Weights of a person's terms; ``surface`` ties Gaussians to the body, ``pose`` poses to their neighbours in
    time."""

    l1: float = 0.8
    ssim: float = 0.2
    lpips: PerceptualSettings = setting(PerceptualSettings(), "The perceptual term.")
    mask: float = setting(0.1, "L1 on the silhouette.", minimum=0, paper="0.01, appendix D; U50", paper_value=0.01)
    density: float = setting(
        0.0, "Pull of rendered alpha to 0 or 1.", minimum=0, paper="0.1, appendix D; U13", paper_value=0.1
    )
    surface: float = setting(
        0.01, "Pull of Gaussians to their start on the body.", minimum=0, paper="none, appendix D", paper_value=0.0
    )
    pose: float = setting(
        0.05,
        "Weight of smooth poses, at 30 frames per second; other rates are scaled to equal speeds.",
        minimum=0,
        paper="50, appendix D; U51",
        paper_value=50.0,
    )


@dataclass(frozen=True)
class Rates:
    """Learning rates."""

    position_m: float = setting(
        0.0005, "Step size of positions at the start.", unit="m", above=0, paper="1e-3, appendix D", paper_value=1e-3
    )
    position_end_m: float = setting(
        5e-06, "Step size of positions at the end.", unit="m", above=0, paper="2e-6, appendix D", paper_value=2e-6
    )
    rotation: float = 0.001
    scale: float = 0.005
    opacity: float = 0.02
    colour: float = 0.005
    harmonics: float = 0.00025
    # For joints; metres for the pelvis.
    pose_rad: float = 0.0005

    def at(self, done: float) -> dict[str, float]:
        """The rate of every kind of parameter after a share ``done`` of the iterations."""
        ends = np.log([self.position_m, self.position_end_m])
        return {
            "means": float(np.exp(np.interp(done, [0, 1], ends))),
            "quaternions": self.rotation,
            "scales": self.scale,
            "opacities": self.opacity,
            "colour": self.colour,
            "harmonics": self.harmonics,
        }


@dataclass(frozen=True)
class GaussianLimits:
    """Limits of a Gaussian: sigmas as shares of the spacing, distance from the surface in metres."""

    smallest: float = 0.08
    largest: float = 1.6
    surface_m: float = 0.03


@dataclass(frozen=True)
class Growing:
    """When Gaussians are added to a person.

    Attributes:
        until, every: last step that densifies; steps between densifications.
        prune_opacity: fainter ones are removed.
        gradient: mean screen gradient, in half widths of the crop, above which a Gaussian is cloned or split.
        scale: share of the body's height above which one is split rather than cloned.
    """

    use: Literal["none", "gradient"] = setting(
        "none",
        "none; gradient = clone and split where the picture needs it.",
        paper="densified, appendix D",
        paper_value="gradient",
    )
    until: int = 1500
    every: int = 500
    gradient: float = 0.0002
    prune_opacity: float = 0.005
    scale: float = 0.01
    cap: int = setting(
        100000, "Most Gaussians per person; 0 = no limit.", minimum=0, paper="no limit, appendix D", paper_value=0
    )

    def densifies(self, done: int, iterations: int) -> bool:
        """Whether densification continues after ``done`` steps; later Gaussians would stay untrained."""
        return self.use != "none" and done <= self.until and done < iterations


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
