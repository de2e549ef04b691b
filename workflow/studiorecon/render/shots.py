# SPDX-License-Identifier: Apache-2.0
"""Shots: where the camera of a film stands and what time it shows, picture by picture.

``train`` and ``heldout`` show every frame from every camera of their kind, one segment per camera. ``orbit`` goes once around the
scene inside the ring of training cameras; where they cover only an arc, it swings along that arc and back, because beyond it
nothing was filmed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.geometry.path import look_at, scene_centre
from studiorecon.scene.camera import Camera
from studiorecon.scene.path import Step

# A gap between neighbouring cameras beyond this leaves the ring open (the same limit as for the views' path, U18).
_LARGEST_GAP = np.radians(150)


@dataclass(frozen=True)
class Orbit:
    """Settings of an ``orbit`` shot.

    Attributes:
        frames: number of pictures.
        radius: distance to the centre as a share of the training cameras' at the same azimuth.
        rise_m: metres above the training cameras' mean height.
        zoom: focal length as a multiple of the training cameras' mean.
        turn_deg: angle travelled when the ring is closed.
        start_deg: azimuth of the first picture, relative to the first training camera.
        time: ``stretch`` shows the capture once from start to end whatever the number of pictures, ``loop`` shows it at its own speed
            and starts again, ``swing`` at its own speed there and back, ``hold`` its first frame only.
    """

    kind: Literal["orbit"]
    frames: int
    radius: float
    rise_m: float
    zoom: float
    turn_deg: float
    start_deg: float
    time: Literal["stretch", "loop", "swing", "hold"]


def every_frame(cameras: Sequence[Camera], frames: int) -> list[Step]:
    """Each camera × each frame; the segment is the camera's name.

    A film has one size, cameras may differ: all get the largest width and height, and their own picture is its top left part.
    """
    wh = max(c.wh[0] for c in cameras), max(c.wh[1] for c in cameras)
    return [Step(replace(camera, wh=wh), float(frame), camera.name) for camera in cameras for frame in range(frames)]


def looking_at(eye_m: np.ndarray, target_m: np.ndarray) -> np.ndarray:
    """(4, 4) camera_from_world of a level camera at ``eye_m`` whose optical axis meets ``target_m``."""
    transform = np.eye(4)
    transform[:3, :3] = look_at(eye_m, target_m).T
    transform[:3, 3] = -transform[:3, :3] @ eye_m
    return transform


def film_times(kind: str, pictures: int, frames: int) -> np.ndarray:
    """(pictures,) frame of the capture that each picture shows, within 0 … frames - 1."""
    last = frames - 1
    if kind == "hold" or last == 0:
        return np.zeros(pictures)
    if kind == "stretch":
        return np.linspace(0, last, pictures)
    count = np.arange(pictures)
    return (count % frames if kind == "loop" else last - np.abs(last - count % (2 * last))).astype(np.float64)


def azimuths(orbit: Orbit, cameras: Sequence[Camera], centre_m: np.ndarray) -> np.ndarray:
    """(frames,) azimuth of each picture about the centre: once around, or along the filmed arc and back."""
    filmed = _azimuth_of(cameras, centre_m)
    ordered = np.sort(filmed)
    gaps = np.diff(ordered, append=ordered[0] + 2 * np.pi)
    widest = int(np.argmax(gaps))
    if gaps[widest] < _LARGEST_GAP:
        return filmed[0] + np.radians(orbit.start_deg) + np.arange(orbit.frames) / orbit.frames * np.radians(orbit.turn_deg)
    first = ordered[(widest + 1) % len(ordered)]
    swing = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(orbit.frames) / orbit.frames)
    return first + (2 * np.pi - gaps[widest]) * swing


def orbit_steps(
    orbit: Orbit, name: str, cameras: Sequence[Camera], target_m: np.ndarray, wh: tuple[int, int], frames: int, shrink: np.ndarray
) -> list[Step]:
    """The pictures of an orbit; ``shrink`` (pictures,) scales the radius of each once more, to get clear of walls and furniture.

    The radius follows the training cameras' own distances, interpolated over azimuth: a ring in an oblong room stays oblong.
    Raises Refusal without at least two cameras.
    """
    if len(cameras) < 2:
        raise Refusal(f"shot {name} needs at least two training cameras to go around")
    centre = scene_centre(cameras)
    offsets = np.array([camera.centre_m - centre for camera in cameras])
    angles = azimuths(orbit, cameras, centre)
    distances = np.interp(angles, _azimuth_of(cameras, centre), np.linalg.norm(offsets[:, :2], axis=1), period=2 * np.pi)
    height = float(np.mean([camera.centre_m[2] for camera in cameras])) + orbit.rise_m
    radius = distances * orbit.radius * shrink
    eyes = np.stack([centre[0] + radius * np.cos(angles), centre[1] + radius * np.sin(angles), np.full(len(angles), height)], axis=1)
    focal = orbit.zoom * wh[0] * float(np.mean([np.mean(camera.focal_px) / camera.wh[0] for camera in cameras]))
    intrinsics = np.array([[focal, 0, wh[0] / 2], [0, focal, wh[1] / 2], [0, 0, 1.0]])
    times = film_times(orbit.time, orbit.frames, frames)
    return [Step(Camera(name, wh, intrinsics, looking_at(eye, target_m)), float(time), "00") for eye, time in zip(eyes, times)]


def smooth_dips(factors: np.ndarray) -> np.ndarray:
    """A smooth closed curve that never exceeds ``factors`` (pictures,): how a path goes around what stands in its way.

    The least factor within a fourteenth of the film either side, then a Hann window of the same reach: a mean of values that are each
    at most the factor here.
    """
    count = len(factors)
    reach = max(count // 14, 1)
    around = (np.arange(count)[:, None] + np.arange(-reach, reach + 1)) % count
    window = np.hanning(2 * reach + 3)[1:-1]
    return factors[around].min(axis=1)[around] @ (window / window.sum())


def _azimuth_of(cameras: Sequence[Camera], centre_m: np.ndarray) -> np.ndarray:
    offsets = np.array([camera.centre_m - centre_m for camera in cameras])
    return np.arctan2(offsets[:, 1], offsets[:, 0])
