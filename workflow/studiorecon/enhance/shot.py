# SPDX-License-Identifier: Apache-2.0
"""``enhance.shot``: one shot, picture by picture, through an enhancer with motion-adaptive consistency injection."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np

from studiorecon.arrays import evenly_spread
from studiorecon.camera_files.colmap import read_model
from studiorecon.configuration.setting import setting
from studiorecon.enhance.backends import ResidualTransfer, flow_of, network
from studiorecon.enhance.recursion import enhanced, for_path, stands_still
from studiorecon.enhance.shared import Enhancing, Film, Injecting
from studiorecon.errors import UserError
from studiorecon.footage.stills import read_plate
from studiorecon.footage.streams import Writer, writing
from studiorecon.footage.video import Playback, read_frames, to_bytes, write_lossless, write_watchable
from studiorecon.images.transfer import ResidualSource, Transfer, best_strength, carried_over, source
from studiorecon.models.protocols import Enhancer
from studiorecon.progress import progress, say
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.factors import NONE, Factors, read_factors
from studiorecon.scene.path import PathStep, read_path
from studiorecon.signature import Place, Written

# Below this share of pixels seen by two training cameras at once, nothing can be said about the residual's worth.
_LEAST_EVIDENCE = 0.01


@dataclass(frozen=True)
class Settings(Enhancing, Injecting, Film):
    """How a film is enhanced; ``auto`` strength is judged on ``judged_frames`` pictures."""

    strength: float | Literal["auto"] = setting(
        "auto",
        "Share of the carried-over residual that is added; auto = the factor that best predicts each training"
        " camera from the others.",
        minimum=0,
        maximum=1,
    )
    judged_frames: int = 5
    transfer: Transfer = Transfer()


@dataclass(frozen=True)
class Training:
    """The training cameras' footage and renders, frame by frame; photos are shown in the ``exposure`` and light of the
    renders."""

    cameras: Sequence[Camera]
    photos: Sequence[Playback]
    renders: Sequence[Playback]
    depths: Sequence[Playback]
    frames: int
    exposure: Factors = NONE

    def photo(self, index: int, frame: int) -> np.ndarray:
        """(h, w, 3) uint8 photo of one camera, as it were filmed with the common exposure in the plate's light."""
        return self.exposure.even(self.cameras[index].name, self.photos[index].at(frame), frame)

    def nearest_frame(self, frame: float) -> int:
        """The whole frame that is shown at a fractional one."""
        return int(np.clip(round(frame), 0, self.frames - 1))

    def sources(self, frame: int, transfer: Transfer) -> list[ResidualSource]:
        """Residual and depth of every training camera at one frame."""
        return [
            source(camera, self.photo(k, frame), render.at(frame), depth.at(frame).astype(np.float32) / 1000, transfer)
            for k, (camera, render, depth) in enumerate(zip(self.cameras, self.renders, self.depths))
        ]

    def reference(self, camera: Camera, frame: int) -> np.ndarray:
        """(h, w, 3) uint8 photo of the same time from the training camera with the smallest angle between axes
        (U09)."""
        cosines = [float(one.forward @ camera.forward) for one in self.cameras]
        return self.photo(int(np.argmax(cosines)), frame)


def judge_strength(training: Training, settings: Settings) -> tuple[float, str]:
    """Strength of the residual transfer, and why: the factor that best predicts each training camera from the other
    ones.

    Undetermined, hence 0, when the training cameras see too little in common.
    """
    if settings.strength != "auto":
        return float(settings.strength), "as set"
    predicted, actual = [], []
    for frame in evenly_spread(training.frames, settings.judged_frames):
        sources = training.sources(int(frame), settings.transfer)
        for index, own in enumerate(sources):
            predicted.append(
                carried_over(own.camera, own.depth_m, sources[:index] + sources[index + 1 :], settings.transfer)
            )
            actual.append(own.residual)
    strength, evidence = best_strength(predicted, actual)
    if evidence < _LEAST_EVIDENCE:
        return (
            0.0,
            f"undetermined: only {100 * evidence:.1f} % of the training pixels are seen by a second training camera",
        )
    return strength, f"the best factor between training cameras, judged on {100 * evidence:.0f} % of their pixels"


