# SPDX-License-Identifier: Apache-2.0
"""Floors with something on them, as cameras see them, and cameras that stand a little elsewhere."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
from studiorecon.geometry.camera_motion import move_camera
from studiorecon.geometry.rotations import angle, exp
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera

_PLACE_M, _HALF_M = 0.01, 3.0


def carpet(seed: int) -> np.ndarray:
    """(H, W) uint8 floor, 1 cm a place: rectangles of all sizes on a carpet, bare beside it."""
    rng, size = np.random.default_rng(seed), round(2 * _HALF_M / _PLACE_M)
    floor = np.full((size, size), 120, np.uint8)
    for _ in range(300):
        corner, wide = rng.integers(120, 440, 2), rng.integers(6, 40, 2)
        cv2.rectangle(floor, corner.tolist(), (corner + wide).tolist(), int(rng.integers(20, 230)), -1)
    return floor


def boards(period_m: float) -> np.ndarray:
    """The same with one pattern that repeats along both directions."""
    along = np.arange(round(2 * _HALF_M / _PLACE_M)) * _PLACE_M
    wave = np.sin(2 * np.pi * along / period_m) > 0
    return np.where(wave[:, None] ^ wave[None], 200, 60).astype(np.uint8)


def room(camera: Camera, floor: np.ndarray, seed: int, gain: float = 1.0, height_m: float = 0.0) -> RoomPicture:
    """What the camera sees of a floor at a height, with noise; nothing else is there."""
    rows, columns = np.mgrid[: camera.wh[1], : camera.wh[0]]
    pixels = np.stack([columns, rows], -1).reshape(-1, 2) + 0.5
    rays = camera.unproject(pixels, np.ones(len(pixels))) - camera.centre_m
    along = (height_m - camera.centre_m[2]) / np.where(rays[:, 2] < -1e-3, rays[:, 2], np.nan)
    at = (camera.centre_m[:2] + rays[:, :2] * along[:, None] + _HALF_M) / _PLACE_M - 0.5
    at = np.nan_to_num(at, nan=-1.0).astype(np.float32).reshape(*rows.shape, 2)
    seen = cv2.remap(floor.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=90.0)
    noise = np.random.default_rng(seed).normal(0, 2.0, seen.shape)
    return RoomPicture(np.clip(gain * seen + noise, 0, 255).astype(np.uint8), np.ones(seen.shape, bool))


def off(cameras: list[Camera], seed: int, degrees: float, metres: float) -> list[Camera]:
    """Every camera turned and moved by about so much."""
    rng = np.random.default_rng(seed)
    found = []
    for c in cameras:
        turn = exp(np.radians(rng.normal(0, degrees / np.sqrt(3), 3)))
        found.append(
            move_camera(c, turn @ c.camera_from_world[:3, :3], c.centre_m + rng.normal(0, metres / np.sqrt(3), 3))
        )
    return found


def between_deg(found: list[Camera], truth: list[Camera]) -> float:
    """Largest error of the rotation between two cameras."""
    rotations = [[c.camera_from_world[:3, :3] for c in group] for group in (found, truth)]
    pairs = itertools.combinations(range(len(truth)), 2)
    return max(
        float(np.degrees(angle(rotations[0][a] @ rotations[0][b].T, rotations[1][a] @ rotations[1][b].T)))
        for a, b in pairs
    )
