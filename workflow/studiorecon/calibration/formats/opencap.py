# SPDX-License-Identifier: Apache-2.0
"""OpenCap's ``cameraIntrinsicsExtrinsics.pickle``: one table of arrays per camera, millimetres, OpenCV's conventions.

``intrinsicMat`` (3, 3), ``distortion`` (1, 5) k1 k2 p1 p2 k3, ``imageSize`` (2, 1) height first, ``rotation`` (3, 3),
``translation`` (3, 1) of x_camera = R X + t, whose world is that of the checkerboard, upright on the floor. As
Pose2Sim's ``calib_opencap_fun`` reads and its ``calib_toml_to_opencap`` writes them.
"""

from __future__ import annotations

from pathlib import Path

from studiorecon.calibration.formats.pickles import read_pickle
from studiorecon.calibration.formats.reading import CalibrationFormat, Reading
from studiorecon.camera_files.raw_camera import RawCamera, raw_camera, rigid_camera_from_world
from studiorecon.errors import UserError

_NAME = "cameraIntrinsicsExtrinsics.pickle"
_ENTRIES = ("intrinsicMat", "distortion", "imageSize", "rotation", "translation")


def recognises(files: list[Path]) -> bool:
    return bool(files) and all(f.suffix == ".pickle" for f in files)


def read(files: list[Path]) -> Reading:
    """One camera per file, in millimetres; OpenCap names it by its folder (``Videos/Cam0``)."""
    return Reading("OpenCap", tuple(_camera(path) for path in files), "mm", ())


def _camera(path: Path) -> RawCamera:
    name = path.parent.name if path.name == _NAME else path.stem
    where = f"camera {name} in {path}"
    table = read_pickle(path)
    if not isinstance(table, dict):
        raise UserError(f"{path} holds no table of camera parameters; it is not OpenCap's {_NAME}")
    if missing := [key for key in _ENTRIES if key not in table]:
        raise UserError(f"{where}: {missing[0]} is missing; a file with intrinsics only needs OpenCap's extrinsics too")
    matrix, distortion, size, rotation, translation = (table[key] for key in _ENTRIES)
    pose = rigid_camera_from_world(rotation, translation, where)
    return raw_camera(name, where, size[::-1], matrix, pose, distortion)


FORMAT = CalibrationFormat(
    "opencap",
    "OpenCap",
    f"`{_NAME}`, one per camera",
    ((f"*/{_NAME}",), (f"Videos/*/{_NAME}",), ("calibration/*.pickle",)),
    recognises,
    read,
    file_per_camera=True,
)
