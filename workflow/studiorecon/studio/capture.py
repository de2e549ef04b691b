# SPDX-License-Identifier: Apache-2.0
"""``studio.capture``: a description → a dataset like a user's, and beside it the exact truth that only ``report`` may
read.

The cameras are filmed side by side in separate processes; each traces the empty room once and then what moves.
"""

from __future__ import annotations

import multiprocessing
import shutil
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import write_person
from studiorecon.errors import UserError
from studiorecon.footage.exr import write_depth
from studiorecon.footage.video import write_lossless, write_watchable
from studiorecon.images.encoded import write_png
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.progress import progress, say
from studiorecon.scene.camera import Lens
from studiorecon.scene.files import write_json, write_text
from studiorecon.signature import Place, Written
from studiorecon.studio import rig
from studiorecon.studio.actors import Actors
from studiorecon.studio.calibration import calibration_texts
from studiorecon.studio.description import RESOURCES, Description, planned_dataset, read_description
from studiorecon.studio.detections import detect, openpose_json
from studiorecon.studio.film import Backdrop, backdrop, exposed, touched_pixels
from studiorecon.studio.meshes import Mesh
from studiorecon.studio.room import room
from studiorecon.studio.sensor import Sensor, developed, sensor_of
from studiorecon.studio.tracing import Tracer
from studiorecon.studio.truth import TruthFrames

FACTS = "truth.json"
_MARK = ".synthetic-studio"
_LAYOUT = "body_25"


@dataclass(frozen=True)
class FilmJob:
    """What one process needs to film one camera."""

    description: Description
    lens: Lens
    body: Path
    dataset: Path
    truth: Path


def run(description: Path, dataset: Place, truth: Written, body: Path | None = None, processes: int = 2) -> None:
    """Film the described play: videos, calibration, keypoints and capture.yaml into ``dataset``, exact truth into
    ``truth``."""
    described = read_description(description)
    body = body or RESOURCES / "body.npz"
    _clear(dataset, truth)
    ideal = rig.cameras(described)
    _write_facts(described, truth)
    lenses = rig.true_lenses(described, ideal)
    say(
        f"{described.people} people, {len(described.training)} training and "
        f"{len(described.held_out)} held-out cameras, "
        f"{described.frames} frames of {described.size[0]}×{described.size[1]} at {described.fps:g} fps"
    )
    jobs = [FilmJob(described, lens, body, dataset, truth) for lens in lenses]
    workers = min(processes, len(jobs))
    if workers > 1:
        # Spawned, not forked: the ray caster's and the decoder's threads do not survive a fork.
        with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
            for _ in progress(pool.map(film_camera, jobs), "cameras", total=len(jobs)):
                pass
    else:
        for job in progress(jobs, "cameras"):
            film_camera(job)
    _write_calibration(described, lenses, dataset)
    _write_truth(described, ideal, BodyModel.load(body), truth)


def _clear(dataset: Path, truth: Path) -> None:
    """Remove an older capture, which may hold cameras that are gone; refuses to touch a folder that no studio
    filled."""
    files = [p for folder in (dataset, truth) for p in folder.rglob("*") if not p.is_dir()]
    if files and not (dataset / _MARK).is_file():
        raise UserError(
            f"{files[0].parent} holds files that the studio did not make; give "
            "--dataset and --truth folders of their own"
        )
    for folder in (dataset, truth):
        if folder.exists():
            shutil.rmtree(folder)
        folder.mkdir(parents=True)
    write_text(dataset / _MARK, "made by studio.capture, which may replace everything here\n")


