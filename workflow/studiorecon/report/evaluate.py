# SPDX-License-Identifier: Apache-2.0
"""``report.evaluate``: measures how good a run's result is, where it can be measured: ``metrics.json``.

Pictures are compared with the held-out cameras' photos, bodies and identities with exact truth if there is any. Regions
of pictures come from exact truth, or else from the run's own depth and bodies. Every number comes with its definition,
its raw values per frame, and the libraries and settings behind it; one that could not be measured is null with the
reason. Without a held-out camera the training cameras are compared, under ``training``; the scene was fitted to those.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from studiorecon.body.person_files import read_person
from studiorecon.configuration.setting import setting
from studiorecon.footage.video import read_frames, read_frames_from
from studiorecon.images.flow import one_thread
from studiorecon.models.protocols import PerceptualDistance
from studiorecon.progress import progress, say
from studiorecon.report.metrics.bodies import compare_bodies
from studiorecon.report.metrics.bootstrap import Bootstrap
from studiorecon.report.metrics.definitions import NO_LPIPS, PROTOCOL, SEEN_BY, definitions, provenance
from studiorecon.report.metrics.distance import TOO_SMALL, Net, open_lpips
from studiorecon.report.metrics.estimated import SOURCE, EstimatedFiles, estimated_regions
from studiorecon.report.metrics.films import ScoredFilmFiles, ScoredFilms
from studiorecon.report.metrics.folders import digest
from studiorecon.report.metrics.identities import score_against, score_bodies_in_pictures, score_identities
from studiorecon.report.metrics.jitter import jitter
from studiorecon.report.metrics.measures import (
    NAMES,
    TEMPORAL,
    measure_sequence,
    missing_measure,
    null_reasons,
    summaries,
)
from studiorecon.report.metrics.overlap import overlap
from studiorecon.report.metrics.truth import Truth, read_truth, truth_regions
from studiorecon.report.sections.pictures import truth_shares
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import common_start
from studiorecon.scene.files import write_json
from studiorecon.scene.people import Person, read_detections, read_identities, split_tracks
from studiorecon.scene.schema import ListOf, OptionalField, flag, metres, real, text, whole
from studiorecon.scene.step_files import read
from studiorecon.signature import Place, Written
from studiorecon.splatting.device import resolve

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

_NO_HELD_OUT = "no camera is held out: name some under held_out in capture.yaml"
_NO_TRUTH = "there is no exact truth (only a synthetic studio has it)"
_NO_REGIONS = "no held-out camera has rendered depth"
_HELD_OUT = {
    "cameras": ListOf(
        {
            "camera": text(),
            "joints": whole(low=0),
            "before_px": OptionalField(real(low=0)),
            "after_px": OptionalField(real(low=0)),
            "turned_deg": real(low=0),
            "moved_m": metres(low=0),
            "is_verified": flag(),
            "places": whole(low=0),
            "sentence": text(),
        }
    )
}
_NO_DEPTH = "the studio stored no depth of people; set truth: {depth_frames: true} in its description"


@dataclass(frozen=True)
class Settings:
    """The measures and their settings.

    Attributes:
        seen_tolerance: a surface is seen when its depth agrees with a training camera's to this share (paper: 0.05,
            Seen/Unseen Fidelity; U57).
        flow_preset: effort of the optical flow of the photos that temporal measures use.
        bootstrap_samples: number of resamplings of frames for the 95 % intervals, by a generator of this ``seed``.
    """

    seen_tolerance: float = 0.05
    flow_preset: Literal["ultrafast", "fast", "medium"] = "fast"
    bootstrap_samples: int = 1000
    seed: int = 0
    lpips: Net = setting("none", "Network of LPIPS: alex as in most papers, vgg as in 3DGS; both need weights.")


def measure_camera(
    scored: ScoredFilms,
    camera: str,
    regions_of_frames: Iterator[Mapping[str, Bool[np.ndarray, "H W"]]],
    flow_preset: str,
    distance: PerceptualDistance | None,
) -> dict[str, list[dict[str, float | None]]]:
    """Measures per frame of each version of one camera, and the flicker of the photos themselves."""
    first, frames = scored.starts[camera], scored.capture.frames
    streams = {name: read_frames_from(path, first, first + frames) for name, path in scored.films.items()}

    def together() -> Iterator[tuple[np.ndarray, dict[str, np.ndarray], Mapping[str, np.ndarray]]]:
        for photo, masks in zip(read_frames(scored.footage[camera], 0, frames), regions_of_frames):
            # A film of cameras of different sizes has one size; a camera's own picture is its top left part.
            yield (
                photo,
                {name: next(stream)[: photo.shape[0], : photo.shape[1]] for name, stream in streams.items()},
                masks,
            )

    return measure_sequence(together(), flow_preset, distance)


def score_pictures(
    scored: ScoredFilms,
    truth: Truth | None,
    estimated: EstimatedFiles,
    people: Sequence[Person],
    settings: Settings,
    distance: PerceptualDistance | None,
) -> dict[str, Any]:
    """Measures of every version against the photos by regions, from exact truth, or else own depth and ``people``."""
    views = truth.views if truth is not None and scored.held_out else {}
    training, frames = [camera.name for camera in scored.training], scored.capture.frames
    tolerance = settings.seen_tolerance
    measured: dict[str, dict[str, list]] = {}
    for camera in progress(scored.cameras if scored.films else [], "cameras"):
        masks: Iterator[Mapping[str, np.ndarray]] = repeat({})
        if truth is not None and views:
            masks = truth_regions(views, camera, training, truth.first_frame, frames, tolerance)
        elif estimated.film_depth:
            start = scored.starts[camera.name]
            masks = estimated_regions(estimated, people, camera, scored.training, start, frames, tolerance)
        for name, values in measure_camera(scored, camera.name, masks, settings.flow_preset, distance).items():
            measured.setdefault(name, {})[camera.name] = values
    region = "no frame shows at least 256 pixels of it" if views or estimated.film_depth else _NO_REGIONS
    lpips = NO_LPIPS if settings.lpips == "none" else TOO_SMALL
    reasons = null_reasons(region, region, _NO_DEPTH if views else _NO_TRUTH, lpips)
    bootstrap = Bootstrap(settings.bootstrap_samples, settings.seed)
    return {
        name: summaries(found, TEMPORAL if name == "photo" else NAMES, reasons, bootstrap)
        for name, found in measured.items()
    }


def score_bodies(people: Sequence[Person], true: Mapping[str, Float[np.ndarray, "T 24 3"]] | None) -> dict[str, Any]:
    """Joint errors of the fits against the ``true`` joints of everybody, or the reason there are none."""
    nothing = {f"mpjpe_{kind}_mm": None for kind in ("world", "pelvis", "similarity")}
    if true is None:
        return {**nothing, "people": {}, "missed": [], "invented": [], "reason": _NO_TRUTH}
    fitted = {person.name: (person.joints, person.valid) for person in people}
    if not true:
        return {
            **nothing,
            "people": {},
            "missed": [],
            "invented": sorted(fitted),
            "reason": "no person is in the scene",
        }
    return compare_bodies(fitted, true, {person.name: person.sigma for person in people})


def coverage(truth_maps: Sequence[Path]) -> dict[str, Any]:
    """Shares of each shot's pixels that are measured, inferred and invented, averaged over pictures."""
    result = {}
    for path in truth_maps:
        shares = [truth_shares(frame) for frame in read_frames(path)]
        result[path.name.split(".")[0]] = {
            name: float(np.mean([s[name] for s in shares])) for name in ("measured", "inferred", "invented")
        }
    return result


