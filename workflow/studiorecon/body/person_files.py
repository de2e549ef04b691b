# SPDX-License-Identifier: Apache-2.0
"""One person's body over time as a file: AMASS-style npz; frames that are not finite are repaired on reading."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.geometry import rotations
from studiorecon.geometry.smoothing import fill_rotations, fill_vectors
from studiorecon.progress import warn
from studiorecon.scene.files import write_npz
from studiorecon.scene.people import Person
from studiorecon.scene.schema import KNOWN_OR_INFINITE, OptionalField, flag, frame_rate, metres, radians, real, text
from studiorecon.scene.step_files import expect, expect_named, read, require

_PERSON = {
    "name": text(),
    "body": text(),
    "poses": radians("T 72", gaps=True),
    "trans": metres("T 3", gaps=True),
    "betas": real("B"),
    "joints": metres("T 24 3", gaps=True),
    "valid": flag("T"),
    "present": flag("T"),
    "sigma": metres("T 24", gaps=True, low=0, such=KNOWN_OR_INFINITE),
    "metric": flag(),
    "hand_poses": OptionalField(radians("T 90")),
    "hand_joints": OptionalField(metres("T 30 3")),
    "hand_sigma": OptionalField(metres("T 30", gaps=True, low=0, such=KNOWN_OR_INFINITE)),
    "hand_scale": OptionalField(real("2", low=0.1, high=10)),
    "mocap_framerate": frame_rate(),
}


def write_person(path: Path, person: Person) -> None:
    """Write the AMASS-style npz: ``poses trans betas mocap_framerate`` plus this project's own fields."""
    arrays = {
        name: getattr(person, name)
        for name in ("name", "body", "poses", "trans", "betas", "joints", "valid", "present", "sigma", "metric")
    }
    hands = {name: getattr(person, name) for name in ("hand_poses", "hand_joints", "hand_sigma", "hand_scale")}
    arrays |= {name: array for name, array in hands.items() if array is not None}
    write_npz(path, arrays | {"mocap_framerate": person.fps})


def read_person(path: Path, frames: int | None = None, model: BodyModel | None = None) -> Person:
    """The person of a file; a warning counts frames that are not finite, which are filled and not valid.

    Raises UserError as ``step_files.read`` does, also when no frame is finite, or where the person has not these
    ``frames``, or another body than ``model``.
    """

    def made(data: dict[str, Any]) -> tuple[Person, np.ndarray]:
        name, model = str(data.pop("name")), str(data.pop("body"))
        expect_named(path, name)
        fps, metric = float(data.pop("mocap_framerate")), bool(data.pop("metric"))
        person = Person(name=name, body=model, fps=fps, metric=metric, **data)
        joints = person.joints.reshape(len(person.poses), -1)
        sound = np.isfinite(np.concatenate([person.poses, person.trans, joints], axis=1)).all(axis=1)
        expect(sound.any(), "no frame of the body has finite numbers")
        return person, sound

    person, sound = read(path, _PERSON, made)
    count = len(person.poses)
    require(path, frames in (None, count), f"it has {count} frames, the capture {frames}")
    require(path, model is None or person.body == model.identity, f"it is of the body model {person.body}")
    if sound.all():
        return person
    warn(f"{path.name}: {int((~sound).sum())} frames hold numbers that are not finite; they count as not measured")
    turns = rotations.exp(np.where(sound[:, None], person.poses, 0.0).reshape(len(sound), -1, 3))
    filled = rotations.log(fill_rotations(turns, sound)).reshape(person.poses.shape)
    return replace(
        person,
        poses=np.where(sound[:, None], person.poses, filled),
        trans=fill_vectors(person.trans, sound),
        joints=fill_vectors(person.joints, sound),
        valid=person.valid & sound,
        sigma=np.where(sound[:, None], person.sigma, np.inf),
    )
