# SPDX-License-Identifier: Apache-2.0
"""nerfstudio's and instant-ngp's ``transforms.json``: camera-to-world, OpenGL axes, intrinsics on top or per frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from studiorecon.camera_files.lens_kinds import lens_model
from studiorecon.camera_files.raw_camera import RawCamera, camera_from_world_of_pose, pose_rows, raw_camera
from studiorecon.errors import UserError
from studiorecon.scene.files import read_json
from studiorecon.scene.user_values import numbers, short_text

_GENERIC_FOLDERS = {"images", "input", "rgb", "frames", ".", ""}
_LENS = {"camera_model", "is_fisheye"}
_TERMS = {"opencv": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), "fisheye": ("k1", "k2", "k3", "k4")}
# Coefficients of the thin prism, which neither of our models has.
_NEVER = ("sx1", "sy1", "sx2", "sy2", "s1", "s2", "s3", "s4")
_OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Transforms:
    """The contents of a transforms.json.

    Attributes:
        cameras: one per picture, in the file's order, in the world before ``applied_transform``.
        frames: time that each picture shows, as deliveries of this project's own path files have it, or None.
        notes: sentences: every change and assumption.
    """

    cameras: tuple[RawCamera, ...]
    frames: tuple[float | None, ...]
    notes: tuple[str, ...]


def read_transforms(path: Path) -> Transforms:
    """The contents of ``path``; raises UserError for missing frames, lenses or poses, and for no rotation."""
    content = read_json(path)
    if not isinstance(content, dict) or not content.get("frames"):
        raise UserError(f"{path} has no frames; it is not a nerfstudio transforms.json")
    applied, notes = np.eye(4), []
    if "applied_transform" in content:
        applied[:3] = np.asarray(content["applied_transform"], dtype=np.float64)[:3]
        notes.append("the file's applied_transform was undone")
    # A picture's own lens takes precedence over the file's.
    common = {key: value for key, value in content.items() if key != "frames"}
    lenses = [
        {**{k: v for k, v in common.items() if k not in _LENS or not _LENS & frame.keys()}, **frame}
        for frame in content["frames"]
    ]
    if not all("cx" in lens and "cy" in lens for lens in lenses):
        notes.append(
            f"{path.name} has no principal point (cx, cy) for some pictures: the middle of the picture is used"
        )
    source_from_file = np.linalg.inv(applied)
    cameras = [_camera(lens, source_from_file, f"picture {index} of {path}") for index, lens in enumerate(lenses)]
    times = tuple(None if frame.get("frame") is None else float(frame["frame"]) for frame in content["frames"])
    return Transforms(tuple(cameras), times, tuple(notes))


def camera_name(frame: dict[str, Any]) -> str:
    """``camera_label`` when there is one, else the picture's folder, else the picture's stem."""
    if frame.get("camera_label") is not None:
        return str(frame["camera_label"])
    path = PurePosixPath(str(frame.get("file_path", "")).replace("\\", "/"))
    return path.parent.name if path.parent.name not in _GENERIC_FOLDERS else path.stem


def _camera(lens: dict[str, Any], source_from_file: np.ndarray, where: str) -> RawCamera:
    try:
        width, height = numbers([lens["w"], lens["h"]], f"{where}: its w and h").tolist()
        fx = float(lens["fl_x"]) if "fl_x" in lens else width / 2 / np.tan(float(lens["camera_angle_x"]) / 2)
        if not isinstance(lens.get("file_path", ""), str):
            raise UserError(f"{where}: its file_path is {short_text(lens['file_path'])}; it must name the picture")
        pose = pose_rows(lens["transform_matrix"], f"{where}: its transform_matrix")
    except KeyError as error:
        missing = str(error.args[0]).replace("camera_angle_x", "fl_x or camera_angle_x")
        raise UserError(f"{where} has no {missing}; write it there") from None
    across = lens.get("camera_angle_y")
    fy = float(lens.get("fl_y", height / 2 / np.tan(float(across) / 2) if across else fx))
    cx, cy = float(lens.get("cx", width / 2)), float(lens.get("cy", height / 2))
    model = lens_model(lens, where)
    # distortion_params, if a file has them, are in nerfstudio's own order k1 k2 k3 k4 p1 p2.
    listed = dict(zip(("k1", "k2", "k3", "k4", "p1", "p2"), lens.get("distortion_params") or ()))
    term = {key: lens.get(key, listed.get(key, 0)) for key in (*_TERMS["opencv"], *_NEVER)}
    if odd := next((key for key in lens if key != key.lower() and key.lower() in (*term, "cx", "cy", "fl_y")), None):
        raise UserError(f"{where}: {odd} is no number of a lens; did you mean {odd.lower()}?")
    if left := [key for key, value in term.items() if value and key not in _TERMS[model]]:
        raise UserError(
            f"{where}: {left[0]} is {short_text(term[left[0]])}, which the lens model {model} does not have"
        )
    world_from_camera = source_from_file @ np.vstack([pose, [0, 0, 0, 1]]) @ _OPENCV_FROM_OPENGL
    # The numbers come from COLMAP, which has its pixel centres at +0.5 already.
    return raw_camera(
        camera_name(lens),
        where,
        (width, height),
        (fx, fy, cx, cy),
        camera_from_world_of_pose(world_from_camera, where),
        [term[key] for key in _TERMS[model]],
        model,
        integer_centres=False,
    )
