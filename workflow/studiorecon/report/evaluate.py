# SPDX-License-Identifier: Apache-2.0
"""``report.evaluate``: measures how good a run's result is, where it can be measured: ``metrics.json``.

Pictures are compared with the held-out cameras' photos, bodies and identities with exact truth if there is any. Every
number comes with its definition, its raw values per frame, and the libraries and settings behind it. A value that could
not be measured is null with the reason. Without a held-out camera the training cameras are compared, under
``training``; their scores say little about other views, because the scene was fitted to them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.footage.video import read_frames, read_frames_from
from studiorecon.images.flow import one_thread
from studiorecon.models.protocols import PerceptualDistance
from studiorecon.progress import progress, say
from studiorecon.report.metrics.bodies import compare_bodies
from studiorecon.report.metrics.bootstrap import Bootstrap
from studiorecon.report.metrics.definitions import NO_LPIPS, PROTOCOL, SEEN_BY, definitions, provenance
from studiorecon.report.metrics.distance import TOO_SMALL, Net, no_flip, opened
from studiorecon.report.metrics.films import first_frames
from studiorecon.report.metrics.folders import digest
from studiorecon.report.metrics.identities import score_against, score_bodies_in_pictures, score_identities
from studiorecon.report.metrics.jitter import jitter
from studiorecon.report.metrics.measures import (
    NAMES,
    REGIONS,
    SENSITIVITY,
    SHARES,
    TEMPORAL,
    measure_sequence,
    missing_measure,
    summaries,
)
from studiorecon.report.metrics.overlap import overlap
from studiorecon.report.metrics.truth import read_views, regions, true_joints
from studiorecon.report.sections.pictures import truth_shares
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import common_start, read_manifest
from studiorecon.scene.files import write_json
from studiorecon.scene.people import Person, read_detections, read_identities
from studiorecon.scene.schema import Anything
from studiorecon.scene.step_files import read
from studiorecon.signature import Place, Written
from studiorecon.splatting.device import resolve

if TYPE_CHECKING:
    from jaxtyping import Bool

_NO_HELD_OUT = "no camera is held out: name some under held_out in capture.yaml"
_NO_TRUTH = "there is no exact truth (only a synthetic studio has it)"
_NO_DEPTH = "the studio kept no depth of the people: truth: {depth_frames: true} in its description"

# version → film and the index in it of each camera's first frame.
Versions = Mapping[str, tuple[Path, Mapping[str, int]]]
RegionsOf = Callable[[Camera], Iterator[Mapping[str, np.ndarray]]]


@dataclass(frozen=True)
class Settings:
    """The measures and their settings.

    Attributes:
        seen_tolerance: a surface is seen when its depth agrees with a training camera's to this share (paper: 0.05,
            Seen/Unseen Fidelity; U57). ``seen_sensitivity``: other shares at which the same is reported.
        flow_preset: effort of the optical flow of the photos that temporal measures use.
        bootstrap_samples: number of resamplings of frames for the 95 % intervals, by a generator of this ``seed``.
    """

    seen_tolerance: float = 0.05
    seen_sensitivity: tuple[float, float] = (0.02, 0.1)
    flow_preset: Literal["ultrafast", "fast", "medium"] = "fast"
    bootstrap_samples: int = 1000
    seed: int = 0
    lpips: Net = setting(
        "none", "Network of LPIPS: alex is what papers call LPIPS, vgg is in the lineage of 3DGS; both need weights."
    )


def missing_reasons(have_truth: bool, net: str) -> dict[str, str]:
    """The reasons why a measure of a region, of time, or LPIPS with ``net``, may be null."""
    region = "no frame shows at least 256 pixels of it" if have_truth else _NO_TRUTH
    reasons = {f"{measure}_{name}": region for name in (*REGIONS, *SENSITIVITY) for measure in ("psnr", "ssim")}
    reasons |= dict.fromkeys(SHARES, region)
    if have_truth:
        reasons |= dict.fromkeys(
            ("psnr_people_seen", "psnr_people_unseen", "ssim_people_seen", "ssim_people_unseen"), _NO_DEPTH
        )
        reasons |= {"share_people_seen": _NO_DEPTH}
    reasons |= dict.fromkeys(TEMPORAL, "needs at least two frames of 24 pixels a side")
    reasons |= dict.fromkeys(("temporal_l1_seen", "temporal_l1_unseen"), region)
    reasons["flip"] = no_flip()
    reasons["lpips"] = NO_LPIPS if net == "none" else TOO_SMALL
    return reasons | dict.fromkeys(("ssim", "ssim_3dgs"), "pictures are under 11 pixels a side")


def measure_camera(
    camera: str,
    photos: Path,
    versions: Versions,
    frames: int,
    regions_of_frames: Iterator[Mapping[str, Bool[np.ndarray, "H W"]]],
    flow_preset: str,
    distance: PerceptualDistance | None,
) -> dict[str, list[dict[str, float | None]]]:
    """Measures per frame of each version of one camera, and the flicker of the photos themselves."""
    streams = {
        name: read_frames_from(path, starts[camera], starts[camera] + frames)
        for name, (path, starts) in versions.items()
    }

    def together() -> Iterator[tuple[np.ndarray, dict[str, np.ndarray], Mapping[str, np.ndarray]]]:
        for photo, masks in zip(read_frames(photos, 0, frames), regions_of_frames):
            # A film of cameras of different sizes has one size; a camera's own picture is its top left part.
            yield (
                photo,
                {name: next(stream)[: photo.shape[0], : photo.shape[1]] for name, stream in streams.items()},
                masks,
            )

    return measure_sequence(together(), flow_preset, distance)


def score_pictures(
    frames: int,
    cameras: Sequence[Camera],
    videos: Mapping[str, Path],
    versions: Versions,
    regions_of: RegionsOf | None,
    settings: Settings,
    lpips: Path,
    threads: int,
    device: str = "cpu",
) -> dict[str, Any]:
    """Measures of every version against the photos of ``cameras``; LPIPS on ``device``."""
    distance = opened(settings.lpips, lpips, threads, "set report.lpips to none", device)
    measured: dict[str, dict[str, list]] = {}
    for camera in progress(cameras, "cameras"):
        masks = regions_of(camera) if regions_of is not None else repeat({})
        about = videos[camera.name], versions, frames, masks, settings.flow_preset, distance
        for name, values in measure_camera(camera.name, *about).items():
            measured.setdefault(name, {})[camera.name] = values
    reasons, bootstrap = (
        missing_reasons(regions_of is not None, settings.lpips),
        Bootstrap(settings.bootstrap_samples, settings.seed),
    )
    return {
        name: summaries(found, TEMPORAL if name == "photo" else NAMES, reasons, bootstrap)
        for name, found in measured.items()
    }


def score_bodies(people: Sequence[Person], truth: Path | None, first_frame: int) -> dict[str, Any]:
    """Joint errors of the fits against the true bodies, or the reason there are none."""
    nothing = {f"mpjpe_{kind}_mm": None for kind in ("world", "pelvis", "similarity")}
    if truth is None:
        return {**nothing, "people": {}, "missed": [], "invented": [], "reason": _NO_TRUTH}
    true = {name: joints[first_frame:] for name, joints in true_joints(truth).items()}
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
    """Shares of each shot's pixels that are measured, inferred and invented, averaged over pictures.

    Needs neither truth nor photos.
    """
    result = {}
    for path in truth_maps:
        shares = [truth_shares(frame) for frame in read_frames(path)]
        result[path.name.split(".")[0]] = {
            name: float(np.mean([s[name] for s in shares])) for name in ("measured", "inferred", "invented")
        }
    return result


def run(
    settings: Settings,
    scene: str,
    manifest: Path,
    model: Path,
    heldout_model: Path,
    poses: Path,
    videos: list[Path],
    render: list[Path],
    render_path: list[Path],
    enhanced: list[Path],
    truth_maps: list[Path],
    fits: list[Path],
    detections: list[Path],
    identities: list[Path],
    by_itself: list[Path],
    metrics: Written,
    truth: list[Path] | None = None,
    lpips: Place = Path("resources/weights/lpips"),
    calibrator: str = "none",
    device: str = "cpu",
    threads: int = 1,
) -> None:
    """Measure the result and write ``metrics``.

    ``videos``, ``render`` and ``enhanced`` are those of the held-out cameras or, without any, of the training cameras.
    ``poses`` says whether the held-out cameras are still where they were calibrated. ``by_itself`` is association's own
    table where ``identities`` is the user's. ``lpips`` is the folder of LPIPS' weights; LPIPS runs on ``device``.
    ``calibrator`` is the network that calibrated the cameras, including held-out ones, from a picture of each.
    """
    where = "cpu" if settings.lpips == "none" else resolve(device, "Pictures are compared by LPIPS")
    capture = read_manifest(manifest)
    training, held_out = read_model(model.parent), read_model(heldout_model.parent)
    exact = truth[0] if truth else None
    if exact is not None and not exact.is_dir():
        raise UserError(f"{exact} is not a folder of exact truth; make the studio again, or leave --truth out")
    cameras, first = held_out or training, common_start(capture.footage)
    starts = first_frames(render_path[0], cameras, capture) if render_path else {}
    versions = {
        name: (files[0], starts) for name, files in (("raw", render), ("enhanced", enhanced)) if files and render_path
    }
    views, regions_of = read_views(exact) if exact is not None else {}, None
    if views and held_out:
        names = [camera.name for camera in training]

        def regions_of(camera: Camera) -> Iterator[dict[str, np.ndarray]]:
            return regions(
                views, camera, names, first, capture.frames, settings.seen_tolerance, settings.seen_sensitivity
            )

    with one_thread():
        footage = {video.stem: video for video in videos}
        found = (
            score_pictures(capture.frames, cameras, footage, versions, regions_of, settings, lpips, threads, where)
            if versions
            else {}
        )
    nothing = {name: {measure: missing_measure(_NO_HELD_OUT) for measure in NAMES} for name in ("raw", "enhanced")}
    people = [read_person(path) for path in fits]
    bodies = score_bodies(people, exact, first)
    joints = {name: values[first:] for name, values in true_joints(exact).items()} if exact is not None else {}
    write_json(
        metrics,
        {
            "scene": scene,
            "pictures": found if held_out and found else nothing,
            "training": found if not held_out and found else None,
            "held_out_cameras": read(poses, {"cameras": Anything()})["cameras"],
            "bodies": bodies,
            "jitter": {person.name: jitter(person.joints, person.poses, person.valid, person.fps) for person in people},
            "pck_bodies": _bodies_in_pictures(views, held_out, people, joints, first, capture.frames),
            "identities": _identities(detections, identities, by_itself, training, joints),
            "rig": overlap(training),
            "coverage": coverage(truth_maps),
            "definitions": definitions(settings.lpips),
            "provenance": provenance(asdict(settings), "exact truth" if exact is not None else "none"),
            "inputs": {path.name: digest(path) for path in (*videos, *fits)}
            | {f"{path.parent.name}/{path.name}": digest(path) for path in (*render, *enhanced)},
            "protocol": PROTOCOL + (SEEN_BY.format(calibrator) if held_out and calibrator != "none" else ""),
        },
    )
    _log_measures(found if held_out and found else nothing, bodies)


def _bodies_in_pictures(
    views: Mapping,
    cameras: Sequence[Camera],
    people: Sequence[Person],
    joints: Mapping[str, np.ndarray],
    first: int,
    frames: int,
) -> dict[str, Any]:
    empty = {"pck_0.05": None, "pck_0.1": None, "detection_rate": None}
    if not views or not cameras:
        return {**empty, "reason": _NO_HELD_OUT if views else _NO_TRUTH}
    fitted = {person.name: (person.joints, person.valid) for person in people}
    found = score_bodies_in_pictures(views, cameras, fitted, joints, first, frames)
    return found | {"reason": None if found["people"] else "no person is in the held-out pictures"}


def _identities(
    detections: Sequence[Path],
    identities: Sequence[Path],
    by_itself: Sequence[Path],
    training: Sequence[Camera],
    joints: Mapping[str, np.ndarray],
) -> dict[str, Any]:
    """Scores of the identities against the studio's truth, else of association's own table against the user's."""
    if not joints and detections and identities and by_itself:
        seen = [read_detections(path) for path in detections]
        return score_against(seen, read_identities(identities[0]), read_identities(by_itself[0]))
    if not joints or not detections or not identities:
        return {
            "accuracy": None,
            "precision": None,
            "idf1": None,
            "reason": "no person was detected" if joints else _NO_TRUTH,
        }
    found = [read_detections(path) for path in detections]
    return score_identities(found, read_identities(identities[0]), {camera.name: camera for camera in training}, joints)


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