@dataclass(frozen=True)
class PeopleFiles:
    """Results about people; ``uncorrected_identities``: association's own where ``identities`` is the user's table."""

    fits: list[Path] = field(default_factory=list)
    detections: list[Path] = field(default_factory=list)
    identities: list[Path] = field(default_factory=list)
    uncorrected_identities: list[Path] = field(default_factory=list)


def run(
    settings: Settings,
    films: ScoredFilmFiles,
    people: PeopleFiles,
    estimated: EstimatedFiles,
    poses: Path,
    truth_maps: list[Path],
    metrics: Written,
    truth: list[Path] | None = None,
    lpips: Place = Path("resources/weights/lpips"),
    calibrator: str = "none",
    device: str = "cpu",
    threads: int = 1,
) -> None:
    """Measure the result and write ``metrics``; LPIPS, with its weights in the folder ``lpips``, runs on ``device``.

    ``poses`` says whether the held-out cameras are still where they were calibrated. ``calibrator`` is the network that
    calibrated the cameras, including held-out ones, from a picture of each.
    """
    where = "cpu" if settings.lpips == "none" else resolve(device, "Pictures are compared by LPIPS")
    scored = films.read()
    exact = read_truth(truth[0], common_start(scored.capture.footage)) if truth else None
    with one_thread():
        distance = (
            open_lpips(settings.lpips, lpips, threads, "set report.lpips to none", where) if scored.films else None
        )
        fitted = [read_person(path) for path in people.fits]
        found = score_pictures(scored, exact, estimated, fitted, settings, distance)
    nothing = {name: {measure: missing_measure(_NO_HELD_OUT) for measure in NAMES} for name in ("raw", "enhanced")}
    pictures = found if scored.held_out and found else nothing
    bodies = score_bodies(fitted, None if exact is None else exact.joints)
    compared = [*films.render, *films.enhanced]
    source = "exact truth" if exact is not None else SOURCE if estimated.film_depth else "none"
    write_json(
        metrics,
        {
            "scene": scored.capture.scene,
            "pictures": pictures,
            "training": found if not scored.held_out and found else None,
            "held_out_cameras": read(poses, _HELD_OUT)["cameras"],
            "bodies": bodies,
            "jitter": {person.name: jitter(person.joints, person.poses, person.valid, person.fps) for person in fitted},
            "pck_bodies": _bodies_in_pictures(exact, scored, fitted),
            "identities": _identities(people, scored.training, {} if exact is None else exact.joints),
            "rig": overlap(scored.training),
            "coverage": coverage(truth_maps),
            "definitions": definitions(settings.lpips, exact is None),
            "provenance": provenance(asdict(settings), source),
            "inputs": {path.name: digest(path) for path in (*films.videos, *people.fits)}
            | {f"{path.parent.name}/{path.name}": digest(path) for path in compared},
            "protocol": PROTOCOL + (SEEN_BY.format(calibrator) if scored.held_out and calibrator != "none" else ""),
        },
    )
    _log_measures(pictures, bodies)


