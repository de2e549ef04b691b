# SPDX-License-Identifier: Apache-2.0
"""Pose2Sim ``Calib*.toml`` and the aniposelib family (AniPose, FreeMoCap, and Caliscope's ``camera_array.toml`` with
``[cameras.N]``): one table per camera."""

from __future__ import annotations

from pathlib import Path

from studiorecon.calibration.formats.reading import CalibrationFormat, Reading, one_file
from studiorecon.camera_files.lens_kinds import lens_model
from studiorecon.camera_files.raw_camera import RawCamera, raw_camera, rigid_camera_from_world
from studiorecon.errors import UserError
from studiorecon.scene.user_files import MAX_TEXT_BYTES, read_bytes, read_toml
from studiorecon.scene.user_values import name

# Of Caliscope's cards and volumes, and Pose2Sim's Config.toml.
_OTHER_TABLES = {"metadata", "capture_volume", "charuco", "checkerboard"}


def camera_tables(path: Path) -> dict[str, dict]:
    """The camera tables of a TOML calibration by key; also those of Caliscope's ``[cameras.N]``."""
    content = read_toml(path)
    if isinstance(content.get("cameras"), dict):
        content = content["cameras"]
    return {k: v for k, v in content.items() if isinstance(v, dict) and k not in _OTHER_TABLES and "matrix" in v}


def recognises(files: list[Path]) -> bool:
    """Whether a TOML file has tables of cameras; ``_is_caliscope``: with the number of a port."""
    return one_file("*.toml")(files) and bool(camera_tables(files[0]))


def _is_caliscope(files: list[Path]) -> bool:
    return recognises(files) and any("cam_id" in t or "port" in t for t in camera_tables(files[0]).values())


def read(files: list[Path]) -> Reading:
    """The cameras of the file; the unit is metres for Pose2Sim, and guessed later for the rest of the family."""
    cameras = [
        camera_of_table(name(table.get("name", key), f"the name of table {key} in {files[0]}"), table, files[0])
        for key, table in camera_tables(files[0]).items()
    ]
    return Reading("Pose2Sim/aniposelib TOML", tuple(cameras), "unknown", ())


def read_caliscope(files: list[Path]) -> Reading:
    """The cameras that Caliscope's file does not ignore, in metres, whose videos are called ``cam_N``.

    ``rotation_count`` is the number of quarter turns by which Caliscope rotates a picture for its tracker, whose points
    it rotates back: films and numbers fit as they are stored.
    """
    tables = camera_tables(files[0])
    ignored = [key for key, table in tables.items() if table.get("ignore", False)]
    notes = [f"camera {key} is marked as ignored in {files[0].name} and was left out" for key in ignored]
    cameras = [camera_of_table(f"cam_{k}", t, files[0]) for k, t in tables.items() if k not in ignored]
    return Reading("Caliscope camera_array.toml", tuple(cameras), "m", tuple(notes))


def camera_of_table(name: str, table: dict, path: Path) -> RawCamera:
    """One camera from a table with matrix, distortions, rotation (axis-angle or matrix) and translation."""
    where = f"camera {name} in {path}"
    missing = [k for k in ("rotation", "translation") if k not in table]
    if missing:
        raise UserError(f"{where}: {missing[0]} is missing; run the extrinsic calibration too")
    pose, wh = rigid_camera_from_world(table["rotation"], table["translation"], where), table.get("size", (0, 0))
    return raw_camera(name, where, wh, table["matrix"], pose, table.get("distortions"), lens_model(table, where))


def holds_cameras(path: Path) -> bool:
    """Whether a TOML file could be a calibration."""
    text = read_bytes(path, MAX_TEXT_BYTES).decode("utf-8", errors="replace")
    return "matrix" in text and "translation" in text


_PLACES = (("*.toml",), ("calibration/*.toml",))
CALISCOPE = CalibrationFormat(
    "caliscope", "Caliscope", "`camera_array.toml`", _PLACES, _is_caliscope, read_caliscope, holds_cameras
)
FORMAT = CalibrationFormat(
    "pose2sim", "Pose2Sim, aniposelib, AniPose, FreeMoCap", "`Calib*.toml`", _PLACES, recognises, read, holds_cameras
)
