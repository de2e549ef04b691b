# SPDX-License-Identifier: Apache-2.0
"""The training cameras' photos with their renders: the input of an enhancer, and the reference for its gain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.camera_files.colmap import read_model
from studiorecon.footage.video import Playback
from studiorecon.images.transfer import ResidualSource, Transfer, residual_source
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.factors import NONE, Factors, read_factors
from studiorecon.scene.path import PathStep, read_path
from studiorecon.scene.step_files import require

if TYPE_CHECKING:
    from jaxtyping import Float, Integer


@dataclass(frozen=True)
class Training:
    """The training cameras' footage and renders, frame by frame; photos in the ``exposure`` and light of the
    renders."""

    cameras: Sequence[Camera]
    photos: Sequence[Playback]
    renders: Sequence[Playback]
    depths: Sequence[Playback]
    frames: int
    exposure: Factors = NONE

    def photo(self, index: int, frame: int) -> Integer[np.ndarray, "h w 3"]:
        """Photo of one camera, corrected to the common exposure and the plate's light."""
        return self.exposure.normalise(self.cameras[index].name, self.photos[index].at(frame), frame)

    def nearest_frame(self, frame: float) -> int:
        """The nearest whole frame to a fractional one."""
        return int(np.clip(round(frame), 0, self.frames - 1))

    def sources(self, frame: int, transfer: Transfer) -> list[ResidualSource]:
        """Residual and depth of every training camera at one frame."""
        return [
            residual_source(
                camera, self.photo(k, frame), render.at(frame), depth.at(frame).astype(np.float32) / 1000, transfer
            )
            for k, (camera, render, depth) in enumerate(zip(self.cameras, self.renders, self.depths))
        ]

    def residual(self, index: int, frame: int) -> Float[np.ndarray, "h w 3"]:
        """Float32 photo minus render of one camera, colours in 0..1."""
        photo = self.photo(index, frame)
        render = self.renders[index].at(frame)[: photo.shape[0], : photo.shape[1]]
        return (photo.astype(np.float32) - render.astype(np.float32)) / 255

    def reference(self, camera: Camera, frame: int) -> Integer[np.ndarray, "h w 3"]:
        """Photo of the same time from the training camera with the smallest angle between axes (U09)."""
        cosines = [float(one.forward @ camera.forward) for one in self.cameras]
        return self.photo(int(np.argmax(cosines)), frame)


@dataclass(frozen=True)
class TrainingFiles:
    """``Training`` as files: footage in the order of the model's cameras, and their render (film, path, depth), if any.

    Photos are divided by the gains and the light in ``exposure``, as the training pictures were: otherwise a residual
    would carry steps of exposure from camera to camera into the film.
    """

    model: Path
    manifest: Path
    videos: list[Path]
    train: list[Path]
    exposure: list[Path] = field(default_factory=list)

    def read(self) -> Training:
        """Raises UserError as ``open_training`` does."""
        frames, (renders, path, depths) = read_manifest(self.manifest).frames, self.train
        cameras, (steps, _) = read_model(self.model.parent), read_path(path)
        training = open_training(cameras, steps, self.videos, renders, depths, frames)
        return replace(training, exposure=read_factors(self.exposure, frames))


def open_training(
    cameras: list[Camera], steps: list[PathStep], videos: list[Path], renders: Path, depths: Path, frames: int
) -> Training:
    """The footage ``videos`` of ``cameras``, with their renders and depths, films of all cameras in sequence.

    Raises UserError when the films are of other cameras or frames.
    """
    segments = [step.segment for step in steps]
    of_all = [camera.name for camera in cameras for _ in range(frames)]
    require(renders, segments == of_all, f"it does not show {frames} frames of each training camera")
    parts = range(len(cameras))
    return Training(
        cameras,
        [Playback(one, 0, frames) for one in videos],
        [Playback(renders, part * frames, frames) for part in parts],
        [Playback(depths, part * frames, frames) for part in parts],
        frames,
    )
