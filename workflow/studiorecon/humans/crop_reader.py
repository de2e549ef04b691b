# SPDX-License-Identifier: Apache-2.0
"""One person's crops from every camera's film and masks: cut out, spooled to disk, and classified once all are known.

Every pixel of a crop takes five bytes in a file in the working folder; memory holds one crop at a time, however long
the clip is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studiorecon.body.hands import posed_skeleton
from studiorecon.body.model import BodyModel
from studiorecon.footage.video import read_frames
from studiorecon.humans.crops import Crop, SpooledCrop, TrainingCrop, classify_crops, mask_inset_px, person_crops
from studiorecon.humans.train_settings import Settings
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.factors import NONE, Factors
from studiorecon.scene.people import Person
from studiorecon.scene.spool import Slot, Spool

_FRAMES_AT_ONCE = 32


@dataclass(frozen=True)
class _SpooledTrainingCrop:
    """A crop without its pixels: its source, and its offset in the file."""

    frame: int
    view: int
    camera: Camera
    rgb: Slot
    labels: Slot
    body: Slot


class _SpooledTrainingCrops:
    """Spooled crops, read again at every pass."""

    def __init__(self, folder: Path) -> None:
        self.spool, self.kept = Spool(folder), list[_SpooledTrainingCrop]()

    def add(self, look: TrainingCrop) -> None:
        slots = (self.spool.put(part) for part in (look.rgb, look.labels, look.body))
        self.kept.append(_SpooledTrainingCrop(look.frame, look.view, look.camera, *slots))

    def __iter__(self) -> Iterator[TrainingCrop]:
        for k in self.kept:
            yield TrainingCrop(k.frame, k.view, k.camera, *map(self.spool.get, (k.rgb, k.labels, k.body)))


def read_crops(
    settings: Settings,
    cameras: Sequence[Camera],
    videos: list[Path],
    masks: list[Path],
    fitted: Person,
    body_model: BodyModel,
    label: int,
    frames: int,
    folder: Path,
    exposure: Factors = NONE,
) -> list[Crop]:
    """Every camera's crops of the person with mask label ``label``, camera by camera, of one exposure and light.

    Their pixels are in a file in ``folder`` until the process ends.
    """
    looks = _SpooledTrainingCrops(folder)
    for view, (camera, video, mask) in enumerate(zip(cameras, videos, masks)):
        for look in person_crops(
            view,
            camera,
            exposure.normalise_film(camera.name, read_frames(video, 0, frames)),
            read_frames(mask, 0, frames),
            _surface_over_time(body_model, fitted),
            fitted.valid,
            label,
            settings.margin_px,
            settings.smallest_px,
        ):
            looks.add(look)
    inset_px = mask_inset_px(looks, label)
    if inset_px:
        say(
            f"{fitted.name}: the masks end {inset_px} px inside the fitted body; the pixels between count as the person"
        )
    crops: list[Crop] = []
    verdicts = classify_crops(looks, label, settings.additions.edge_px, settings.occluder_px, inset_px)
    for kept, crop in zip(looks.kept, verdicts):
        looks.spool.put_back(kept.labels, crop.verdict)
        crops.append(SpooledCrop(kept.frame, kept.view, kept.camera, looks.spool, kept.rgb, kept.labels))
    return crops


def _surface_over_time(model: BodyModel, fitted: Person) -> Iterator[np.ndarray]:
    """Yields the fitted body's vertices (V, 3) frame by frame: those of a minute would fill a gigabyte."""
    model, poses = posed_skeleton(fitted, model)
    for first in range(0, len(fitted.poses), _FRAMES_AT_ONCE):
        own = slice(first, first + _FRAMES_AT_ONCE)
        yield from model.vertices(poses[own], fitted.betas, fitted.trans[own])
