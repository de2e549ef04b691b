# SPDX-License-Identifier: Apache-2.0
"""Camera moves around a subject: dolly zoom and oscillation (the paper's applications), and following a person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.errors import UserError
from studiorecon.render.look_at_targets import LookAtTargets, Target
from studiorecon.render.shots import Time, film_times, level_step, usual_focal
from studiorecon.scene.camera import Camera
from studiorecon.scene.path import PathStep

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class DollyZoom:
    """Settings of a ``dolly_zoom`` shot: the camera approaches while its lens widens: the subject keeps its size.

    Attributes:
        frames: number of pictures.
        target: the subject.
        camera: training camera on whose line to the target the camera moves; empty = the first.
        distances: shares of that camera's distance to the target, at the start and at the end.
        passes: 1 = there, 2 = there and back, and so on.
        zoom: size of the subject as a multiple of that in the camera's own picture.
        time: how time advances, see ``render/shots.py``.
    """

    kind: Literal["dolly_zoom"]
    frames: int = 90
    target: Target = "people"
    camera: str = ""
    distances: tuple[float, float] = (1.0, 0.55)
    passes: int = 2
    zoom: float = 1.0
    time: Time = "stretch"


@dataclass(frozen=True)
class Oscillate:
    """Settings of an ``oscillate`` shot: from side to side of a training camera, for parallax.

    Attributes:
        frames: number of pictures.
        target: the middle of the picture.
        camera: training camera about whose position the camera swings; empty = the first.
        swing_deg: largest angle to either side, seen from the target.
        rise_m: largest rise and fall, a quarter of a period behind: 0 = level, else an ellipse.
        periods: number of periods.
        distance: share of that camera's distance to the target.
        zoom: focal length as a multiple of that camera's.
        time: how time advances, see ``render/shots.py``.
    """

    kind: Literal["oscillate"]
    frames: int = 90
    target: Target = "people"
    camera: str = ""
    swing_deg: float = 20.0
    rise_m: float = 0.15
    periods: float = 2.0
    distance: float = 0.9
    zoom: float = 1.0
    time: Time = "loop"


@dataclass(frozen=True)
class Follow:
    """Settings of a ``follow`` shot: the camera moves along with a person who walks.

    Attributes:
        frames: number of pictures.
        person: the person's id.
        distance_m: horizontal distance to the pelvis; the default shows head and feet at the training cameras' usual
            angle.
        rise_m: height above the pelvis.
        azimuth_deg: direction of the camera: with ``beside: person`` 0 is in front and 180 behind, with ``beside:
            world`` from x.
        beside: ``person`` turns with the person, ``world`` keeps its direction.
        smooth_s: the person's position and facing are smoothed over this time, seconds.
        zoom: focal length as a multiple of the training cameras' mean.
        time: how time advances, see ``render/shots.py``.
    """

    kind: Literal["follow"]
    frames: int = 90
    person: str = "p0"
    distance_m: float = 2.7
    rise_m: float = 0.4
    azimuth_deg: float = 40.0
    beside: Literal["person", "world"] = "person"
    smooth_s: float = 0.7
    zoom: float = 1.0
    time: Time = "stretch"


def dolly_zoom_steps(
    shot: DollyZoom, name: str, cameras: Sequence[Camera], subjects: LookAtTargets, wh: tuple[int, int]
) -> list[PathStep]:
    """The pictures of a dolly zoom: focal length over depth of the target is the same in all of them.

    The rails are straight, from the camera towards the target's position in the first picture; when a person walks, the
    lens follows their true depth. Raises UserError for an unknown camera, and where the rails reach the target.
    """
    start = camera_named(shot.camera, cameras, name)
    times = film_times(shot.time, shot.frames, subjects.frames)
    targets = subjects.at(shot.target, times, name)
    travelled = 0.5 - 0.5 * np.cos(np.pi * shot.passes * np.arange(shot.frames) / max(shot.frames - 1, 1))
    shares = shot.distances[0] + travelled * (shot.distances[1] - shot.distances[0])
    eyes = targets[0] + shares[:, None] * (start.centre_m - targets[0])
    depths = np.linalg.norm(targets - eyes, axis=1)
    if depths.min() < 0.3:
        raise UserError(
            f"shot {name} comes within {depths.min():.2f} m of its target in picture "
            f"{int(depths.argmin())}; raise its distances"
        )
    focal_per_metre = (
        shot.zoom * np.mean(start.focal_px) / start.wh[0] * wh[0] / np.linalg.norm(targets[0] - start.centre_m)
    )
    return [level_step(name, wh, focal_per_metre * depth, *rest) for depth, *rest in zip(depths, eyes, targets, times)]


def oscillate_steps(
    shot: Oscillate,
    name: str,
    cameras: Sequence[Camera],
    subjects: LookAtTargets,
    wh: tuple[int, int],
    shrink: Float[np.ndarray, " pictures"],
) -> list[PathStep]:
    """The pictures of an oscillation; ``shrink`` scales the distance of each, to avoid walls and furniture.

    Raises UserError for an unknown camera.
    """
    start = camera_named(shot.camera, cameras, name)
    times = film_times(shot.time, shot.frames, subjects.frames)
    targets = subjects.at(shot.target, times, name)
    phase = 2 * np.pi * shot.periods * np.arange(shot.frames) / shot.frames
    turned = np.radians(shot.swing_deg) * np.sin(phase)
    # The camera moves along with a walking person.
    offset = start.centre_m - targets[0]
    cos, sin = np.cos(turned), np.sin(turned)
    beside = np.stack(
        [cos * offset[0] - sin * offset[1], sin * offset[0] + cos * offset[1], np.full(len(cos), offset[2])], axis=1
    )
    eyes = targets + shot.distance * shrink[:, None] * beside
    eyes[:, 2] += shot.rise_m * np.sin(phase + np.pi / 2) - shot.rise_m
    focal = shot.zoom * np.mean(start.focal_px) / start.wh[0] * wh[0]
    return [level_step(name, wh, float(focal), *picture) for picture in zip(eyes, targets, times)]


def follow_steps(
    shot: Follow,
    name: str,
    cameras: Sequence[Camera],
    subjects: LookAtTargets,
    wh: tuple[int, int],
    shrink: Float[np.ndarray, " pictures"],
) -> list[PathStep]:
    """The pictures of a follow shot; ``shrink`` scales the distance of each, to avoid walls and furniture.

    Raises UserError for an unknown person.
    """
    times = film_times(shot.time, shot.frames, subjects.frames)
    targets = subjects.at(shot.person, times, name, shot.smooth_s)
    azimuth = np.full(len(times), np.radians(shot.azimuth_deg))
    if shot.beside == "person":
        azimuth = azimuth + subjects.facing_at(shot.person, times, name, shot.smooth_s)
    reach = shot.distance_m * shrink
    eyes = targets + np.stack(
        [reach * np.cos(azimuth), reach * np.sin(azimuth), np.full(len(times), shot.rise_m)], axis=1
    )
    focal = shot.zoom * usual_focal(cameras, wh[0])
    return [level_step(name, wh, focal, *picture) for picture in zip(eyes, targets, times)]


def camera_named(camera: str, cameras: Sequence[Camera], shot: str) -> Camera:
    """The training camera of that name, the first one for an empty name; raises UserError for an unknown name."""
    found = [c for c in cameras if c.name == camera or not camera]
    if not found:
        raise UserError(
            f"shot {shot} starts from camera {camera!r}, but the training cameras are "
            f"{', '.join(c.name for c in cameras)}"
        )
    return found[0]
