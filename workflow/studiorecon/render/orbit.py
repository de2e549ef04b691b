# SPDX-License-Identifier: Apache-2.0
"""``orbit``: once around the scene inside the ring of training cameras, or along their arc and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.errors import UserError
from studiorecon.geometry.camera_path import LARGEST_GAP_RAD, azimuths_rad, order_around, scene_centre
from studiorecon.render.look_at_targets import LookAtTargets, Target
from studiorecon.render.shots import Time, film_times, level_step, usual_focal
from studiorecon.scene.camera import Camera
from studiorecon.scene.path import PathStep

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class Orbit:
    """Settings of an ``orbit`` shot.

    Attributes:
        frames: number of pictures.
        target: the middle of the picture.
        radius: distance to the centre as a share of the training cameras' at the same azimuth.
        rise_m: metres above the training cameras' mean height.
        zoom: focal length as a multiple of the training cameras' mean.
        turn_deg: angle travelled when the ring is closed.
        start_deg: azimuth of the first picture, relative to the first training camera.
        time: how time advances, see ``render/shots.py``.
    """

    kind: Literal["orbit"]
    frames: int = 120
    target: Target = "people"
    radius: float = 0.9
    rise_m: float = 0.0
    zoom: float = 1.0
    turn_deg: float = 360.0
    start_deg: float = 0.0
    time: Time = "stretch"


def orbit_azimuths(
    orbit: Orbit, cameras: Sequence[Camera], centre_m: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, " frames"]:
    """Azimuth of each picture about the centre: once around, or along the filmed arc and back."""
    filmed = azimuths_rad(cameras, centre_m)
    order, gap_rad = order_around(cameras, centre_m, closed=False)
    if gap_rad < LARGEST_GAP_RAD:
        return (
            filmed[0]
            + np.radians(orbit.start_deg)
            + np.arange(orbit.frames) / orbit.frames * np.radians(orbit.turn_deg)
        )
    swing = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(orbit.frames) / orbit.frames)
    return filmed[order[0]] + (2 * np.pi - gap_rad) * swing


def orbit_steps(
    orbit: Orbit,
    name: str,
    cameras: Sequence[Camera],
    subjects: LookAtTargets,
    wh: tuple[int, int],
    shrink: Float[np.ndarray, " pictures"],
) -> list[PathStep]:
    """The pictures of an orbit; ``shrink`` scales the radius of each once more, to avoid walls and furniture.

    The radius follows the training cameras' distances, interpolated over azimuth: a ring in an oblong room stays
    oblong. Raises UserError without at least two cameras.
    """
    if len(cameras) < 2:
        raise UserError(f"shot {name} needs at least two training cameras to go around")
    centre = scene_centre(cameras)
    offsets = np.array([camera.centre_m - centre for camera in cameras])
    angles = orbit_azimuths(orbit, cameras, centre)
    distances = np.interp(
        angles, azimuths_rad(cameras, centre), np.linalg.norm(offsets[:, :2], axis=1), period=2 * np.pi
    )
    height = float(np.mean([camera.centre_m[2] for camera in cameras])) + orbit.rise_m
    radius = distances * orbit.radius * shrink
    eyes = np.stack(
        [centre[0] + radius * np.cos(angles), centre[1] + radius * np.sin(angles), np.full(len(angles), height)], axis=1
    )
    times = film_times(orbit.time, orbit.frames, subjects.frames)
    targets = subjects.at(orbit.target, times, name)
    focal = orbit.zoom * usual_focal(cameras, wh[0])
    return [level_step(name, wh, focal, *picture) for picture in zip(eyes, targets, times)]
