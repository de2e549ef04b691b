# SPDX-License-Identifier: Apache-2.0
"""One camera's person masks, as in ``labelling``; given masks are only matched to the fitted people."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.camera_files.calibration import find_lens
from studiorecon.camera_files.colmap import camera_named, read_model
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import read_frames, write_lossless
from studiorecon.masks.detector_masks import masks_by_frame
from studiorecon.masks.labelling import Bodies, Film, Settings, segment
from studiorecon.masks.tracks import UNASSIGNED, assign_people
from studiorecon.masks.user_masks import label_given_masks, read_given
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_footage
from studiorecon.scene.factors import read_factors
from studiorecon.scene.people import read_detections, read_identities, split_tracks
from studiorecon.scene.raw_detections import read_raw_detections
from studiorecon.scene.step_files import require
from studiorecon.signature import Written
from studiorecon.splatting.rigid_object import read_objects

if TYPE_CHECKING:
    from jaxtyping import Integer


@dataclass(frozen=True)
class NetworkLabels:
    """A network's numbers of every frame, read again at every pass; raises UserError for a film of other size or
    length."""

    film: Path
    count: int
    hw: tuple[int, int]

    def __iter__(self) -> Iterator[Integer[np.ndarray, "H W"]]:
        wrong = f"it has not the {self.count} frames of {self.hw[1]}×{self.hw[0]} of the video"
        number = -1
        for number, labels in enumerate(read_frames(self.film)):
            require(self.film, labels.shape == self.hw and number < self.count, wrong)
            yield labels
        require(self.film, number + 1 == self.count, wrong)


@dataclass(frozen=True)
class FilmFiles:
    """A camera's film, its camera and footage files, and its clean plate."""

    model: Path
    video: Path
    plate: Path
    footage: Path
    calibration: Path


@dataclass(frozen=True)
class HintFiles:
    """Evidence that separates people from the plate.

    Attributes:
        objects: objects (none or one path), whose pixels belong to no person.
        brightness: factors to divide out of frames before they are compared with the plate, if any.
        seen: nothing, or three files for the detector's own masks: the detector's, the camera's detections,
            identities.tsv.
    """

    objects: list[Path] = field(default_factory=list)
    brightness: list[Path] = field(default_factory=list)
    seen: list[Path] = field(default_factory=list)


def run(
    settings: Settings,
    camera: str,
    film: FilmFiles,
    fits: list[Path],
    body: Path,
    given: list[Path],
    tracks: list[Path],
    hints: HintFiles,
    masks: Written,
) -> None:
    """Masks of ``camera`` for the fitted people, ``fits``.

    ``given`` (none or one path) are the user's masks, which stay as they are; ``tracks`` a network's film of numbers.
    """
    own = camera_named(read_model(film.model.parent), camera, film.model)
    frames = read_footage(film.footage).frames
    bodies = _bodies(fits, body, own, frames)
    persons, pixels = bodies.people, np.zeros(256, np.int64)
    labels: Iterable[np.ndarray]
    if given:
        brought = read_given(given[0], film.footage, film.calibration, frames)
        labels, described = label_given_masks(brought, bodies, len(persons), settings.outline.gate_m, own)
        sentence = f"masks of {given[0].name} are used as they are; {described}"
    elif tracks:
        labels, sentence = assign_people(NetworkLabels(tracks[0], frames, own.hw), bodies, len(persons))
    else:
        plate = read_plate(film.plate, own.wh)
        labels, sentence = _by_plate(settings, film, plate, bodies, hints), ""
    write_lossless(masks, count_labels(labels, pixels), persons[0].fps if persons else 30.0)
    sentence = sentence or describe_labels(pixels, [f.name for f in persons], float(plate[1].mean()))
    say(f"{camera}: {sentence}")


def _bodies(fits: Sequence[Path], body: Path, camera: Camera, frames: int) -> Bodies:
    """The fitted bodies as a camera sees them; UserError where one is not of this footage or body model."""
    model = BodyModel.load(body)
    return Bodies([read_person(path, frames, model) for path in fits], model, camera, frames)


def _by_plate(
    settings: Settings, film: FilmFiles, plate: tuple[np.ndarray, np.ndarray], bodies: Bodies, hints: HintFiles
) -> Iterator[np.ndarray]:
    """Labels of what differs from the plate near the bodies."""
    camera, frames = bodies.camera.name, bodies.count
    pictures = Film(film.video, camera, frames, read_factors(hints.brightness, frames))
    things = [thing for path in hints.objects for thing in read_objects(path)]
    found = None
    if hints.seen:
        whole, who = read_raw_detections(hints.seen[0], masks=True), read_identities(hints.seen[2])
        detections = split_tracks(read_detections(hints.seen[1]), who)
        about = find_lens(film.calibration, camera), read_footage(film.footage)
        found = masks_by_frame(whole, detections, who, *about)
    return segment(pictures, *plate, bodies, settings, things, found)


def count_labels(
    labels: Iterable[Integer[np.ndarray, "H W"]], pixels: Integer[np.ndarray, " 256"]
) -> Iterator[Integer[np.ndarray, "H W"]]:
    """Yields the labels unchanged; adds the number of pixels per label to ``pixels``."""
    for own in labels:
        pixels += np.bincount(own.ravel(), minlength=256)
        yield own


def describe_labels(pixels: Integer[np.ndarray, " 256"], names: Sequence[str], measured: float) -> str:
    """A sentence on the masks, from the number of pixels of each label."""
    shares = [f"{name} {pixels[k + 1] / pixels.sum():.1%}" for k, name in enumerate(names)]
    how = (
        "against the clean plate"
        if measured > 0.999
        else f"against the plate where known ({measured:.0%}), GrabCut for the rest"
    )
    return f"{', '.join(shares) or 'nobody'}, unassigned {pixels[UNASSIGNED] / pixels.sum():.2%} of the picture; {how}"
