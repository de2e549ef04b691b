# SPDX-License-Identifier: Apache-2.0
"""``path``: a camera path from a file, in the metric world of ``cameras/``: a transforms.json or a COLMAP model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from studiorecon.camera_files.colmap_models import posed_pictures
from studiorecon.camera_files.raw_camera import RawCamera
from studiorecon.camera_files.transforms_json import read_transforms
from studiorecon.errors import UserError
from studiorecon.progress import say
from studiorecon.render.shots import Time, film_times
from studiorecon.scene.camera import Camera
from studiorecon.scene.dataset import colmap_files
from studiorecon.scene.path import PathStep

# More than rounding to six decimals: the rotation then includes a scale, and the position perhaps too.
_SCALE_TOLERANCE = 1e-4


@dataclass(frozen=True)
class GivenPath:
    """Settings of a ``path`` shot.

    Attributes:
        file: transforms.json (camera-to-world, OpenGL axes; a frame's own ``frame`` gives the time it shows), or
            ``images.txt`` or ``images.bin`` of a COLMAP model.
        time: how time advances where the file gives none, see ``render/shots.py``.
    """

    kind: Literal["path"]
    file: str
    time: Time = "stretch"


def path_steps(shot: GivenPath, name: str, wh: tuple[int, int], frames: int) -> list[PathStep]:
    """The pictures of a path file, in the file's order, resized to the film's width.

    Raises UserError for a file that is missing, empty, of another kind, or whose poses are not rigid.
    """
    file = Path(shot.file)
    if not file.is_file():
        raise UserError(f"shot {name} follows {file}, which is missing")
    try:
        cameras, given, distorted = _of_transforms(file) if file.suffix == ".json" else _of_colmap(file)
    except UserError as refusal:
        raise UserError(f"shot {name} follows {file}: {refusal}") from None
    if not cameras:
        raise UserError(f"shot {name} follows {file}, which holds no camera")
    if distorted:
        say(f"shot {name} follows {file} without the distortion of its lenses: films use pinhole cameras")
    own = cameras[0].wh
    size = wh[0], round(wh[0] * own[1] / own[0] / 2) * 2
    times = film_times(shot.time, len(cameras), frames) if given is None else np.clip(given, 0, frames - 1)
    return [
        PathStep(replace(camera.resized(size), name=name), float(time), "00") for camera, time in zip(cameras, times)
    ]


def _of_colmap(file: Path) -> tuple[list[Camera], None, bool]:
    raw = posed_pictures(colmap_files(file))
    return _pinholes(raw), None, any(camera.distortion.any() for camera in raw)


def _of_transforms(file: Path) -> tuple[list[Camera], np.ndarray | None, bool]:
    found = read_transforms(file)
    scales = np.array([camera.scale for camera in found.cameras])
    scaled = np.flatnonzero(np.abs(scales - 1) > _SCALE_TOLERANCE)
    if len(scaled):
        raise UserError(
            f"transform_matrix of picture {scaled[0]} is no rigid pose; remove its scale of {scales[scaled[0]]:.4g}"
        )
    times = None if any(time is None for time in found.frames) else np.array(found.frames, np.float64)
    return _pinholes(found.cameras), times, any(camera.distortion.any() for camera in found.cameras)


def _pinholes(raw: Sequence[RawCamera]) -> list[Camera]:
    return [Camera(camera.name, camera.wh, camera.intrinsics, camera.camera_from_world) for camera in raw]
