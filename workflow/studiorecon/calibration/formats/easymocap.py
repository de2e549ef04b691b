# SPDX-License-Identifier: Apache-2.0
"""EasyMocap and EasyVolcap: ``intri.yml`` + ``extri.yml``, also written by Pose2Sim and many capture stages.

OpenCV YAML, often with CRLF; ``K_<c>``, ``dist_<c>`` or ``D_<c>``, ``R_<c>`` (axis-angle) or ``Rot_<c>`` (matrix),
``T_<c>``.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from studiorecon.calibration.formats.opencv_storage import load_storage
from studiorecon.calibration.formats.reading import CalibrationFormat, Reading
from studiorecon.camera_files.lens_kinds import coefficients
from studiorecon.camera_files.raw_camera import (
    RawCamera,
    finite_vector,
    rigid_camera_from_world,
    rotation_from_file,
    unadjusted_intrinsics,
)
from studiorecon.errors import UserError
from studiorecon.scene.user_files import MAX_TEXT_BYTES, read_bytes
from studiorecon.scene.user_values import as_list, short_text

# What is read of a camera, and what else EasyMocap and EasyVolcap write of it.
_ENTRIES = [
    "K", "dist", "D", "rdist", "R", "Rot", "T", "W", "H", "t", "v", "n", "f", "ccm", "bounds", "invK", "RT", "P",
]  # fmt: skip


def recognises(files: list[Path]) -> bool:
    return len(files) == 2 and all(f.suffix in (".yml", ".yaml") for f in files)


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
        matrix, axis = _read_matrix(extri, where, f"Rot_{key}"), _read_matrix(extri, where, f"R_{key}")
        given = _required(extri, f"R_{key}", where) if matrix is None else matrix
        rotation = rotation_from_file(given, f"{where}: its rotation")
        if matrix is not None and axis is not None and np.abs(rotation_from_file(axis, where) - rotation).max() > 1e-3:
            raise UserError(
                f"{where}: R_{key} and Rot_{key} are different rotations; the file was edited by hand, write it again"
            )
        pose, scale = rigid_camera_from_world(
            rotation, finite_vector(_required(extri, f"T_{key}", where), f"{where}: T_{key}"), where
        )
        if abs(scale - 1) > 1e-3:
            notes.append(f"camera {name}: a scale of {scale:.4g} was removed from its rotation")
        lens, described = _lens(intri, name, key, f"camera {name} in {intri_path}")
        notes += described
        cameras.append(replace(lens, camera_from_world=pose))
    return Reading("EasyMocap/EasyVolcap intri + extri", tuple(cameras), "unknown", tuple(notes))


def _lens(intri: dict, name: str, key: str, where: str) -> tuple[RawCamera, list[str]]:
    """The camera at the identity, and messages about unused entries."""
    fisheye, plain = _read_matrix(intri, where, f"rdist_{key}"), _read_matrix(intri, where, f"dist_{key}", f"D_{key}")
    notes = []
    if fisheye is not None and plain is not None:
        notes.append(f"{where} has the lens twice: rdist_{key} (fisheye) was used, dist_{key} was not")
    model = "opencv" if fisheye is None else "fisheye"
    wh = _size(intri, f"W_{key}", where), _size(intri, f"H_{key}", where)
    intrinsics = unadjusted_intrinsics(_required(intri, f"K_{key}", where), where)
    distortion = coefficients(model, plain if fisheye is None else fisheye, where)
    return RawCamera(name, wh, intrinsics, model, distortion, np.eye(4)), notes


def is_intri(path: Path) -> bool:
    """Whether a YAML file holds EasyMocap's lenses."""
    if b"K_" not in read_bytes(path, MAX_TEXT_BYTES):
        return False
    return any(key.startswith("K_") for key in load_storage(path))


def lenses_in(path: Path) -> list[RawCamera]:
    """The lenses of an intrinsic file without poses."""
    intri = load_storage(path)
    return [_lens(intri, k[2:], k[2:], f"camera {k[2:]} in {path}")[0] for k in intri if k.startswith("K_")]


def _read_matrix(table: dict, where: str, *keys: str) -> np.ndarray | None:
    """The first of ``keys`` that the table has; raises UserError where it is no matrix."""
    found = next((key for key in keys if key in table), None)
    if found is not None and not isinstance(table[found], np.ndarray):
        raise UserError(f"{where}: {found} is {short_text(table[found])}; it must be a matrix (!!opencv-matrix)")
    return None if found is None else table[found]


def _required(table: dict, key: str, where: str) -> np.ndarray:
    if (found := _read_matrix(table, where, key)) is None:
        raise UserError(f"{where}: {key} is missing")
    return found


def _size(table: dict, key: str, where: str) -> int:
    if not re.fullmatch(r"\d+(\.0*)?", value := str(table.get(key, 0))):
        raise UserError(f"{where}: {key} is {short_text(value)}; it must be a number of pixels")
    return int(float(value))


FORMAT = CalibrationFormat(
    "easymocap",
    "EasyMocap, EasyVolcap, Pose2Sim",
    "`intri.yml` + `extri.yml`",
    (("intri.yml", "extri.yml"), ("optimized/intri.yml", "optimized/extri.yml"), ("Intrinsic.yml", "Extrinsic.yml")),
    recognises,
    read,
)
