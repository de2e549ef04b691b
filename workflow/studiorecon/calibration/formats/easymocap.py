# SPDX-License-Identifier: Apache-2.0
"""EasyMocap and EasyVolcap: ``intri.yml`` + ``extri.yml``, also written by Pose2Sim and many capture stages.

OpenCV YAML, often with CRLF; ``K_<c>``, ``dist_<c>`` or ``D_<c>``, ``R_<c>`` (axis-angle) or ``Rot_<c>`` (matrix),
``T_<c>``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon.calibration.formats.opencv_storage import load_storage, plain_numbers
from studiorecon.calibration.formats.reading import CalibrationFormat, Reading
from studiorecon.camera_files.raw_camera import Pose, RawCamera, raw_camera, rigid_camera_from_world
from studiorecon.errors import UserError
from studiorecon.scene.user_files import MAX_TEXT_BYTES, read_bytes
from studiorecon.scene.user_values import as_list, short_text

# What is read of a camera, and what else EasyMocap and EasyVolcap write of it.
_ENTRIES = [
    "K", "dist", "D", "rdist", "R", "Rot", "T", "W", "H", "t", "v", "n", "f", "ccm", "bounds", "invK", "RT", "P",
]  # fmt: skip


def recognises(files: list[Path]) -> bool:
    return len(files) == 2 and all(f.suffix.lower() in (".yml", ".yaml") for f in files)


def read(files: list[Path]) -> Reading:
    """The cameras of an intrinsic and an extrinsic file, in either order."""
    first, second = (load_storage(f) for f in files)
    intri, extri = (first, second) if any(k.startswith("K_") for k in first) else (second, first)
    intri_path, extri_path = (files[0], files[1]) if intri is first else (files[1], files[0])
    listed_names = as_list(intri.get("names"), f"{intri_path}: names", "[cam01, cam02]")
    keys = [k[2:] for k in intri if k.startswith("K_")]
    names, notes = [str(n) for n in listed_names or keys], list[str]()
    key_of = {n: n for n in names}
    if names and f"K_{names[0]}" not in intri:
        # Pose2Sim's writer numbers its keys 1..N whatever the names are.
        if len(keys) != len(names):
            raise UserError(
                f"{intri_path}: lists the cameras {', '.join(names)} but has intrinsics for {', '.join(keys) or 'none'}"
            )
        notes.append(
            f"{intri_path.name} names its entries {', '.join(keys)}; they were read as {', '.join(names)}, in order"
        )
        key_of = dict(zip(names, keys))
    read_entries = {"names", *(f"{entry}_{key}" for key in key_of.values() for entry in _ENTRIES)}
    if idle := [entry for entry in {**intri, **extri} if entry not in read_entries]:
        notes.append(f"{short_text(', '.join(idle))} of {intri_path.name} and {extri_path.name} were not used")
    cameras = []
    for name, key in key_of.items():
        where = f"camera {name} in {extri_path}"
        rotations = [extri[entry] for entry in (f"Rot_{key}", f"R_{key}") if entry in extri]
        rotations, translation = rotations or [_required(extri, f"R_{key}", where)], _required(extri, f"T_{key}", where)
        pose, *again = [rigid_camera_from_world(rotation, translation, where) for rotation in rotations]
        if again and np.abs(again[0][0][:3, :3] - pose[0][:3, :3]).max() > 1e-3:
            raise UserError(
                f"{where}: R_{key} and Rot_{key} are different rotations; the file was edited by hand, write it again"
            )
        if f"rdist_{key}" in intri and (plain := {f"dist_{key}", f"D_{key}"} & intri.keys()):
            used = f"rdist_{key} (fisheye) was used, {min(plain)} was not"
            notes.append(f"camera {name} in {intri_path} has the lens twice: {used}")
        cameras.append(_camera(intri, name, key, f"camera {name} in {intri_path}", pose))
    return Reading("EasyMocap/EasyVolcap intri + extri", tuple(cameras), "unknown", tuple(notes))


def _camera(intri: dict, name: str, key: str, where: str, pose: Pose) -> RawCamera:
    terms = next((intri[f"{entry}_{key}"] for entry in ("rdist", "dist", "D") if f"{entry}_{key}" in intri), None)
    model = "fisheye" if f"rdist_{key}" in intri else "opencv"
    wh = plain_numbers([intri.get(f"{side}_{key}", 0) for side in "WH"])
    return raw_camera(name, where, wh, _required(intri, f"K_{key}", where), pose, terms, model)


def is_intri(path: Path) -> bool:
    """Whether a YAML file holds EasyMocap's lenses."""
    if b"K_" not in read_bytes(path, MAX_TEXT_BYTES):
        return False
    return any(key.startswith("K_") for key in load_storage(path))


def lenses_in(path: Path) -> list[RawCamera]:
    """The lenses of an intrinsic file without poses."""
    intri = load_storage(path)
    keys, nowhere = [k[2:] for k in intri if k.startswith("K_")], (np.eye(4), 1.0)
    return [_camera(intri, key, key, f"camera {key} in {path}", nowhere) for key in keys]


def _required(table: dict, key: str, where: str) -> object:
    if key not in table:
        raise UserError(f"{where}: {key} is missing")
    return table[key]


FORMAT = CalibrationFormat(
    "easymocap",
    "EasyMocap, EasyVolcap, Pose2Sim",
    "`intri.yml` + `extri.yml`",
    (("intri.yml", "extri.yml"), ("optimized/intri.yml", "optimized/extri.yml"), ("Intrinsic.yml", "Extrinsic.yml")),
    recognises,
    read,
)
