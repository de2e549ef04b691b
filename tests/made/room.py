# SPDX-License-Identifier: Apache-2.0
"""A small textured room of exact planes, ray-cast in numpy, with a ring of cameras: exact depth for stereo and
warping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from studiorecon.camera_files.colmap import write_model
from studiorecon.footage.video import to_bytes
from studiorecon.geometry.camera_path import look_at, with_pose
from studiorecon.scene.camera import Camera
from studiorecon.scene.room import RoomBox

WH = (192, 108)


@dataclass(frozen=True)
class Room:
    """A box with a table in it; ``open_air`` leaves the floor only, under a plain sky."""

    room_box: RoomBox
    table: RoomBox | None
    seed: int
    open_air: bool = False
    lines: bool = True


def made_room(
    yaw_rad: float = 0.35, seed: int = 0, table: bool = True, open_air: bool = False, lines: bool = True
) -> Room:
    """Walls at -2.9, 3.3 along u and -2.6, 3.1 along v, 3 m high; a cupboard of 1 x 0.8 x 0.8 m stands beside the
    middle."""
    unfitted = (np.zeros(6, bool), np.full(6, np.nan))
    room_box = RoomBox(yaw_rad, np.array([-2.9, -2.6, 0.0]), np.array([3.3, 3.1, 3.0]), *unfitted)
    box = RoomBox(yaw_rad, np.array([-0.9, 0.3, 0.0]), np.array([0.1, 1.1, 0.8]), *unfitted)
    return Room(room_box, box if table else None, seed, open_air, lines)


def ring(
    count: int = 4, radius_m: float = 2.2, wh: tuple[int, int] = WH, height_m: float = 1.7, target_m: float = 0.7
) -> list[Camera]:
    """Cameras around the origin, 0.5 rad off the axes, looking at ``target_m`` above it; 75° wide."""
    focal = wh[0] / 2 / np.tan(np.radians(37.5))
    lens = np.array([[focal, 0, wh[0] / 2], [0, focal, wh[1] / 2], [0, 0, 1.0]])
    cameras = []
    for k in range(count):
        angle = 0.5 + 2 * np.pi * k / count
        eye = np.array([radius_m * np.cos(angle), radius_m * np.sin(angle), height_m])
        blank = Camera(f"cam{k + 1}", wh, lens, np.eye(4))
        cameras.append(with_pose(blank, look_at(eye, np.array([0.0, 0.0, target_m])), eye))
    return cameras


def texture(points: np.ndarray, face: np.ndarray, seed: int, lines: bool = False) -> np.ndarray:
    """(..., 3) colours of surface points: smooth noise of several scales in the face's two coordinates.

    ``lines`` adds floor boards along u and a dark band at the foot and at the middle of every wall."""
    u = np.where(face // 2 == 0, points[..., 1], points[..., 0]) + 20.0
    v = np.where(face // 2 == 2, points[..., 1], points[..., 2]) + 20.0
    rng = np.random.default_rng(seed)
    tables, value = [rng.random((64, 64)) for _ in range(3)], np.zeros((3, *face.shape))
    for scale, share in ((1.1, 0.5), (3.0, 0.5)):
        a, b = u * scale + 7 * face, v * scale + 3 * face
        i, j = np.floor(a).astype(int), np.floor(b).astype(int)
        p, q = (x * x * (3 - 2 * x) for x in (a - i, b - j))
        places = [((i + di) % 64, (j + dj) % 64) for di in (0, 1) for dj in (0, 1)]
        for c, table in enumerate(tables):
            at = [table[place] for place in places]
            value[c] += share * ((at[0] * (1 - q) + at[1] * q) * (1 - p) + (at[2] * (1 - q) + at[3] * q) * p)
    colour = np.ascontiguousarray(np.moveaxis(0.15 + 0.7 * value, 0, -1))
    if lines:
        boards = (face == 4) & ((v / 0.4) % 1 < 0.12)
        bands = (face < 4) & ((v < 20.15) | (np.abs(v - 21.3) < 0.05))
        colour[boards | bands] *= 0.3
    return colour


def photograph(room: Room, camera: Camera, samples: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) float32 picture (box-filtered) and (H, W) exact z-depth; in the open air depth is 0 in the sky."""
    fine = camera.resized((camera.wh[0] * samples, camera.wh[1] * samples))
    colour, _ = _cast(room, fine)
    colour = colour.reshape(camera.hw[0], samples, camera.hw[1], samples, 3).mean((1, 3))
    return colour.astype(np.float32), _cast(room, camera)[1]


def _cast(room: Room, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    origin, rays = camera.rays()
    if room.open_air:
        depth = np.where(rays[..., 2] < 0, -origin[2] / np.minimum(rays[..., 2], -1e-9), 0)
        depth = np.where(depth < 30, depth, 0)
        points = (origin + rays * depth[..., None]) @ room.room_box.axes.T
        sky = np.broadcast_to([0.7, 0.8, 0.9], rays.shape)
        return np.where(depth[..., None] > 0, texture(points, np.full(depth.shape, 4), room.seed), sky), depth
    depth, face = room.room_box.intersect(origin, rays)
    points = (origin + rays * depth[..., None]) @ room.room_box.axes.T
    colour = texture(points, face, room.seed, room.lines)
    if room.table is not None:
        start, way = origin @ room.table.axes.T, rays @ room.table.axes.T
        way = np.where(np.abs(way) < 1e-12, 1e-12, way)
        near, far = (room.table.low_m - start) / way, (room.table.high_m - start) / way
        enter, leave = np.minimum(near, far), np.maximum(near, far).min(-1)
        hit = (enter.max(-1) < leave) & (enter.max(-1) > 0)
        at = np.where(hit, enter.max(-1), depth)
        top = start + way * at[..., None]
        colour = np.where(hit[..., None], texture(top, 2 * enter.argmax(-1), room.seed + 1), colour)
        depth = at
    return colour, depth


def write_capture(
    folder: Path, cameras: Sequence[Camera], pictures: Sequence[np.ndarray], unknown: np.ndarray | None = None
) -> list[Path]:
    """Write the model and RGBA plates as earlier stages do; ``unknown`` (H, W) bool pixels get alpha 0 and a loud
    colour."""
    write_model(folder / "cameras", cameras)
    (folder / "capture").mkdir(parents=True, exist_ok=True)
    plates = []
    for camera, rgb in zip(cameras, pictures):
        rgba = np.dstack([to_bytes(rgb)[..., ::-1], np.full(camera.hw, 255, np.uint8)])
        if unknown is not None:
            rgba[unknown] = [255, 0, 255, 0]
        plates.append(folder / "capture" / f"{camera.name}.plate.png")
        assert cv2.imwrite(str(plates[-1]), rgba)
    return plates
