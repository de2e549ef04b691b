# SPDX-License-Identifier: Apache-2.0
"""The room's training over a span of its iterations, and views of the room in its current state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.background.preparation import PreparedTraining
from studiorecon.background.refinement import refinement_cameras
from studiorecon.background.targets import draw_shares
from studiorecon.background.train_settings import Settings
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.path import read_path
from studiorecon.splatting.device import rasteriser
from studiorecon.splatting.train.checkpoint import Checkpoint
from studiorecon.splatting.train.perceptual import Perceptual
from studiorecon.splatting.train.still import TrainedGaussians, train_still
from studiorecon.splatting.train.targets import Target, scene_extent

if TYPE_CHECKING:
    from jaxtyping import Integer

    from studiorecon.splatting.cpu.rasterise import Rasteriser
    from studiorecon.splatting.cuda.rasterise import GsplatRasteriser


@dataclass(frozen=True)
class Training:
    """The parts of the training that are the same in all iterations."""

    settings: Settings
    cameras: Sequence[Camera]
    rng: np.random.Generator
    threads: int
    device: str
    previews: Path
    lpips: Path

    def fit(
        self,
        start: Gaussians,
        real: list[Target],
        synthesized: list[Target],
        checkpoint: Checkpoint,
        span: tuple[int, int],
    ) -> TrainedGaussians:
        """Run the iterations of ``span`` on plates and views, drawn with the share ``views_share``."""
        shares = draw_shares(len(real), len(synthesized), self.settings.views_share)
        targets = [replace(target, share=float(share)) for target, share in zip(real + synthesized, shares)]
        return train_still(
            start,
            targets,
            self.settings.training,
            self.rng,
            extent_m=scene_extent(self.cameras),
            span=span,
            threads=self.threads,
            label="background",
            network=_network(self.settings, self.lpips, self.threads, self.device),
            checkpoint=checkpoint,
            previews=self.previews,
            device=self.device,
        )

    def first_half(
        self, given: PreparedTraining, checkpoint: Checkpoint
    ) -> tuple[Gaussians, Integer[np.ndarray, " N"]]:
        """The half-trained room, and the provenance of its Gaussians."""
        first = self.fit(given.start, given.real, given.synthesized, checkpoint, (0, self.split))
        return first.gaussians, given.marks[first.source]

    @property
    def split(self) -> int:
        """Number of iterations before the half-trained room is rendered; 0 = never."""
        refinement = self.settings.refinement
        return round(refinement.at * self.settings.training.iterations) if refinement.views else 0

    def build_rasteriser(self) -> Rasteriser | GsplatRasteriser:
        """The rasteriser that draws the room as in training."""
        return rasteriser(self.device, near_m=self.settings.training.near_m, threads=self.threads)

    def refinement_views(self, path: Path) -> list[Camera]:
        """The cameras that render the half-trained room; ``path`` is that of the synthesized views."""
        views = [step.camera for step in read_path(path)[0]]
        return refinement_cameras(self.cameras, views, self.settings.refinement)


def _network(settings: Settings, lpips: Path, threads: int, device: str) -> Perceptual | None:
    """The network of the perceptual term on the drawing device; None when its weight is 0."""
    if settings.training.lpips.weight == 0:
        say("LPIPS is off (background.training.lpips.weight is 0)")
        return None
    from studiorecon.models.adapters.lpips import read_lpips

    return read_lpips(lpips, threads, without="set background.training.lpips.weight to 0", device=device)
