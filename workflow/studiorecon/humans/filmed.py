# SPDX-License-Identifier: Apache-2.0
"""The crops of one person, from every camera's film and masks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.footage.video import read_frames
from studiorecon.humans.crops import Crop, TrainingCrop, judged, looks_of, mask_inset_px
from studiorecon.humans.train_settings import Settings
from studiorecon.progress import say
from studiorecon.scene.factors import NONE, Factors
from studiorecon.scene.people import Person

_FRAMES_AT_ONCE = 32


def read_crops(
    settings: Settings,
    cameras: Sequence,
    videos: list[Path],
    masks: list[Path],
    fitted: Person,
    body_model: BodyModel,
    label: int,
    frames: int,
    exposure: Factors = NONE,
) -> list[Crop]:
    """Every camera's crops of the person that masks call ``label``, camera by camera, of one exposure and light."""
    looks: list[TrainingCrop] = []
    for view, (camera, video, mask) in enumerate(zip(cameras, videos, masks)):
        pictures = exposure.even_all(camera.name, read_frames(video, 0, frames))
        looks += looks_of(
            view,
            camera,
            pictures,
            read_frames(mask, 0, frames),
            _surface_over_time(body_model, fitted),
            fitted.valid,
            label,
            settings.margin_px,
            settings.smallest_px,
        )
    inset_px = mask_inset_px(looks, label)
    if inset_px:
        say(
            f"{fitted.name}: the masks end {inset_px} px inside the fitted body; what "
            "lies between is taken for the person"
        )
    return judged(looks, label, settings.additions.edge_px, settings.occluder_px, inset_px)


def _surface_over_time(model: BodyModel, fitted: Person) -> Iterator[np.ndarray]:
    """The fitted body's vertices (V, 3) frame by frame: those of a minute would fill a gigabyte."""
    for first in range(0, len(fitted.poses), _FRAMES_AT_ONCE):
        own = slice(first, first + _FRAMES_AT_ONCE)
        yield from model.vertices(fitted.poses[own], fitted.betas, fitted.trans[own])