def film_camera(job: FilmJob) -> None:
    """Write everything that belongs to one camera."""
    described, name = job.description, job.lens.name
    sensor = sensor_of(described, name)
    offset = rig.sync_offsets_frames(described)[name]
    times_s = (np.arange(described.frames) + offset) / described.fps
    troupe = Actors(described, BodyModel.load(job.body), times_s)
    solids = room(described.seed, described.effects.glossy_floor)
    scene = backdrop(job.lens, solids, described.supersampling)
    training = name in described.training
    truth = TruthFrames(job.lens, solids, described.truth)
    detector = np.random.default_rng([described.seed, 31, described.names.index(name)])

    keypoints_m, soles_m = troupe.keypoints_m(LAYOUTS[_LAYOUT].keypoints), troupe.soles_m()

    def frames() -> Iterator[np.ndarray]:
        for frame in range(described.frames):
            moving, values = troupe.at(frame)
            tracer = Tracer(solids + moving)
            touched = touched_pixels(job.lens, moving)
            centres = touched_pixels(truth.lens, moving) if job.lens.distortion.any() else touched
            truth.add(tracer, moving, centres, values, _next(troupe, frame) if described.truth.flow else None)
            if training and described.keypoints:
                people = detect(keypoints_m[frame], job.lens, tracer, len(solids), described.detections, detector)
                path = job.dataset / "keypoints" / name / f"{name}_{frame:012d}_keypoints.json"
                write_json(path, openpose_json(people))
            light = lamp_swing(described, float(times_s[frame]))
            yield developed(
                light * exposed(scene, tracer, moving, touched, soles_m[frame], described.effects), sensor, frame
            )

    video = job.dataset / "videos" / f"{name}.mp4"
    if training:
        write_watchable(video, frames(), described.fps, described.crf)
    else:
        # Held-out pictures are compared with: the truth keeps them without the video's losses.
        clean = list(frames())
        write_watchable(video, clean, described.fps, described.crf)
        write_lossless(job.truth / "frames" / f"{name}.mkv", clean, described.fps)
    _write_static(job, scene, truth, sensor)
    truth.write(job.truth, described.fps)


def lamp_swing(described: Description, time_s: float) -> float:
    """Brightness of the lamps at a moment: one slow swing over the clip around 1."""
    length_s = described.frames / described.fps
    return 1 + described.effects.changing_light * float(np.sin(2 * np.pi * time_s / length_s))


def _next(troupe: Actors, frame: int) -> list[Mesh] | None:
    return troupe.at(frame + 1)[0] if frame + 1 < len(troupe.times_s) else None


def _write_static(job: FilmJob, scene: Backdrop, truth: TruthFrames, sensor: Sensor) -> None:
    name = job.lens.name
    write_png(job.truth / "plates" / f"{name}.png", developed(scene.picture(), Sensor.perfect(), 0))
    write_depth(job.truth / "depth" / f"{name}.exr", truth.room_depth_m, np.ones_like(truth.room_depth_m))
    if job.description.plates and name in job.description.training:
        write_png(job.dataset / "plates" / f"{name}.png", developed(scene.picture(), sensor, job.description.frames))


def _write_calibration(described: Description, lenses: list[Lens], dataset: Path) -> None:
    for name, text in calibration_texts(described.calibration.format, rig.told_lenses(described, lenses)).items():
        write_text(dataset / name, text)
    plan = planned_dataset(described, dataset, dataset)
    capture: dict[str, Any] = {
        "held_out": list(described.held_out),
        "calibration": [str(p.relative_to(dataset)) for p in plan.calibration],
    }
    capture |= {"keypoint_layout": _LAYOUT} if described.people else {"people": 0}
    write_text(dataset / "capture.yaml", yaml.safe_dump(capture, sort_keys=True))


def _write_truth(described: Description, ideal: list, body: BodyModel, truth: Path) -> None:
    troupe = Actors(described, body, np.arange(described.frames) / described.fps)
    for actor in troupe.actors:
        person = troupe.person(actor)
        write_person(truth / "bodies" / f"{person.name}.npz", person)
    write_json(truth / "cameras.json", [camera.as_json() for camera in ideal])


def _write_facts(described: Description, truth: Path) -> None:
    facts = {
        "training": list(described.training),
        "held_out": list(described.held_out),
        "people": [f"p{number}" for number in range(described.people)],
        "frames": described.frames,
        "fps": described.fps,
        "sync_offsets_frames": rig.sync_offsets_frames(described),
        "gains": {name: sensor_of(described, name).gains for name in described.names},
        "radial_distortion": described.faults.radial_distortion,
    }
    write_json(truth / FACTS, facts)
