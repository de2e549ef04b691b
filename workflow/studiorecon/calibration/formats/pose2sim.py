# SPDX-License-Identifier: Apache-2.0
"""Pose2Sim ``Calib*.toml`` and the aniposelib family (Caliscope, AniPose, FreeMoCap): one table per camera."""

from __future__ import annotations

from pathlib import Path

from studiorecon.calibration.formats.reading import CalibrationFormat, Reading
from studiorecon.camera_files.lens_kinds import coefficients, lens_model
from studiorecon.camera_files.raw_camera import (
    RawCamera,
    finite_vector,
    rigid_camera_from_world,
    rotation_from_file,
    unadjusted_intrinsics,
)
from studiorecon.errors import UserError
from studiorecon.scene.user_files import MAX_TEXT_BYTES, read_bytes, read_toml
from studiorecon.scene.user_values import name, numbers

# Caliscope's cameras are in such a file too; its cards and volumes, and Pose2Sim's Config.toml, are in the same folder.
TOML_FILES = (("*.toml",), ("calibration/*.toml",))
_OTHER_TABLES = {"metadata", "capture_volume", "charuco", "checkerboard"}


def camera_tables(path: Path) -> dict[str, dict]:
    """The camera tables of a TOML calibration by key; also those of Caliscope's ``[cameras.N]``."""
    content = read_toml(path)
    if isinstance(content.get("cameras"), dict):
        content = content["cameras"]
    return {k: v for k, v in content.items() if isinstance(v, dict) and k not in _OTHER_TABLES and "matrix" in v}


def recognises(files: list[Path]) -> bool:
    """Tables without a name are called after their keys; Caliscope's have cam_id or port."""
    return (
        len(files) == 1
        and files[0].suffix == ".toml"
        and not all("name" not in t and ("cam_id" in t or "port" in t) for t in camera_tables(files[0]).values())
    )


def read(files: list[Path]) -> Reading:
    """The cameras of the file; the unit is metres for Pose2Sim, and guessed later for the rest of the family."""
    cameras = []
    notes: list[str] = []
    for key, table in camera_tables(files[0]).items():
        called = name(table.get("name", key), f"the name of table {key} in {files[0]}")
        cameras.append(camera_of_table(called, table, files[0], notes))
    return Reading("Pose2Sim/aniposelib TOML", tuple(cameras), "unknown", tuple(notes))


def camera_of_table(name: str, table: dict, path: Path, notes: list[str]) -> RawCamera:
    """One camera from a table with matrix, distortions, rotation (axis-angle or matrix) and translation."""
    where = f"camera {name} in {path}"
    missing = [k for k in ("rotation", "translation") if k not in table]
    if missing:
        raise UserError(f"{where}: {missing[0]} is missing; run the extrinsic calibration too")
    pose, scale = rigid_camera_from_world(
        rotation_from_file(table["rotation"], f"{where}: rotation"),
        finite_vector(table["translation"], f"{where}: translation"),
        where,
    )
    if abs(scale - 1) > 1e-3:
        notes.append(f"camera {name}: a scale of {scale:.4g} was removed from its rotation")
    size = numbers(table.get("size", (0, 0)), f"{where}: size")
    if size.shape != (2,):
        raise UserError(f"{where}: size holds {size.size} numbers; it must be width and height")
    width, height = size.tolist()
    model = lens_model(table, where)
    return RawCamera(
        name=name,
        wh=(round(width), round(height)),
        intrinsics=unadjusted_intrinsics(table["matrix"], where),
        model=model,
        distortion=coefficients(model, table.get("distortions"), where),
        camera_from_world=pose,
    )


def holds_cameras(path: Path) -> bool:
    """Whether a TOML file could be a calibration."""
    text = read_bytes(path, MAX_TEXT_BYTES).decode("utf-8", errors="replace")
    return "matrix" in text and "translation" in text


FORMAT = CalibrationFormat(
    name="pose2sim",
    made_by="Pose2Sim, aniposelib, AniPose, FreeMoCap",
    files_in_words="`Calib*.toml`",
    files=TOML_FILES,
    recognises=recognises,
    read=read,
    holds_cameras=holds_cameras,
)
