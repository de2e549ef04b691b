# SPDX-License-Identifier: Apache-2.0
"""Caliscope's ``camera_array.toml``: tables ``[cameras.N]`` with a rotation matrix, metres, videos named ``cam_N``.

``rotation_count`` is the number of quarter turns by which Caliscope rotates a picture for its tracker, whose points it
rotates back: films and numbers fit as they are stored.
"""

from __future__ import annotations

from pathlib import Path

from studiorecon.calibration.formats.pose2sim import TOML_FILES, camera_of_table, camera_tables, holds_cameras
from studiorecon.calibration.formats.reading import CalibrationFormat, Reading


def recognises(files: list[Path]) -> bool:
    return (
        len(files) == 1
        and files[0].suffix == ".toml"
        and any("cam_id" in t or "port" in t for t in camera_tables(files[0]).values())
    )


def read(files: list[Path]) -> Reading:
    """The cameras that the file does not ignore."""
    notes: list[str] = []
    cameras = []
    for key, table in camera_tables(files[0]).items():
        if table.get("ignore", False):
            notes.append(f"camera {key} is marked as ignored in {files[0].name} and was left out")
            continue
        cameras.append(camera_of_table(f"cam_{key}", table, files[0], notes))
    return Reading("Caliscope camera_array.toml", tuple(cameras), "m", tuple(notes))


FORMAT = CalibrationFormat(
    name="caliscope",
    made_by="Caliscope",
    files_in_words="`camera_array.toml`",
    files=TOML_FILES,
    recognises=recognises,
    read=read,
    holds_cameras=holds_cameras,
)
