# SPDX-License-Identifier: Apache-2.0
"""Ego-Exo4D's ``gopro_calibs.csv``: camera-to-world quaternions and metres, OpenCV or fisheye intrinsics."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon.calibration.formats.reading import CalibrationFormat, Reading, one_file
from studiorecon.camera_files.raw_camera import RawCamera, camera_from_world_of_pose, raw_camera
from studiorecon.errors import UserError
from studiorecon.geometry.rotations import from_quaternion
from studiorecon.scene.user_files import read_rows

_COLUMNS = (
    "cam_uid",
    *(f"t{a}_world_cam" for a in "xyz"),
    *(f"q{a}_world_cam" for a in "wxyz"),
    *(f"intrinsics_{i}" for i in range(4)),
    "image_width",
    "image_height",
)


def read(files: list[Path]) -> Reading:
    """One camera per row; further intrinsics than four are the fisheye's k1 to k4."""
    path = files[0]
    rows = [row for _, row in read_rows(path, _COLUMNS, ",")]
    return Reading("Ego-Exo4D gopro_calibs.csv", tuple(_camera(row, path) for row in rows), "m", ())


def _camera(row: dict[str, str], path: Path) -> RawCamera:
    name = row.get("cam_uid", "?")
    where = f"camera {name} in {path}"
    try:
        centre = np.array([float(row[f"t{a}_world_cam"]) for a in "xyz"])
        quaternion = np.array([float(row[f"q{a}_world_cam"]) for a in "wxyz"])
        intrinsics = [float(row[f"intrinsics_{i}"]) for i in range(4)]
        wh = [float(row[f"image_{side}"]) for side in ("width", "height")]
        terms = [float(row[f"intrinsics_{i}"]) for i in range(4, 8) if row.get(f"intrinsics_{i}")]
    except (KeyError, ValueError) as error:
        raise UserError(f"{where}: {error} is missing or not a number; it is not a gopro_calibs.csv") from None
    if np.linalg.norm(quaternion) < 1e-12:
        raise UserError(f"{where}: the rotation is a quaternion of length 0; calibrate this camera again")
    pose = camera_from_world_of_pose(np.column_stack([from_quaternion(quaternion), centre]), where)
    return raw_camera(name, where, wh, intrinsics, pose, terms, "fisheye" if terms else "opencv")


FORMAT = CalibrationFormat(
    "egoexo",
    "Ego-Exo4D",
    "`gopro_calibs.csv`",
    (("gopro_calibs.csv",), ("trajectory/gopro_calibs.csv",)),
    one_file("*.csv"),
    read,
)
