# SPDX-License-Identifier: Apache-2.0
"""``calibration.choose``: matches films to cameras, and locates a film's pixels in the calibrated picture.

Where names and sizes are ambiguous, people decide: under the right reading the rays of their joints meet. Without
evidence the usual reading is used, with a message.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from studiorecon.arrays import evenly_spread
from studiorecon.calibration.files import Settings as Settings
from studiorecon.calibration.files import paired_lenses, possible_pairings
from studiorecon.calibration.formats.reading import Reading
from studiorecon.calibration.names import Pairing, mismatch_error
from studiorecon.footage.source import open_source
from studiorecon.geometry.crop_hypotheses import CropHypothesis, crop_hypotheses, for_square_pixels
from studiorecon.geometry.lens import unseen_share
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.keypoints.detections import to_pinhole
from studiorecon.progress import say
from studiorecon.rig.correspondences import make_observations
from studiorecon.scene import step_files
from studiorecon.scene.camera import Lens
from studiorecon.scene.files import write_json
from studiorecon.scene.people import Detections, read_detections
from studiorecon.scene.schema import Anything, MappingOf
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Float

T = TypeVar("T")
_FRAMES = 24
# As where cameras are judged on people; wide, since a calibration may be slightly off and still be the right one.
_GATE_M = 0.25
_LIMITS = Limits(outlier_units=9.0)
# Error of detectors, as a share of the longer side (6 of 1920 px).
_NOISE_SHARE = 0.003
# Standard errors by which a reading must be better than the usual one: 1 in 700 by chance.
_SURE = 3.0


@dataclass(frozen=True)
class Choice:
    """A reading of the calibration, and the sentences about it."""

    lenses: list[Lens]
    notes: list[str]
    floor_known: bool


def agreement(
    lenses: Sequence[Lens], sizes: Sequence[tuple[int, int]], people: Sequence[Detections]
) -> Float[np.ndarray, " F"]:
    """(F,) log-likelihood ratio of people's joints in each of 24 frames, lenses against chance, summed; 0 where no rays
    meet."""
    last = max((int(d.frame.max()) for d in people if len(d.frame)), default=-1)
    frames = evenly_spread(last + 1, _FRAMES) if last >= 0 else np.zeros(0, int)
    total = np.zeros(len(frames))
    both = [to_pinhole(d, lens, wh) for d, lens, wh in zip(people, lenses, sizes, strict=True)]
    cameras, seen = [c for c, _ in both], [d for _, d in both]
    if not any(len(d.frame) for d in seen):
        return total
    found, _ = make_observations(seen, cameras, frames, _GATE_M)
    if not len(found.frame):
        return total
    points = triangulate(found.pixels, found.confidence, cameras, _LIMITS)
    counted = points.inliers & (points.verified if len(cameras) > 2 else points.valid)
    longer = np.array([[max(wh)] for wh in sizes], float)
    noise, gate = _NOISE_SHARE * longer, _LIMITS.huber_share * _LIMITS.outlier_units * longer
    error = np.where(counted, points.error_px, gate)
    # Cauchy's distribution: a calibration that is somewhat off is still far better than a wrong one.
    fit = np.maximum(np.log((gate**2 + noise**2) / (error**2 + noise**2)), 0.0).sum(0)
    np.add.at(total, np.searchsorted(frames, found.frame), fit)
    return total


def best_candidate(candidates: Sequence[T], fit: Callable[[T], Float[np.ndarray, " F"]]) -> tuple[int, bool]:
    """Index of the candidate that people show to be right, else 0; and whether they do."""
    scores = [fit(candidate) for candidate in candidates]
    order = np.argsort([-s.sum() for s in scores], kind="stable")
    first = int(order[0])

    def clearly(better: np.ndarray, other: np.ndarray) -> bool:
        gain = better - other
        return bool(gain.sum() > 0 and gain.mean() > _SURE * gain.std() / np.sqrt(max(len(gain), 1)))

    if all(clearly(scores[first], scores[int(other)]) for other in order[1:]):
        return first, len(scores) > 1
    # Of several that fit about equally well the likeliest one, unless people show that it is wrong.
    equal = [i for i in range(len(scores)) if not clearly(scores[first], scores[i])]
    return equal[0], False


def choose_lenses(
    reading: Reading,
    source: str,
    cameras: Sequence[str],
    sizes: Sequence[tuple[int, int]],
    people: Sequence[Detections],
    pixel_maps: dict[str, Sequence[float]],
    settings: Settings,
    stored: Sequence[tuple[int, int]] = (),
) -> Choice:
    """The lenses of ``cameras`` by names, sizes and ``people`` (by frames of the films).

    Their films have ``sizes`` as shown and ``stored`` ones where those differ. Raises UserError for names that neither
    match nor are decided by people, and for sizes of other shapes.
    """

    def read(pairing: Pairing) -> tuple[list[Lens], list[str], bool]:
        lenses, notes, floor_known = paired_lenses(reading, source, cameras, pixel_maps, settings, pairing)
        square = [for_square_pixels(lens, *both) for lens, *both in zip(lenses, stored or sizes, sizes, strict=True)]
        return [lens for lens, _ in square], notes + [note for _, note in square if note], floor_known

    def usual(lenses: Sequence[Lens]) -> list[Lens]:
        return [crop_hypotheses(lens, wh)[0].lens for lens, wh in zip(lenses, sizes, strict=True)]

    ways = possible_pairings(reading, cameras, source)
    index, shown = (
        best_candidate(ways, lambda way: agreement(usual(read(way)[0]), sizes, people)) if len(ways) > 1 else (0, False)
    )
    if not (ways[index].sure or shown):
        raise mismatch_error(cameras, [c.name for c in reading.cameras], source)
    lenses, notes, floor_known = read(ways[index])
    if len(ways) > 1:
        notes.append(
            f"people show that this is the right one of {len(ways)} ways of pairing videos and cameras"
            if shown
            else f"people do not decide between the {len(ways)} ways of pairing them; rename the videos if it is wrong"
        )
    lenses, placed = _placed(lenses, sizes, people)
    return Choice(lenses, notes + placed, floor_known)


def _placed(
    lenses: Sequence[Lens], sizes: Sequence[tuple[int, int]], people: Sequence[Detections]
) -> tuple[list[Lens], list[str]]:
    """The lenses with the position of each film, and sentences about assumed ones.

    Films with the same pair of sizes have the same position: one program made them.
    """
    options = [crop_hypotheses(lens, wh) for lens, wh in zip(lenses, sizes, strict=True)]
    kinds = sorted({(lens.wh, wh) for lens, wh, of in zip(lenses, sizes, options) if len(of) > 1})
    counts = [len(next(of for lens, wh, of in zip(lenses, sizes, options) if (lens.wh, wh) == kind)) for kind in kinds]

    def of(choice: Sequence[int]) -> list[CropHypothesis]:
        at = dict(zip(kinds, choice))
        return [of[at.get((lens.wh, wh), 0)] for lens, wh, of in zip(lenses, sizes, options)]

    ways = [of(choice) for choice in itertools.product(*map(range, counts))]
    index, shown = (
        best_candidate(ways, lambda way: agreement([p.lens for p in way], sizes, people))
        if len(ways) > 1
        else (0, False)
    )
    why = "as people show" if shown else "the usual place, which people do not contradict"
    remedy = "" if shown else "; if that is wrong, give it in capture.yaml: pixel_maps"
    notes = [f"camera {p.lens.name}: {p.how} ({why}){remedy}" for p in ways[index] if p.how]
    return [p.lens for p in ways[index]], notes


def run(
    settings: Settings,
    read: Path,
    cameras: list[str],
    sources: list[Path],
    sightings: list[Path],
    pixel_maps: str,
    picture_fps: float,
    calibration: Written,
) -> None:
    """Write ``calibration`` (JSON): the lenses of ``cameras`` from the ``read`` calibration, chosen by the people of
    ``sightings``.

    ``sources`` are the cameras' films.
    """
    content, reading = step_files.read(
        read,
        MappingOf(Anything()),
        lambda held: (held, Reading.from_json({k: v for k, v in held.items() if k != "source"})),
    )
    films = [open_source(source, picture_fps) for source in sources]
    sizes, stored = [film.wh for film in films], [film.stored_wh for film in films]
    seen = {d.camera: d for d in map(read_detections, sightings)}
    nobody = np.zeros(0, dtype=int)
    people = [seen.get(c) or Detections(c, "coco17", nobody, nobody, np.zeros((0, 17, 3))) for c in cameras]
    maps = json.loads(pixel_maps or "{}")
    choice = choose_lenses(reading, content["source"], cameras, sizes, people, maps, settings, stored)
    doubts = []
    for lens, wh in zip(choice.lenses, sizes, strict=True):
        if share := unseen_share(lens, wh):
            doubts.append(
                f"camera {lens.name}: the lens model has no ray for {share:.1%} of its picture, whose corners are not "
                "used: its numbers turn over there"
            )
    say(f"{len(choice.lenses)} cameras from {content['source']} ({reading.format})")
    for note in [*choice.notes, *doubts]:
        say(note)
    write_json(
        calibration,
        {
            "source": content["source"],
            "format": reading.format,
            "lenses": [lens.as_json() for lens in choice.lenses],
            "floor_known": choice.floor_known,
            "notes": choice.notes,
            "doubts": doubts,
        },
    )
