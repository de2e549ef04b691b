# SPDX-License-Identifier: Apache-2.0
"""``path``: a camera path from a file, in the metric world of ``cameras/``: a transforms.json or a COLMAP model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.render.shots import Time, film_times
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import read_json
from studiorecon.scene.path import Step

_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
# A pose whose rotation deviates more from a rotation than rounding to six decimals does carries a scale or a mistake.
_ROTATION_TOLERANCE = 1e-4


@dataclass(frozen=True)
class GivenPath:
    """Settings of a ``path`` shot.

    Attributes:
        file: transforms.json (camera-to-world, OpenGL axes; a frame's own ``frame`` says which time it shows), or ``images.txt`` or
            ``images.bin`` of a COLMAP model with pinhole cameras.
        time: how time advances where the file does not say, see ``render/shots.py``.
    """

    kind: Literal["path"]
    file: str
    time: Time = "stretch"


def path_steps(shot: GivenPath, name: str, wh: tuple[int, int], frames: int) -> list[Step]:
    """The pictures of a path file, in the file's order, resized to the film's width.

    Raises Refusal for a file that is missing, empty, of another kind, or whose poses are not rigid.
    """
    file = Path(shot.file)
    if not file.is_file():
        raise Refusal(f"shot {name} follows {file}, which is missing")
    cameras, given = _read_transforms(file, name) if file.suffix == ".json" else (_read_colmap(file, name), None)
    if not cameras:
        raise Refusal(f"shot {name} follows {file}, which holds no camera")
    own = cameras[0].wh
    size = wh[0], round(wh[0] * own[1] / own[0] / 2) * 2
    times = film_times(shot.time, len(cameras), frames) if given is None else np.clip(given, 0, frames - 1)
    return [Step(replace(camera.resized(size), name=name), float(time), "00") for camera, time in zip(cameras, times)]


def _read_colmap(file: Path, name: str) -> list[Camera]:
    import pycolmap

    try:
        model = pycolmap.Reconstruction(str(file.parent))
    except (ValueError, RuntimeError, OSError) as error:
        raise Refusal(f"shot {name} follows {file}, but COLMAP cannot read the model in {file.parent}: {error}") from None
    cameras = []
    for index in sorted(model.images):
        image = model.images[index]
        lens = model.cameras[image.camera_id]
        if lens.model.name not in ("PINHOLE", "SIMPLE_PINHOLE"):
            raise Refusal(f"shot {name}: camera {image.camera_id} of {file.parent} is {lens.model.name}; a path needs PINHOLE cameras")
        camera_from_world = np.eye(4)
        camera_from_world[:3] = image.cam_from_world().matrix()
        cameras.append(Camera(name, (lens.width, lens.height), lens.calibration_matrix(), camera_from_world))
    return cameras


def _read_transforms(file: Path, name: str) -> tuple[Sequence[Camera], np.ndarray | None]:
    content = read_json(file)
    frames = content.get("frames") if isinstance(content, dict) else None
    if not frames:
        raise Refusal(f"shot {name} follows {file}, which has no frames; it is not a transforms.json")
    cameras, times = [], []
    for index, frame in enumerate(frames):
        lens = {**content, **frame}
        try:
            fx, width, height = float(lens["fl_x"]), round(float(lens["w"])), round(float(lens["h"]))
            pose = np.asarray(lens["transform_matrix"], np.float64)
        except KeyError as error:
            raise Refusal(f"shot {name}: picture {index} of {file} has no {error.args[0]}") from None
        if pose.shape not in ((4, 4), (3, 4)) or np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > _ROTATION_TOLERANCE:
            raise Refusal(f"shot {name}: transform_matrix of picture {index} of {file} is no rigid pose; remove its scale")
        cx, cy = float(lens.get("cx", width / 2)), float(lens.get("cy", height / 2))
        intrinsics = np.array([[fx, 0, cx], [0, float(lens.get("fl_y", fx)), cy], [0, 0, 1.0]])
        world_from_camera = np.vstack([pose[:3], [0, 0, 0, 1.0]]) @ _OPENGL_FROM_OPENCV
        camera_from_world = np.eye(4)
        camera_from_world[:3, :3] = world_from_camera[:3, :3].T
        camera_from_world[:3, 3] = -world_from_camera[:3, :3].T @ world_from_camera[:3, 3]
        cameras.append(Camera(name, (width, height), intrinsics, camera_from_world))
        times.append(frame.get("frame"))
    return cameras, None if any(time is None for time in times) else np.array(times, np.float64)
