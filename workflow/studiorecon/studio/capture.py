# SPDX-License-Identifier: Apache-2.0
"""``studio.capture``: writes a dataset like a user's from a description, and next to it the exact truth.

Only ``report`` may read the truth. The cameras are filmed in :mod:`studiorecon.studio.takes`.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import write_person
from studiorecon.errors import UserError
from studiorecon.progress import progress, say
from studiorecon.scene.camera import Lens
from studiorecon.scene.files import write_json, write_text
from studiorecon.signature import Place, Written
from studiorecon.studio import rig
from studiorecon.studio.actors import Actors
from studiorecon.studio.calibration import calibration_texts
from studiorecon.studio.description import RESOURCES, Description, planned_dataset, read_description
from studiorecon.studio.sensor import camera_sensor
from studiorecon.studio.takes import LAYOUT, Films, film_takes, share_takes

FACTS = "truth.json"
_MARK = ".synthetic-studio"


def run(description: Path, dataset: Place, truth: Written, body: Path | None = None, processes: int = 2) -> None:
    """Film the described play: videos, calibration, keypoints and capture.yaml into ``dataset``, and exact
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
    takes = share_takes(described, lenses, processes)
    films = [Films(described, take, body, dataset, truth) for take in takes]
    for _ in progress(film_takes(films, processes), "pictures", total=described.frames * len(lenses)):
        pass
    _write_calibration(described, lenses, dataset)
    _write_truth(described, ideal, BodyModel.load(body), truth)


def _clear(dataset: Path, truth: Path) -> None:
    """Remove an older capture, which may hold removed cameras; refuses to touch a folder that no studio filled."""
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


def _write_calibration(described: Description, lenses: list[Lens], dataset: Path) -> None:
    for name, text in calibration_texts(described.calibration.format, rig.calibrated_lenses(described, lenses)).items():
        write_text(dataset / name, text)
    plan = planned_dataset(described, dataset, dataset)
    capture: dict[str, Any] = {
        "held_out": list(described.held_out),
        "calibration": [str(p.relative_to(dataset)) for p in plan.calibration],
    }
    capture |= {"keypoint_layout": LAYOUT} if described.people else {"people": 0}
    write_text(dataset / "capture.yaml", yaml.safe_dump(capture, sort_keys=True))


def _write_truth(described: Description, ideal: list, body: BodyModel, truth: Path) -> None:
    actors = Actors(described, body, np.arange(described.frames) / described.fps)
    for actor in actors.actors:
        person = actors.person(actor)
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
        "gains": {name: camera_sensor(described, name).gains for name in described.names},
        "radial_distortion": described.faults.radial_distortion,
    }
    write_json(truth / FACTS, facts)
