# SPDX-License-Identifier: Apache-2.0
"""EasyMocap and EasyVolcap: ``intri.yml`` + ``extri.yml``, also written by Pose2Sim and many capture stages.

OpenCV YAML, often with CRLF; ``K_<c>``, ``dist_<c>`` or ``D_<c>``, ``R_<c>`` (axis-angle) or ``Rot_<c>`` (matrix),
``T_<c>``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from studiorecon.calibration.formats.reading import CalibrationFormat, Reading
from studiorecon.camera_files.raw_camera import RawCamera, intrinsics_matrix, opencv_distortion, rigid_camera_from_world
from studiorecon.errors import UserError
from studiorecon.geometry.rotations import exp
from studiorecon.scene.outside import read_yaml
from studiorecon.scene.values import listed


class _OpenCvYaml(yaml.BaseLoader):
    """All scalars stay text, so that the camera name 00 is not the number 0."""


def _matrix(loader: yaml.Loader, node: yaml.Node) -> np.ndarray:
    entries = loader.construct_mapping(node, deep=True)
    return np.array([float(v) for v in entries["data"]]).reshape(int(entries["rows"]), int(entries["cols"]))


_OpenCvYaml.add_constructor("tag:yaml.org,2002:opencv-matrix", _matrix)


def recognises(files: list[Path]) -> bool:
    return len(files) == 2 and all(f.suffix in (".yml", ".yaml") for f in files)


def read(files: list[Path]) -> Reading:
    """The cameras of an intrinsic and an extrinsic file, in either order."""
    first, second = (_load(f) for f in files)
    intri, extri = (first, second) if any(k.startswith("K_") for k in first) else (second, first)
    intri_path, extri_path = (files[0], files[1]) if intri is first else (files[1], files[0])
    listed_names = listed(intri.get("names"), f"{intri_path}: names", "[cam01, cam02]")
    names = [str(n) for n in listed_names or [k[2:] for k in intri if k.startswith("K_")]]
    notes: list[str] = []
    if names and f"K_{names[0]}" not in intri:
        # Pose2Sim's writer numbers its keys 1..N whatever the names are.
        keys = [k[2:] for k in intri if k.startswith("K_")]
        if len(keys) != len(names):
            raise UserError(
                f"{intri_path}: lists the cameras {', '.join(names)} but has intrinsics for {', '.join(keys) or 'none'}"
            )
        notes.append(
            f"{intri_path.name} names its entries {', '.join(keys)}; they were read as {', '.join(names)}, in order"
        )
        key_of = dict(zip(names, keys))
    else:
        key_of = {n: n for n in names}
    cameras = []
    for name, key in key_of.items():
        where = f"camera {name} in {extri_path}"
        rotation = _matrix_of(extri, f"Rot_{key}")
        vector = _matrix_of(extri, f"R_{key}")
        if rotation is None:
            vector = _required(extri, f"R_{key}", where)
            rotation = vector if vector.shape == (3, 3) else exp(vector.reshape(3))
        elif vector is not None and vector.size == 3 and np.abs(exp(vector.reshape(3)) - rotation).max() > 1e-3:
            raise UserError(
                f"{where}: R_{key} and Rot_{key} are different rotations; the file was edited by hand, write it again"
            )
        pose, scale = rigid_camera_from_world(rotation, _required(extri, f"T_{key}", where), where)
        if abs(scale - 1) > 1e-3:
            notes.append(f"camera {name}: a scale of {scale:.4g} was taken out of its rotation")
        k = _required(intri, f"K_{key}", f"camera {name} in {intri_path}")
        fisheye = _matrix_of(intri, f"rdist_{key}")
        distortion = _matrix_of(intri, f"dist_{key}", f"D_{key}")
        cameras.append(
            RawCamera(
                name=name,
                wh=(_size(intri, f"W_{key}"), _size(intri, f"H_{key}")),
                intrinsics=intrinsics_matrix(k[0, 0], k[1, 1], k[0, 2], k[1, 2], integer_centres=True),
                model="opencv" if fisheye is None else "fisheye",
                distortion=opencv_distortion([] if distortion is None else distortion, f"camera {name}")
                if fisheye is None
                else fisheye.reshape(-1)[:4],
                camera_from_world=pose,
            )
        )
    return Reading("EasyMocap/EasyVolcap intri + extri", tuple(cameras), "unknown", tuple(notes))


def _load(path: Path) -> dict:
    # "%YAML:1.0" is OpenCV's own header and not a YAML directive.
    value = read_yaml(path, _OpenCvYaml, comments="%YAML")
    if not isinstance(value, dict):
        raise UserError(f"{path} holds no camera matrices")
    return value


def _matrix_of(table: dict, *keys: str) -> np.ndarray | None:
    """The first of ``keys`` that holds a matrix."""
    return next((table[key] for key in keys if isinstance(table.get(key), np.ndarray)), None)


def _required(table: dict, key: str, where: str) -> np.ndarray:
    found = _matrix_of(table, key)
    if found is None:
        raise UserError(f"{where}: {key} is missing")
    return found


def _size(table: dict, key: str) -> int:
    return round(float(table[key])) if key in table else 0


FORMAT = CalibrationFormat(
    name="easymocap",
    made_by="EasyMocap, EasyVolcap, Pose2Sim",
    files_in_words="`intri.yml` + `extri.yml`",
    files=(
        ("intri.yml", "extri.yml"),
        ("optimized/intri.yml", "optimized/extri.yml"),
        ("Intrinsic.yml", "Extrinsic.yml"),
    ),
    recognises=recognises,
    read=read,
)
