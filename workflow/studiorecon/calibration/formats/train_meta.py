# SPDX-License-Identifier: Apache-2.0
"""Dynamic 3D Gaussians' ``train_meta.json`` and MonoFusion's ``Dy_train_meta.json``: matrices per time and camera."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from studiorecon.calibration.formats.reading import CalibrationFormat, Reading, merged_static, one_file
from studiorecon.camera_files.raw_camera import camera_from_world_of_pose, camera_from_world_of_rows, raw_camera
from studiorecon.errors import UserError
from studiorecon.scene.user_files import read_json
from studiorecon.scene.user_values import as_mapping


def read(files: list[Path]) -> Reading:
    """One camera per picture folder, or per index in the lists where there are no file names.

    MonoFusion stores camera-to-world under the name ``w2c`` (see its source); a ``camera_convention`` decides.
    """
    path = files[0]
    content = as_mapping(read_json(path), str(path), "{k: […], w2c: […]}")
    missing = [k for k in ("k", "w2c") if k not in content]
    if missing or not ("hw" in content or {"w", "h"} <= content.keys()):
        raise UserError(f"{path} lacks {missing[0] if missing else 'w and h'}; it is not a train_meta.json")
    inverted, notes = _inverted(content, path.name)
    cameras = []
    for t, (matrices, poses) in enumerate(zip(content["k"], content["w2c"], strict=True)):
        for index, (k, pose) in enumerate(zip(matrices, poses, strict=True)):
            name = PurePosixPath(content["fn"][t][index]).parent.name if "fn" in content else str(index)
            where = f"camera {name} at time {t} in {path}"
            placed = (camera_from_world_of_pose if inverted else camera_from_world_of_rows)(pose, where)
            wh = content["hw"][index][::-1] if "hw" in content else (content["w"], content["h"])
            cameras.append(raw_camera(name, where, wh, k, placed, integer_centres=False))
    kind = "MonoFusion Dy_train_meta.json" if "hw" in content else "Dynamic 3D Gaussians train_meta.json"
    static, named = merged_static(cameras, notes), "fn" in content
    if not named and len(static) < len({camera.name for camera in cameras}):
        raise UserError(
            f"{path}: {notes[-1]}; write the pictures' names, fn, there too, by which films are paired then"
        )
    return Reading(kind, static, "unknown", tuple(notes), named=named)


def _inverted(content: Mapping, name: str) -> tuple[bool, list[str]]:
    """Whether ``w2c`` holds camera-to-world, and a sentence on how that was decided."""
    if "hw" not in content:
        return False, []
    convention = str(content.get("camera_convention", "")).lower()
    if convention in ("w2c", "c2w"):
        return convention == "c2w", [f"{name} states that its poses are {convention}"]
    return True, [
        f"{name} does not state its camera_convention: its w2c was read as camera-to-world, as MonoFusion writes it"
    ]


FORMAT = CalibrationFormat(
    "train_meta",
    "Dynamic 3D Gaussians, MonoFusion",
    "`train_meta.json`",
    (("train_meta.json",), ("trajectory/Dy_train_meta.json",), ("Dy_train_meta.json",)),
    one_file("*train_meta.json"),
    read,
)
