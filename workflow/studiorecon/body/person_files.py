# SPDX-License-Identifier: Apache-2.0
"""One person's body over time as a file: AMASS-style npz, with what is broken in it repaired as far as can be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from studiorecon.errors import UserError
from studiorecon.geometry import rotations
from studiorecon.geometry.smoothing import fill_rotations, fill_vectors
from studiorecon.progress import warn
from studiorecon.scene.files import write_npz
from studiorecon.scene.intermediate import as_written, read_arrays
from studiorecon.scene.people import Person


def write_person(path: Path, person: Person) -> None:
    """Write the AMASS-style npz: ``poses trans betas mocap_framerate`` plus this project's own fields."""
    arrays = {
        name: getattr(person, name)
        for name in ("name", "body", "poses", "trans", "betas", "joints", "valid", "present", "sigma", "metric")
    }
    write_npz(path, arrays | {"mocap_framerate": person.fps})


def read_person(path: Path) -> Person:
    """A person's body. Frames that hold numbers that are not finite are said, count as not measured and are filled
    between sound ones.

    Raises UserError when the file is missing, does not say when the person is there, its arrays have different lengths,
    no frame is sound, or the shape is not finite.
    """
    fields = ("poses", "trans", "betas", "joints", "valid", "present", "sigma")
    data = read_arrays(path, gaps=fields)
    with as_written(path):
        if "present" not in data:
            raise UserError(f"{path} does not say in which frames {data['name']} is there; run people.fit again")
        arrays = {n: data[n] for n in fields}
        person = Person(
            str(data["name"]), str(data["body"]), float(data["mocap_framerate"]), metric=bool(data["metric"]), **arrays
        )
    lengths = {n: len(arrays[n]) for n in arrays if n != "betas"}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{n} {length}" for n, length in lengths.items())
        raise UserError(f"{path} holds arrays of different numbers of frames ({told}); run people.fit again")
    sound = np.isfinite(person.poses).all(-1) & np.isfinite(person.trans).all(-1)
    if sound.all() and np.isfinite(person.betas).all():
        return person
    if not sound.any() or not np.isfinite(person.betas).all():
        raise UserError(f"{path} holds no body whose numbers are finite; run people.fit again")
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
