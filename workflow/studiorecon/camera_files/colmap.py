# SPDX-License-Identifier: Apache-2.0
"""COLMAP text models: the format of the pipeline's own cameras, and for other tools.

Only undistorted pinhole cameras are written, and only models written here are read: nearly every step reads such a
model, which takes less time than importing pycolmap, and saves the networks' images a package. Users' models, with
distortion, rigs or in binary, are read by ``camera_files.colmap_models``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry import rotations
from studiorecon.scene.camera import CAMERA, Camera
from studiorecon.scene.files import write_text
from studiorecon.scene.schema import check, metres
from studiorecon.scene.step_files import CURE, expect, require, step_file_context
from studiorecon.scene.user_files import read_text
from studiorecon.scene.user_values import short_text

if TYPE_CHECKING:
    from jaxtyping import Num


def quaternion_from_rotation(rotation: Num[np.ndarray, "3 3"]) -> Num[np.ndarray, " 4"]:
    """Unit quaternion (w, x, y, z), w ≥ 0, of a rotation, as in COLMAP's files."""
    direction = rotations.largest_quaternion_row(rotation)
    # The length of one vector: along an axis numpy rounds differently, and the last digits of models would change.
    quaternion = direction / np.linalg.norm(direction)
    return quaternion if quaternion[0] >= 0 else -quaternion


def write_model(
    folder: Path,
    cameras: Sequence[Camera],
    points_m: Num[np.ndarray, "N 3"] | None = None,
) -> None:
    """Write ``cameras.txt``, ``images.txt`` and ``points3D.txt``; image names are ``<camera>.png``.

    Numbers have 17 digits: reading gives the same intrinsics, and rotations to 1e-15.
    """
    camera_lines = ["# Camera list: CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]; pixel centres at 0.5"]
    image_lines = ["# Image list: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of 2D points (none)"]
    for index, camera in enumerate(cameras, start=1):
        numbers = [*camera.focal_px, *camera.principal_px]
        camera_lines.append(f"{index} PINHOLE {camera.wh[0]} {camera.wh[1]} " + " ".join(f"{v:.17g}" for v in numbers))
        pose = [*quaternion_from_rotation(camera.camera_from_world[:3, :3]), *camera.camera_from_world[:3, 3]]
        image_lines += [f"{index} " + " ".join(f"{v:.17g}" for v in pose) + f" {index} {camera.name}.png", ""]
    point_lines = ["# 3D point list: POINT3D_ID X Y Z R G B ERROR TRACK[]"]
    points = np.zeros((0, 3)) if points_m is None else np.asarray(points_m)
    for index, point in enumerate(points, start=1):
        point_lines.append(f"{index} " + " ".join(f"{v:.9g}" for v in point) + " 128 128 128 0")
    for name, lines in (("cameras", camera_lines), ("images", image_lines), ("points3D", point_lines)):
        write_text(folder / f"{name}.txt", "\n".join(lines) + "\n")


def read_model(folder: Path) -> list[Camera]:
    """The cameras of a model written by ``write_model``, in image order; raises UserError with the file's name."""
    with step_file_context(folder / "cameras.txt"):
        models = _models(_rows(folder / "cameras.txt", 8))
    with step_file_context(folder / "images.txt"):
        cameras = _cameras(_rows(folder / "images.txt", 10), models)
        expect(len(cameras) == len(models), f"{len(cameras)} of the {len(models)} cameras of cameras.txt")
        expect(len({camera.name for camera in cameras}) == len(cameras), "two cameras share a name")
    return cameras


def camera_named(cameras: Sequence[Camera], name: str, model: Path) -> Camera:
    """The camera ``name`` of the file ``model``; raises UserError where it has none."""
    own = [camera for camera in cameras if camera.name == name]
    require(model, own, f"it has no camera {name}, but {', '.join(camera.name for camera in cameras)}")
    return own[0]


def _models(rows: Sequence[Sequence[str]]) -> dict[str, tuple[tuple[int, int], np.ndarray]]:
    models = {}
    for number, model, width, height, *parameters in rows:
        expect(model == "PINHOLE", f"camera {number} is {model}; results hold undistorted PINHOLE cameras only")
        expect(number not in models, f"camera {number} twice")
        fx, fy, cx, cy = map(float, parameters)
        intrinsics = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
        wh = (int(width), int(height))
        check({"wh": list(wh), "intrinsics": intrinsics}, {name: CAMERA[name] for name in ("wh", "intrinsics")})
        models[number] = (wh, intrinsics)
    return models


def _cameras(rows: Sequence[Sequence[str]], models: Mapping[str, tuple[tuple[int, int], np.ndarray]]) -> list[Camera]:
    cameras = []
    for row in rows:
        wh, intrinsics = models[row[8]]
        quaternion = np.array([float(v) for v in row[1:5]])
        # Quaternions are written with 17 digits.
        expect(abs(float(quaternion @ quaternion) - 1) < 1e-6, f"quaternion {' '.join(row[1:5])} is not of length 1")
        camera_from_world = np.eye(4)
        camera_from_world[:3, :3] = rotations.from_quaternion(quaternion)
        camera_from_world[:3, 3] = [float(v) for v in row[5:8]]
        check(camera_from_world, CAMERA["camera_from_world"], f"pose of {row[9]}")
        cameras.append(Camera(row[9].removesuffix(".png"), wh, intrinsics, camera_from_world))
    return cameras


def read_points(folder: Path) -> Num[np.ndarray, "N 3"]:
    """Points of a model written by ``write_model``; raises UserError with the file's name."""
    with step_file_context(folder / "points3D.txt"):
        rows = [[float(v) for v in row[1:4]] for row in _rows(folder / "points3D.txt", 8)]
        points = np.array(rows, dtype=np.float64).reshape(-1, 3)
        check(points, metres("N 3"), "points")
        return points


def _rows(path: Path, columns: int) -> list[list[str]]:
    """The words of every line that is no comment; the last of ``columns`` may contain blanks.

    Raises ValueError if cut off.
    """
    text = read_text(path, CURE)
    expect(text.startswith("#") and text.endswith("\n"), "its beginning or its end is missing")
    lines = [line for line in text.split("\n") if line.strip() and not line.startswith("#")]
    rows = [line.split(None, columns - 1) for line in lines]
    for line, row in zip(lines, rows):
        expect(len(row) == columns, f"{len(row)} of {columns} columns in {short_text(line)}")
    return rows