def _bodies_in_pictures(truth: Truth | None, scored: ScoredFilms, people: Sequence[Person]) -> dict[str, Any]:
    if truth is None or not truth.views or not scored.held_out:
        empty = {"pck_0.05": None, "pck_0.1": None, "detection_rate": None}
        return {**empty, "reason": _NO_HELD_OUT if truth is not None and truth.views else _NO_TRUTH}
    fitted = {person.name: (person.joints, person.valid) for person in people}
    about = truth.joints, truth.first_frame, scored.capture.frames
    found = score_bodies_in_pictures(truth.views, scored.held_out, fitted, *about)
    return found | {"reason": None if found["people"] else "no person is in the held-out pictures"}


def _identities(people: PeopleFiles, training: Sequence[Camera], joints: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Scores of the identities against the studio's truth, else of association's own table against the user's."""
    if people.detections and people.identities and (joints or people.uncorrected_identities):
        whose = read_identities(people.identities[0])
        seen = [split_tracks(read_detections(path), whose) for path in people.detections]
        if joints:
            return score_identities(seen, whose, {camera.name: camera for camera in training}, joints)
        return score_against(seen, whose, read_identities(people.uncorrected_identities[0]))
    reason = "no person was detected" if joints else _NO_TRUTH
    return {"accuracy": None, "precision": None, "idf1": None, "reason": reason}


def _log_measures(pictures: Mapping[str, Any], bodies: Mapping[str, Any]) -> None:
    for name in ("raw", "enhanced"):
        values = pictures.get(name, {}).get("psnr", missing_measure(_NO_HELD_OUT))
        if values["value"] is None:
            say(f"{name} pictures are not measured: {values['reason']}")
        else:
            say(
                f"{name} pictures at held-out cameras: PSNR {values['value']:.2f} dB, SSIM "
                f"{pictures[name]['ssim']['value']:.4f}"
            )
    if bodies["mpjpe_world_mm"] is None:
        say(f"joint errors are not measured: {bodies['reason']}")
    else:
        say(f"mean joint error: {bodies['mpjpe_world_mm']:.1f} mm, over {len(bodies['people'])} people")
