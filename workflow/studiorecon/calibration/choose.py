# SPDX-License-Identifier: Apache-2.0
"""``calibration.choose``: matches films to cameras, and locates a film's pixels in the calibrated picture.

Where names and sizes are ambiguous, people decide: under the right reading the rays of their joints meet. Without
evidence the usual reading is used, with a message.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.calibration.files import LengthUnit, paired_lenses, possible_pairings
from studiorecon.calibration.files import Settings as Settings
from studiorecon.calibration.film_places import choose_places, possible_places
from studiorecon.calibration.formats.reading import Reading, read_reading
from studiorecon.calibration.names import Pairing, mismatch_error
from studiorecon.calibration.people_evidence import agreement, best_candidate, is_in_metres
from studiorecon.calibration.second_undistortion import without_second_undistortion
from studiorecon.footage.frames import seek_frames
from studiorecon.footage.source import open_source
from studiorecon.geometry.crop_hypotheses import (
    CropHypothesis,
    area_inside_bars,
    for_square_pixels,
)
from studiorecon.geometry.lens import rayless_share, same_shape
from studiorecon.keypoints.motion import Motion, film_motion
from studiorecon.progress import say
from studiorecon.scene.camera import Lens
from studiorecon.scene.files import write_json
from studiorecon.scene.people import Detections, read_detections
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Float

# Pictures of a film in which black bars are measured: a dark one among them hides no bar.
_PICTURES = 5
# Units a factor of ten apart: people have an adult's stature in one of them at most.
_UNITS: tuple[LengthUnit, ...] = ("m", "cm", "mm")


@dataclass(frozen=True)
class Choice:
    """A reading of the calibration, and the sentences about it."""

    lenses: list[Lens]
    notes: list[str]
    floor_known: bool


def choose_lenses(
    reading: Reading,
    source: str,
    cameras: Sequence[str],
    sizes: Sequence[tuple[int, int]],
    people: Sequence[Detections],
    pixel_maps: dict[str, Sequence[float]],
    settings: Settings,
    stored: Sequence[tuple[int, int]] = (),
    areas: Mapping[str, Float[np.ndarray, " 4"]] = MappingProxyType({}),
    recorded: Collection[str] = (),
    motions: Callable[[], Mapping[str, Motion]] = dict,
) -> Choice:
    """The lenses of ``cameras`` by names, sizes and ``people`` (by frames of the films).

    Their films have ``sizes`` as shown and ``stored`` ones where those differ; ``areas`` are their parts (left, top,
    right, bottom) inside of black bars, for films of another shape. ``recorded`` cameras have keypoints from files,
    which may be in pixels of the calibration, or undistorted; ``motions`` returns the motion in their films. Raises
    UserError for names that neither match nor are decided by people, and for sizes of other shapes.
    """

    def read(pairing: Pairing, unit: LengthUnit = settings.unit) -> tuple[list[Lens], list[str], bool]:
        chosen = replace(settings, unit=unit)
        lenses, notes, floor_known = paired_lenses(reading, source, cameras, pixel_maps, chosen, pairing)
        square = [for_square_pixels(lens, *both) for lens, *both in zip(lenses, stored or sizes, sizes, strict=True)]
        return [lens for lens, _ in square], notes + [note for _, note in square if note], floor_known

    def places(lenses: Sequence[Lens]) -> list[list[CropHypothesis]]:
        return [
            possible_places(lens, wh, areas.get(camera), camera in recorded)
            for camera, lens, wh in zip(cameras, lenses, sizes, strict=True)
        ]

    def usual(lenses: Sequence[Lens]) -> list[Lens]:
        return [options[0].lens for options in places(lenses)]

    ways = possible_pairings(reading, cameras, source)
    index, shown = (
        best_candidate(ways, lambda way: agreement(usual(read(way)[0]), sizes, people)) if len(ways) > 1 else (0, False)
    )
    if not (ways[index].sure or shown):
        raise mismatch_error(cameras, [c.name for c in reading.cameras], source)
    lenses, notes, floor_known = read(ways[index])
    guessed = reading.unit == "unknown" and settings.unit == "auto" and settings.scale == 1.0
    if guessed and is_in_metres(usual(lenses), sizes, people) is False:
        for unit in _UNITS:
            other = read(ways[index], unit)
            if is_in_metres(usual(other[0]), sizes, people):
                lenses, notes, floor_known = other
                notes = [note for note in notes if "calibration.unit" not in note] + [
                    f"the file does not state its unit; people are of human size if lengths are {unit}; set "
                    "calibration.unit if that is wrong"
                ]
    if len(ways) > 1:
        notes.append(
            f"people show that this is the right one of {len(ways)} ways of pairing videos and cameras"
            if shown
            else f"people do not decide between the {len(ways)} ways of pairing them; rename the videos if it is wrong"
        )
    lenses, placed = choose_places(places(lenses), sizes, people)
    if settings.lens == "as_read" and not settings.radial:
        lenses, undistorted = without_second_undistortion(lenses, sizes, people, motions)
        placed += undistorted
    return Choice(lenses, notes + placed, floor_known)


def run(
    settings: Settings,
    read: Path,
    cameras: list[str],
    sources: list[Path],
    sightings: list[Path],
    pixel_maps: str,
    picture_fps: float,
    recorded: list[str],
    calibration: Written,
) -> None:
    """Write ``calibration`` (JSON): the lenses of ``cameras`` from the ``read`` calibration, chosen by the people of
    ``sightings``.

    ``sources`` are the cameras' films. ``recorded`` cameras have keypoints from files, in pixels that the setting
    ``detect.keypoint_pixels`` leaves open.
    """
    reading, source = read_reading(read)
    films = [open_source(source, picture_fps) for source in sources]
    sizes, stored = [film.wh for film in films], [film.stored_wh for film in films]
    seen = {d.camera: d for d in map(read_detections, sightings)}
    nobody = np.zeros(0, dtype=int)
    people = [seen.get(c) or Detections(c, "coco17", nobody, nobody, np.zeros((0, 17, 3))) for c in cameras]
    maps = json.loads(pixel_maps or "{}")
    known = [c.wh for c in reading.cameras]
    areas = {
        camera: area_inside_bars(
            seek_frames(film, np.linspace(0, film.frames - 1, _PICTURES).round().astype(int).tolist())
        )
        for camera, film in zip(cameras, films, strict=True)
        if not any(0 in wh or same_shape(wh, film.wh) or same_shape(wh, film.stored_wh) for wh in known)
    }

    def motions() -> Mapping[str, Motion]:
        given = [(c, f, d.frame) for c, f, d in zip(cameras, films, people, strict=True) if c in recorded]
        found = {c: film_motion(film, int(at.min()), int(at.max())) for c, film, at in given if len(at)}
        return {camera: motion for camera, motion in found.items() if motion is not None}

    choice = choose_lenses(
        reading, source, cameras, sizes, people, maps, settings, stored, areas, set(recorded), motions
    )
    doubts = []
    for lens, wh in zip(choice.lenses, sizes, strict=True):
        if share := rayless_share(lens, wh):
            doubts.append(
                f"camera {lens.name}: the lens distortion cannot be inverted in {share:.1%} of its picture (at the "
                "corners), which is not used"
            )
    say(f"{len(choice.lenses)} cameras from {source} ({reading.format})")
    for note in [*choice.notes, *doubts]:
        say(note)
    write_json(
        calibration,
        {
            "source": source,
            "format": reading.format,
            "lenses": [lens.as_json() for lens in choice.lenses],
            "floor_known": choice.floor_known,
            "notes": choice.notes,
            "doubts": doubts,
        },
    )
