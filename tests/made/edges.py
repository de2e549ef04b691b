# SPDX-License-Identifier: Apache-2.0
"""A room's straight edges as cameras see them, among lines that run anywhere."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from studiorecon.geometry.camera_motion import move_camera
from studiorecon.geometry.rotations import exp
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera

ROOM_M = np.array([[-3.0, -2.5, 0.0], [3.0, 2.5, 2.6]])


def edges_in(
    camera: Camera, seed: int, clutter: float = 0.4, noise_px: float = 0.5, yaw_rad: float = 0.3, only: int = -1
) -> np.ndarray:
    """(N, 4) pieces of lines along the room's axes (``only`` one of them) that the camera sees, turned by ``yaw_rad``,
    and a share of lines that run anywhere."""
    rng = np.random.default_rng(seed)
    turn = exp(np.array([0.0, 0.0, yaw_rad]))
    count = 300
    axis = np.full(count, only) if only >= 0 else rng.integers(0, 3, count)
    starts = rng.uniform(*ROOM_M, (count, 3))
    ways = np.eye(3)[axis]
    random = rng.random(count) < clutter
    ways[random] = rng.normal(size=(int(random.sum()), 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    ends = np.stack([starts, starts + rng.uniform(0.3, 1.5, (count, 1)) * ways], axis=1) @ turn.T
    pixels, depth = camera.project(ends)
    inside = ((pixels > 0) & (pixels < camera.wh)).all((1, 2)) & (depth > 0.3).all(1)
    found = pixels[inside] + rng.normal(0, noise_px, (int(inside.sum()), 2, 2))
    return found[np.linalg.norm(found[:, 1] - found[:, 0], axis=1) > 20].reshape(-1, 4)


def drawn(camera: Camera, seed: int, clutter: float = 0.2) -> RoomPicture:
    """A picture of the room in which only its edges are seen."""
    rng, picture = np.random.default_rng(seed), np.full(camera.wh[::-1], 120, np.uint8)
    for ends in edges_in(camera, seed, clutter):
        start, end = np.round((ends.reshape(2, 2) - 0.5) * 16).astype(int).tolist()
        cv2.line(picture, start, end, int(rng.choice([20, 230])), 2, cv2.LINE_AA, 4)
    return RoomPicture(picture, np.ones(picture.shape, bool))


def about_the_spot(cameras: Sequence[Camera], degrees: Sequence[float]) -> list[Camera]:
    """Every camera carried around the world's origin by its own degrees: it still looks at who stands there."""
    found = []
    for camera, d in zip(cameras, degrees, strict=True):
        turn = exp(np.array([0.0, 0.0, np.radians(d)]))
        found.append(move_camera(camera, camera.camera_from_world[:3, :3] @ turn.T, turn @ camera.centre_m))
    return found
