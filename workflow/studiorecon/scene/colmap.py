# SPDX-License-Identifier: Apache-2.0
"""COLMAP text models: what the pipeline's own cameras are stored as, and what other tools read.

Only undistorted pinhole cameras are written, and only what was written here is read here: nearly every step reads such a model, which
takes less time than an import of pycolmap would, and spares the networks' images a package. Models of users, with distortion, rigs or in
binary, are ``scene.colmap_models``'.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import write_text


def quaternion_from_rotation(rotation: np.ndarray) -> np.ndarray:
    """(4,) unit quaternion (w, x, y, z), w ≥ 0, of a (3, 3) rotation; stable for all angles (largest-pivot form)."""
    r = np.asarray(rotation, dtype=np.float64)
    squares = np.array([1 + r[0, 0] + r[1, 1] + r[2, 2], 1 + r[0, 0] - r[1, 1] - r[2, 2],
                        1 - r[0, 0] + r[1, 1] - r[2, 2], 1 - r[0, 0] - r[1, 1] + r[2, 2]])  # fmt: skip
    pivot = int(np.argmax(squares))
    rows = np.array(
        [
            [squares[0], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], squares[1], r[1, 0] + r[0, 1], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], squares[2], r[2, 1] + r[1, 2]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[2, 1] + r[1, 2], squares[3]],
        ]
    )
    quaternion = rows[pivot] / np.linalg.norm(rows[pivot])
    return quaternion if quaternion[0] >= 0 else -quaternion


def rotation_from_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotations of quaternions (..., 4) in w, x, y, z order, of any non-zero length."""
    q = np.asarray(quaternion, dtype=np.float64)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    entries = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
               2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
               2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]  # fmt: skip
    return np.stack(entries, axis=-1).reshape(*q.shape[:-1], 3, 3)


def write_model(folder: Path, cameras: Sequence[Camera], points_m: np.ndarray | None = None, colours: np.ndarray | None = None) -> None:
    """Write ``cameras.txt``, ``images.txt`` and ``points3D.txt``; image names are ``<camera>.png``.

    ``points_m`` (N, 3) and ``colours`` (N, 3) in [0, 1] are optional. Numbers are printed with 17 digits: reading gives the
    same bits for intrinsics, and rotations to 1e-15.
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
    rgb = np.full((len(points), 3), 128) if colours is None else np.clip(np.rint(np.asarray(colours) * 255), 0, 255).astype(int)
    for index, (point, colour) in enumerate(zip(points, rgb), start=1):
        point_lines.append(f"{index} " + " ".join(f"{v:.9g}" for v in point) + f" {colour[0]} {colour[1]} {colour[2]} 0")
    for name, lines in (("cameras", camera_lines), ("images", image_lines), ("points3D", point_lines)):
        write_text(folder / f"{name}.txt", "\n".join(lines) + "\n")


def read_model(folder: Path) -> list[Camera]:
    """The cameras of a model written by ``write_model``, in image order; raises Refusal naming the offending file."""
    models = {}
    for line in _lines(folder / "cameras.txt"):
        fields = line.split()
        if fields[1] != "PINHOLE":
            raise Refusal(f"{folder / 'cameras.txt'}: camera {fields[0]} is {fields[1]}; results hold undistorted PINHOLE cameras only")
        fx, fy, cx, cy = (float(v) for v in fields[4:8])
        models[fields[0]] = ((int(fields[2]), int(fields[3])), np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]))
    cameras = []
    for line in _lines(folder / "images.txt"):
        fields = line.split()
        wh, intrinsics = models[fields[8]]
        camera_from_world = np.eye(4)
        camera_from_world[:3, :3] = rotation_from_quaternion(np.array([float(v) for v in fields[1:5]]))
        camera_from_world[:3, 3] = [float(v) for v in fields[5:8]]
        cameras.append(Camera(" ".join(fields[9:]).removesuffix(".png"), wh, intrinsics, camera_from_world))
    return cameras


def read_points(folder: Path) -> np.ndarray:
    """(N, 3) points of a model written by ``write_model``."""
    rows = [line.split()[1:4] for line in _lines(folder / "points3D.txt")]
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def _lines(path: Path) -> list[str]:
    if not path.is_file():
        raise Refusal(f"{path} is missing")
    text = path.read_text(encoding="utf-8").splitlines()
    return [line for line in text if line.strip() and not line.startswith("#")]
