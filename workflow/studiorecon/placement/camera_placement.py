# SPDX-License-Identifier: Apache-2.0
"""Chooses camera positions in a room, and moves that improve existing ones."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.errors import UserError
from studiorecon.geometry.camera_path import look_at
from studiorecon.placement.rig_quality import RigEvaluator
from studiorecon.placement.room import Room
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float

# Distance from the walls to a camera on its tripod or clamp, and from the ceiling.
_FROM_WALLS_M, _FROM_CEILING_M = 0.15, 0.2
_HEIGHTS_M = (1.2, 1.6, 2.0, 2.4, 2.8, 3.4, 4.0)
_AIMS_M = (0.5, 0.8, 1.1, 1.4)
_PHASES = 8
# Trial steps of moves and turns of an existing camera, coarse to fine; and the least gain of an advised move.
_STEPS = ((0.6, 12.0), (0.3, 6.0), (0.1, 3.0))
_FARTHEST_M = 1.5
_MIN_GAIN = 0.03


@dataclass(frozen=True)
class Move:
    """One camera's better pose, all others staying.

    Attributes:
        words: "move cam3 60 cm left and tilt it 6° down", as seen from behind the camera.
        better: the camera there.
        gain: share by which the rig's cost falls.
    """

    camera: str
    words: str
    better: Camera
    gain: float


def lens_from_fov(name: str, hfov_deg: float, wh: tuple[int, int]) -> Camera:
    """A camera in the origin with a horizontal field of view and square pixels."""
    focal = wh[0] / 2 / np.tan(np.radians(hfov_deg) / 2)
    return Camera(name, wh, np.array([[focal, 0, wh[0] / 2], [0, focal, wh[1] / 2], [0, 0, 1.0]]), np.eye(4))


def with_pose(camera: Camera, eye_m: Float[np.ndarray, " 3"], world_from_camera: Float[np.ndarray, "3 3"]) -> Camera:
    """The camera at another position, with rotation."""
    transform = np.eye(4)
    transform[:3, :3] = world_from_camera.T
    transform[:3, 3] = -world_from_camera.T @ eye_m
    return replace(camera, camera_from_world=transform)


def place_cameras(room: Room, lenses: Sequence[Camera]) -> list[Camera]:
    """The lenses at the best of all rings along the room's walls: evenly by walls, at one height, aimed at the middle.

    An even ring is unchanged by half a turn: symmetric rooms get symmetric rigs. Raises UserError below two lenses.
    """
    if len(lenses) < 2:
        raise UserError(f"{len(lenses)} camera cannot measure distance; plan for two or more")
    evaluator = RigEvaluator(room)
    top = room.size_m[2] - _FROM_CEILING_M
    heights = [height for height in _HEIGHTS_M if height < top] + [top]
    rings = [
        ring_of_cameras(room, lenses, phase / _PHASES / len(lenses), height, aim)
        for height, aim, phase in itertools.product(heights, _AIMS_M, range(_PHASES))
        if aim < height
    ]
    costs = np.array([evaluator.cost_m(cameras) for cameras in rings])
    # Mirrored rings have the same cost up to rounding: take the first of them, on every machine.
    return rings[int(np.flatnonzero(costs <= costs.min() + 1e-9)[0])]


def ring_of_cameras(room: Room, lenses: Sequence[Camera], phase: float, height_m: float, aim_m: float) -> list[Camera]:
    """Cameras evenly along the walls, each wall a quarter of the way; phase 0 has the first in a corner."""
    low, high = np.add(room.low_m, _FROM_WALLS_M)[:2], np.subtract(room.high_m, _FROM_WALLS_M)[:2]
    corners = np.array([low, (high[0], low[1]), high, (low[0], high[1]), low])
    floor = room.low_m[2]
    aim = np.array([*room.middle_m, floor + aim_m])
    cameras = []
    for k, camera in enumerate(lenses):
        wall, along = divmod(4 * ((phase + k / len(lenses)) % 1), 1)
        place = corners[int(wall)] + along * (corners[int(wall) + 1] - corners[int(wall)])
        eye = np.array([*place, floor + height_m])
        cameras.append(with_pose(camera, eye, look_at(eye, aim)))
    return cameras


def advise_moves(cameras: Sequence[Camera], room: Room) -> list[Move]:
    """For every camera the best pose near its own, the others staying; those with at least 3 % gain, best first."""
    evaluator = RigEvaluator(room)
    before = evaluator.cost_m(cameras)
    found = []
    for index, camera in enumerate(cameras):
        better, cost = _improve_camera(index, cameras, room, evaluator, before)
        gain = 1 - cost / before
        if gain >= _MIN_GAIN:
            found.append(Move(camera.name, move_text(camera, better), better, float(gain)))
    return sorted(found, key=lambda move: -move.gain)


def _improve_camera(
    index: int, cameras: Sequence[Camera], room: Room, evaluator: RigEvaluator, cost: float
) -> tuple[Camera, float]:
    best, start = cameras[index], cameras[index].centre_m
    others = list(cameras)
    # A camera outside the assumed box of the room may stay there, but not move further out.
    margin = 0.1 if room.holds(start, 0.1) else None
    for step_m, step_deg in _STEPS:
        improving = True
        while improving:
            improving = False
            tried = [
                t
                for t in _nearby_poses(best, step_m, step_deg)
                if np.linalg.norm(t.centre_m - start) <= _FARTHEST_M + 1e-9
            ]
            if margin is not None:
                tried = [t for t in tried if room.holds(t.centre_m, margin)]
            for candidate in tried:
                others[index] = candidate
                found = evaluator.cost_m(others)
                # Each step must be worth measuring with a tape.
                if found < cost * (1 - 0.005):
                    best, cost, improving = candidate, found, True
    return best, cost


def _nearby_poses(camera: Camera, step_m: float, step_deg: float) -> list[Camera]:
    """The camera moved along and across its view and up and down with the same aim, and turned in place."""
    right, ahead, up = _axes(camera)
    rotation, eye = camera.world_from_camera[:3, :3], camera.centre_m
    made = []
    for direction in (right, -right, ahead, -ahead, up, -up):
        made.append(with_pose(camera, eye + step_m * direction, rotation))
    turn = np.radians(step_deg)
    for axis, angle in ((up, turn), (up, -turn), (right, turn), (right, -turn)):
        made.append(with_pose(camera, eye, _rotation(axis, angle) @ rotation))
    # To the side and turned back to the old middle, as a person with a tripod does.
    middle = eye + camera.forward * 3.0
    for direction in (right, -right):
        made.append(
            with_pose(camera, eye + step_m * direction, _turn_to(rotation, eye, eye + step_m * direction, middle, up))
        )
    return made


def _turn_to(
    rotation: np.ndarray, was_m: np.ndarray, eye_m: np.ndarray, target_m: np.ndarray, up: np.ndarray
) -> np.ndarray:
    before, after = (np.arctan2(*(target_m - place)[[1, 0]]) for place in (was_m, eye_m))
    return _rotation(up, after - before) @ rotation


def _axes(camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    up = np.array([0.0, 0.0, 1.0])
    ahead = camera.forward * (1, 1, 0)
    # A camera that points straight down has its picture's top ahead.
    ahead = -camera.camera_from_world[1, :3] * (1, 1, 0) if np.linalg.norm(ahead) < 1e-3 else ahead
    ahead = ahead / np.linalg.norm(ahead)
    return np.cross(ahead, up), ahead, up


def _rotation(axis: np.ndarray, angle_rad: float) -> np.ndarray:
    cross = np.cross(np.eye(3), -axis)
    return np.eye(3) + np.sin(angle_rad) * cross + (1 - np.cos(angle_rad)) * cross @ cross


def move_text(before: Camera, after: Camera) -> str:
    """The way from one placement to the other in words, as seen from behind the camera."""
    right, ahead, up = _axes(before)
    way = after.centre_m - before.centre_m
    steps = [(way @ right, "right", "left"), (way @ ahead, "forward", "back"), (way @ up, "up", "down")]
    moved = [
        f"{5 * round(abs(length) * 20)} cm {one if length > 0 else other}"
        for length, one, other in steps
        if abs(length) >= 0.05
    ]
    heading, tilt = (
        (np.degrees(np.arctan2(c.forward[1], c.forward[0])) for c in (before, after)),
        (np.degrees(np.arcsin(np.clip(c.forward[2], -1, 1))) for c in (before, after)),
    )
    turned = np.subtract(*reversed([*heading]))
    turned, raised = (turned + 180) % 360 - 180, np.subtract(*reversed([*tilt]))
    turns = [f"turn it {abs(turned):.0f}° to the {'left' if turned > 0 else 'right'}"] if abs(turned) >= 1 else []
    turns += [f"tilt it {abs(raised):.0f}° {'up' if raised > 0 else 'down'}"] if abs(raised) >= 1 else []
    moves = [f"move {before.name} {', '.join(moved)}"] if moved else []
    words = [*moves, *turns]
    return (
        " and ".join(words).replace("turn it", f"turn {before.name}" if not moves else "turn it")
        if words
        else f"leave {before.name}"
    )
