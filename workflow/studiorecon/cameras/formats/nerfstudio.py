# SPDX-License-Identifier: Apache-2.0
"""nerfstudio and instant-ngp ``transforms.json``: camera-to-world with OpenGL axes, intrinsics on top or per frame."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import numpy as np

from studiorecon.cameras.formats.raw import (
    RawCamera,
    Reading,
    camera_from_world_of_pose,
    intrinsics_matrix,
    merged_static,
    opencv_distortion,
)
from studiorecon.errors import Refusal
from studiorecon.scene.files import read_json

_GENERIC_FOLDERS = {"images", "input", "rgb", "frames", ".", ""}
_OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def recognises(files: list[Path]) -> bool:
    return len(files) == 1 and files[0].suffix == ".json"


def read(files: list[Path]) -> Reading:
    """One camera per label, picture folder or picture name; ``applied_transform`` is undone."""
    path = files[0]
    content = read_json(path)
    if not isinstance(content, dict) or not content.get("frames"):
        raise Refusal(f"{path} has no frames; it is not a nerfstudio transforms.json")
    applied = np.eye(4)
    notes = []
    if "applied_transform" in content:
        applied[:3] = np.asarray(content["applied_transform"], dtype=np.float64)[:3]
        notes.append("the file's applied_transform was undone")
    cameras = [_camera({**content, **frame}, np.linalg.inv(applied), path) for frame in content["frames"]]
    return Reading("nerfstudio transforms.json", tuple(merged_static(cameras, 0.01, 1.0)), "unknown", tuple(notes))


def camera_name(frame: dict) -> str:
    """``camera_label`` when there is one, else the picture's folder, else the picture's stem."""
    if frame.get("camera_label") is not None:
        return str(frame["camera_label"])
    path = PurePosixPath(str(frame.get("file_path", "")))
    return path.parent.name if path.parent.name not in _GENERIC_FOLDERS else path.stem


def _camera(frame: dict, source_from_file: np.ndarray, path: Path) -> RawCamera:
    name = camera_name(frame)
    where = f"camera {name} in {path}"
    try:
        fx, cx, cy, width, height = (float(frame[k]) for k in ("fl_x", "cx", "cy", "w", "h"))
        pose = np.asarray(frame["transform_matrix"], dtype=np.float64)
    except KeyError as error:
        raise Refusal(f"{where}: {error.args[0]} is missing") from None
    fy = float(frame.get("fl_y", fx))
    fisheye = str(frame.get("camera_model", "OPENCV")).upper() == "OPENCV_FISHEYE"
    # distortion_params, where a file has them, are nerfstudio's own order k1 k2 k3 k4 p1 p2.
    listed = dict(zip(("k1", "k2", "k3", "k4", "p1", "p2"), frame.get("distortion_params") or ()))
    k = [float(frame.get(key, listed.get(key, 0))) for key in ("k1", "k2", "k3", "k4")]
    p = [float(frame.get(key, listed.get(key, 0))) for key in ("p1", "p2")]
    world_from_camera = source_from_file @ np.vstack([pose[:3], [0, 0, 0, 1]]) @ _OPENCV_FROM_OPENGL
    return RawCamera(
        name=name,
        wh=(round(width), round(height)),
        # The numbers come from COLMAP, which has its pixel centres at +0.5 already.
        intrinsics=intrinsics_matrix(fx, fy, cx, cy, integer_centres=False),
        model="fisheye" if fisheye else "opencv",
        distortion=np.array(k) if fisheye else opencv_distortion([k[0], k[1], p[0], p[1], k[2], k[3]], where),
        camera_from_world=camera_from_world_of_pose(world_from_camera, where),
    )