def run(
    settings: Settings,
    shot: str,
    render: Path,
    render_path: Path,
    render_depth: Path,
    train: Path,
    train_path: Path,
    train_depth: Path,
    model: Path,
    manifest: Path,
    videos: list[Path],
    video: Written,
    film: Written,
    truth: list[Path] | None = None,
    edited: list[Path] | None = None,
    made: list[Path] | None = None,
    weights: Place = Path("resources/weights"),
    device: str = "cpu",
    exposure: list[Path] | None = None,
) -> None:
    """Enhance one shot; ``videos`` is the training footage in the order of the model's cameras, ``train*`` its renders.

    Photos are divided by the gains and the light that ``exposure`` names, as the training pictures were: a residual
    would carry steps of exposure from camera to camera into the film.

    A shot in which somebody stands in for a person brings its ``truth`` film: what it calls invented was never
    photographed, so no photo corrects it. An ``edited`` picture, if there is one, is what a network looks at instead of
    the photos (paper: one edited reference). A film that was ``made`` of this shot elsewhere stands as it is.
    """
    capture = read_manifest(manifest)
    steps, fps = read_path(render_path)
    writers = (
        lambda frames: write_lossless(video, frames, fps),
        lambda frames: write_watchable(film, frames, fps, settings.crf),
    )
    if made:
        _write(writers, made_elsewhere(made[0], render, len(steps)), shot, len(steps))
        say(f"shot {shot}: the pictures are those of {made[0]}")
        return
    training = training_of(
        read_model(model.parent), read_path(train_path)[0], videos, train, train_depth, capture.frames
    )
    training = replace(training, exposure=read_factors(exposure or [], capture.frames))
    search = flow_of(settings.flow, settings.flow_preset, weights, device)
    enhancer: Enhancer
    if settings.enhancer != "residual":
        enhancer = network(settings.enhancer, weights, device, settings.seed)
    else:
        strength, why = judge_strength(training, settings)
        say(f"shot {shot}: residuals of the training photos are carried over with strength {strength:.2f} ({why})")
        latest = lru_cache(maxsize=1)(lambda frame: training.sources(frame, settings.transfer))
        enhancer = ResidualTransfer(lambda frame: latest(training.nearest_frame(frame)), strength, settings.transfer)
    injection = for_path(settings.injection, steps)
    if injection.history and stands_still(steps, read_frames(render, 0, len(steps))):
        say(f"shot {shot} stands still, so there is nothing to steady: no earlier outputs are injected")
        injection = replace(injection, history=0)
    say(
        f"shot {shot}: the {injection.history} latest outputs are injected with strength "
        f"{injection.strength} at full confidence"
    )

    instead = to_bytes(read_plate(edited[0])[0]) if edited else None

    def reference(step: PathStep) -> np.ndarray:
        return training.reference(step.camera, training.nearest_frame(step.frame)) if instead is None else instead

    depths = read_frames(render_depth, 0, len(steps))
    if truth:
        depths = (
            np.where(level > 0, depth, 0)
            for depth, level in zip(depths, read_frames(truth[0], 0, len(steps)), strict=True)
        )
    pictures = read_frames(render, 0, len(steps))
    outputs = enhanced(steps, pictures, depths, reference, enhancer, injection, search)
    _write(writers, outputs, shot, len(steps))


def made_elsewhere(film: Path, render: Path, count: int) -> Iterator[np.ndarray]:
    """(h, w, 3) uint8 pictures of a film that was made from a shot's render; raises UserError when it is of another
    number or size."""
    (drawn,) = read_frames(render, 0, 1)
    pictures = read_frames(film)
    number = -1
    for number, picture in enumerate(pictures):
        if picture.shape != drawn.shape:
            raise UserError(
                f"{film} is {picture.shape[1]}×{picture.shape[0]} and {render} "
                f"{drawn.shape[1]}×{drawn.shape[0]}; enhance what was rendered"
            )
        if number < count:
            yield picture
    if number + 1 != count:
        raise UserError(
            f"{film} has {number + 1} pictures and {render} has {count}; enhance every picture of the shot as it is now"
        )


def _write(writers: Sequence[Writer], outputs: Iterable[np.ndarray], shot: str, count: int) -> None:
    with writing(writers) as put:
        for output in progress(outputs, f"pictures of {shot}", total=count):
            put(output, output)


def training_of(
    cameras: list[Camera], steps: list[PathStep], videos: list[Path], renders: Path, depths: Path, frames: int
) -> Training:
    """The footage ``videos`` of ``cameras``, with their renders and depths, which are films of one camera after the
    other (``steps``).

    Raises UserError when the films are of other cameras or frames.
    """
    segments = [step.segment for step in steps]
    if [camera.name for camera in cameras] != list(dict.fromkeys(segments)) or len(segments) != len(cameras) * frames:
        raise UserError(f"{renders} does not show {frames} frames of each training camera; render the shot train again")
    parts = range(len(cameras))
    return Training(
        cameras,
        [Playback(one, 0, frames) for one in videos],
        [Playback(renders, part * frames, frames) for part in parts],
        [Playback(depths, part * frames, frames) for part in parts],
        frames,
    )
