# SPDX-License-Identifier: Apache-2.0
"""COLMAP models of users, text or binary, with distortion: ``cameras`` + ``images``."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import numpy as np

from studiorecon.cameras.formats.raw import RawCamera, Reading, intrinsics_matrix, merged_static, rigid_camera_from_world
from studiorecon.errors import Refusal
from studiorecon.scene.colmap import rotation_from_quaternion

# name, number of parameters, by COLMAP's model id
_MODELS = {0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5), 4: ("OPENCV", 8),
           5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12), 8: ("SIMPLE_RADIAL_FISHEYE", 4), 9: ("RADIAL_FISHEYE", 5)}  # fmt: skip
_GENERIC_FOLDERS = {"images", "input", "rgb", "frames", ".", ""}


def recognises(files: list[Path]) -> bool:
    return len(files) >= 2 and {f.stem for f in files} >= {"cameras", "images"} and {f.suffix for f in files} <= {".txt", ".bin"}


def read(files: list[Path]) -> Reading:
    """One static camera per picture folder (or picture); COLMAP's scale is arbitrary unless the model was aligned."""
    return Reading("COLMAP", tuple(merged_static(posed_pictures(files), 0.01, 1.0)), "unknown", ())


def posed_pictures(files: list[Path]) -> list[RawCamera]:
    """One entry per registered picture, named after its camera."""
    paths = {f.stem: f for f in files}
    lenses = dict(_binary_cameras(paths["cameras"]) if paths["cameras"].suffix == ".bin" else _text_cameras(paths["cameras"]))
    images = _binary_images(paths["images"]) if paths["images"].suffix == ".bin" else _text_images(paths["images"])
    cameras = []
    for quaternion, translation, camera_id, image in images:
        name = camera_name(image)
        where = f"picture {image} in {paths['images']}"
        if camera_id not in lenses:
            raise Refusal(f"{where}: its camera {camera_id} is not in {paths['cameras'].name}; the two files belong to different models")
        wh, intrinsics, model, distortion = lenses[camera_id]
        pose, _ = rigid_camera_from_world(rotation_from_quaternion(quaternion), translation, where)
        cameras.append(RawCamera(name, wh, intrinsics, model, distortion, pose))
    return cameras


def camera_name(image: str) -> str:
    """The folder of ``cam01/00001.jpg`` or ``images/cam01/000000.jpg``, the stem of ``cam01.png`` or ``images/cam01.png``."""
    path = PurePosixPath(image.replace("\\", "/"))
    return path.parent.name if path.parent.name not in _GENERIC_FOLDERS else path.stem


def _lens(model: str, wh: tuple[int, int], p: list[float], where: str) -> tuple[tuple[int, int], np.ndarray, str, np.ndarray]:
    distortion = np.zeros(8)
    kind = "opencv"
    if model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"):
        fx, fy, cx, cy, rest = p[0], p[0], p[1], p[2], p[3:]
    elif model in ("PINHOLE", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV"):
        fx, fy, cx, cy, rest = p[0], p[1], p[2], p[3], p[4:]
    else:
        raise Refusal(f"{where}: camera model {model} is not supported; use one of {', '.join(n for n, _ in _MODELS.values())}")
    if model.endswith("FISHEYE"):
        kind, distortion = "fisheye", np.pad(np.array(rest), (0, 4 - len(rest)))
    else:
        distortion[: len(rest)] = rest
    return wh, intrinsics_matrix(fx, fy, cx, cy, integer_centres=False), kind, distortion


def _text_cameras(path: Path) -> Iterator[tuple[int, tuple]]:
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.strip() and not line.startswith("#"):
            fields = line.split()
            yield int(fields[0]), _lens(fields[1], (int(fields[2]), int(fields[3])), [float(v) for v in fields[4:]], str(path))


def _text_images(path: Path) -> Iterator[tuple[np.ndarray, np.ndarray, int, str]]:
    # Two lines per picture, the second possibly empty and possibly megabytes long: stream it.
    with open(path, encoding="utf-8") as file:
        for line in file:
            if line.startswith("#") or not line.strip():
                continue
            fields = line.split(maxsplit=9)
            yield np.array([float(v) for v in fields[1:5]]), np.array([float(v) for v in fields[5:8]]), int(fields[8]), fields[9].strip()
            next(file, None)


def _binary_cameras(path: Path) -> Iterator[tuple[int, tuple]]:
    with open(path, "rb") as file:
        for _ in range(_unpack(file, "Q", path)[0]):
            camera_id, model_id, width, height = _unpack(file, "iiQQ", path)
            if model_id not in _MODELS:
                raise Refusal(
                    f"{path}: camera {camera_id} has the model id {model_id}, which is not supported; undistort with COLMAP first"
                )
            model, count = _MODELS[model_id]
            yield camera_id, _lens(model, (width, height), list(_unpack(file, "d" * count, path)), str(path))


def _binary_images(path: Path) -> Iterator[tuple[np.ndarray, np.ndarray, int, str]]:
    with open(path, "rb") as file:
        for _ in range(_unpack(file, "Q", path)[0]):
            _, *pose, camera_id = _unpack(file, "idddddddi", path)
            name = bytearray()
            while (byte := file.read(1)) not in (b"\0", b""):
                name += byte
            (points,) = _unpack(file, "Q", path)
            file.seek(points * 24, 1)
            yield np.array(pose[:4]), np.array(pose[4:]), camera_id, name.decode("utf-8")


def _unpack(file, layout: str, path: Path) -> tuple:
    data = file.read(struct.calcsize("<" + layout))
    if len(data) < struct.calcsize("<" + layout):
        raise Refusal(f"{path} ends in the middle of an entry; copy it again")
    return struct.unpack("<" + layout, data)
