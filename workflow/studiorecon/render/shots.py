# SPDX-License-Identifier: Apache-2.0
"""Functions that all shots share: a level camera with a target, its lens, and the capture time of each picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.geometry.camera_path import look_at
from studiorecon.scene.camera import Camera
from studiorecon.scene.path import PathStep

if TYPE_CHECKING:
    from jaxtyping import Float

# How time advances over a film: ``stretch`` shows the capture once from start to end whatever the number of pictures,
# ``loop`` shows it at its own speed and repeats it, ``swing`` at its own speed there and back, ``hold`` its first frame
# only, a number that frame only.
Time = Literal["stretch", "loop", "swing", "hold"] | float


def all_frames_path(cameras: Sequence[Camera], frames: int) -> list[PathStep]:
    """Each camera × each frame; the segment is the camera's name.

    All pictures have the largest width and height of the cameras; a camera's own picture is the top left part.
    """
    wh = max(c.wh[0] for c in cameras), max(c.wh[1] for c in cameras)
    return [
        PathStep(replace(camera, wh=wh), float(frame), camera.name) for camera in cameras for frame in range(frames)
    ]


def picture_size(cameras: Sequence[Camera], width: int) -> tuple[int, int]:
    """Even width and height of a film: the first training camera's shape, at ``width`` pixels unless that is 0."""
    own_width, own_height = cameras[0].wh
    wanted = width or own_width
    return wanted // 2 * 2, round(wanted * own_height / own_width / 2) * 2


def usual_focal(cameras: Sequence[Camera], width: int) -> float:
    """Focal length in pixels at ``width`` pixels with the mean angle of view of the training cameras."""
    return width * float(np.mean([np.mean(camera.focal_px) / camera.wh[0] for camera in cameras]))


def look_at_pose(eye_m: Float[np.ndarray, " 3"], target_m: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "4 4"]:
    """Camera_from_world of a level camera at ``eye_m`` whose optical axis meets ``target_m``."""
    transform = np.eye(4)
    transform[:3, :3] = look_at(eye_m, target_m).T
    transform[:3, 3] = -transform[:3, :3] @ eye_m
    return transform


def level_step(
    name: str,
    wh: tuple[int, int],
    focal_px: float,
    eye_m: Float[np.ndarray, " 3"],
    target_m: Float[np.ndarray, " 3"],
    frame: float,
) -> PathStep:
    """One picture of size ``wh`` by a level camera with the target in its middle."""
    intrinsics = np.array([[focal_px, 0, wh[0] / 2], [0, focal_px, wh[1] / 2], [0, 0, 1.0]])
    return PathStep(Camera(name, wh, intrinsics, look_at_pose(eye_m, target_m)), float(frame), "00")


def film_times(kind: Time, pictures: int, frames: int) -> Float[np.ndarray, " pictures"]:
    """Frame of the capture that each picture shows, within 0 … frames - 1."""
    last = frames - 1
    if kind == "hold" or last == 0:
        return np.zeros(pictures)
    if not isinstance(kind, str):
        return np.full(pictures, np.clip(kind, 0, last), np.float64)
    if kind == "stretch":
        return np.linspace(0, last, pictures)
    count = np.arange(pictures)
    return (count % frames if kind == "loop" else last - np.abs(last - count % (2 * last))).astype(np.float64)
