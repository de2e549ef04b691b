# SPDX-License-Identifier: Apache-2.0
"""Trains a set of Gaussians that does not move, on either device: the room, or an object in its own frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.errors import UserError
from studiorecon.progress import say
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.train.blocked_set import BlockedSet
from studiorecon.splatting.train.checkpoint import Checkpoint
from studiorecon.splatting.train.perceptual import Perceptual
from studiorecon.splatting.train.schedule import TrainingSettings
from studiorecon.splatting.train.state import finite_mask
from studiorecon.splatting.train.targets import Target
from studiorecon.splatting.train.terms import active_terms
from studiorecon.splatting.train.trainer import train

if TYPE_CHECKING:
    from jaxtyping import Integer

    from studiorecon.splatting.cuda.tensor_set import TensorSet


@dataclass(frozen=True)
class TrainedGaussians:
    """The result of a training.

    Attributes:
        gaussians: in the order of the initial ones (descendants are adjacent); without densification the same N.
        source: index of the initial Gaussian each descends from, to carry over labels such as provenance.
        psnr_db: mean over the last tenth of the iterations, on the pixels that counted.
        refused: gradient entries that were not finite and were skipped.
        left_out: Gaussians, given or trained, that were not finite and are not in the result.
        masked: pixels of targets that were not finite and did not count.
    """

    gaussians: Gaussians
    source: Integer[np.ndarray, " N"]
    psnr_db: float
    refused: int
    left_out: int
    masked: int


def train_still(
    initial: Gaussians,
    targets: Sequence[Target],
    settings: TrainingSettings,
    rng: np.random.Generator,
    *,
    extent_m: float,
    span: tuple[int, int] | None = None,
    threads: int | None = None,
    label: str = "training",
    network: Perceptual | None = None,
    checkpoint: Checkpoint | None = None,
    previews: Path | None = None,
    device: str = "cpu",
) -> TrainedGaussians:
    """Gaussians fitted to the targets on a resolved ``device``.

    ``extent_m`` (``targets.scene_extent``) scales position steps. ``span`` runs only those iterations of the schedule,
    for loops that change the targets in between (Adam's moments start at 0). ``network`` is used when
    ``settings.lpips.weight`` is above 0. On the CPU the same inputs, generator state and ``threads`` give the same
    bytes, also when a killed run resumes at its ``checkpoint``; on CUDA sums come in any order, so two runs differ by
    rounding. Gaussians and pixels that are not finite are left out and counted. Raises UserError without Gaussians or
    targets.
    """
    initial = initial.with_sh_degree(settings.sh_degree)
    given = np.flatnonzero(finite_mask(initial))
    if len(given) == 0 or not targets:
        raise UserError(
            f"{label}: there are {len(given)} finite Gaussians and {len(targets)} images; training needs some of both"
        )
    left_out, initial = initial.count - len(given), initial.take(given)
    sound, masked = zip(*(target.without_non_finite() for target in targets))
    if settings.largest_scale_m > 0:
        most = np.float32(np.log(settings.largest_scale_m))
        initial = replace(initial, log_scales=np.minimum(initial.log_scales, most))
    first, last = span or (0, settings.iterations)
    say(f"{label}: {initial.count} Gaussians on {len(targets)} images, iterations {first} to {last}")
    subject = _on_device(device, initial, sound, settings, rng, extent_m, threads)
    terms = active_terms(settings, network)
    psnr_db = train(subject, terms, (first, last), rng, label=label, checkpoint=checkpoint, previews=previews)
    back = np.argsort(subject.source, kind="stable")
    trained, source = subject.gaussians().take(back), given[subject.source[back]]
    kept, refused = finite_mask(trained), subject.refused
    left_out += int(np.count_nonzero(~kept))
    for count, what in ((sum(masked), "pixels of targets"), (left_out, "Gaussians"), (refused, "gradient entries")):
        if count:
            say(f"{label}: {count} {what} were not finite and are left out")
    return TrainedGaussians(trained.take(kept), source[kept], psnr_db, refused, left_out, int(sum(masked)))


def _on_device(
    device: str,
    initial: Gaussians,
    targets: Sequence[Target],
    settings: TrainingSettings,
    rng: np.random.Generator,
    extent_m: float,
    threads: int | None,
) -> BlockedSet | TensorSet:
    """The set in the device's form."""
    if device == "cuda":
        from studiorecon.splatting.cuda.tensor_set import TensorSet

        return TensorSet(initial, targets, settings, rng, extent_m)
    return BlockedSet(initial, targets, settings, rng, extent_m, threads)
