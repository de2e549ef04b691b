# SPDX-License-Identifier: Apache-2.0
"""What tests of objects rotation and their neighbours share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.configuration import settings as settings_module
from studiorecon.geometry import rotations
from studiorecon.objects.find import ObjectView, Settings, add_typical_difference, find_objects
from studiorecon.scene.camera import Camera
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.rigid_object import RigidObject

from tests.made.objects import CAMERAS, FPS, FRAMES, UNSEEN, WH, nobody, plate_of

HALF_M = np.array([0.24, 0.09, 0.045])


COLOURS = np.array([[0.8, 0.15, 0.1], [0.15, 0.25, 0.75]], np.float32)


@dataclass(frozen=True)
class Board:
    """A board of two colours, one at each end, along ``path_m`` (T, 3), turned by ``world_from_board`` (T, 3, 3)."""

    path_m: np.ndarray
    world_from_board: np.ndarray
    half_m: tuple[float, float, float] = tuple(HALF_M)

    def over(self, camera: Camera, picture: np.ndarray, frame: int) -> np.ndarray:
        """The picture (H, W, 3) with the board, one ray a pixel."""
        turn = self.world_from_board[frame]
        origin, rays = camera.rays()
        start, along = (origin - self.path_m[frame]) @ turn, rays @ turn
        half = np.array(self.half_m)
        with np.errstate(divide="ignore"):
            low, high = (-half - start) / along, (half - start) / along
            near, far = np.minimum(low, high), np.maximum(low, high)
        enters, leaves = near.max(axis=-1), far.min(axis=-1)
        point = start + enters[..., None] * along
        return np.where((enters < leaves)[..., None], COLOURS[(point[..., 0] > 0).astype(int)], picture)


def tumbling(frames: int = FRAMES) -> Board:
    """A board thrown through the room that turns by 150° about a slanted axis and by 60° about the vertical one."""
    phase = np.linspace(0, 1, frames)
    axis = np.array([0.35, 0.9, 0.25])
    tilt = rotations.exp(np.radians(150) * (phase + 0.06 * np.sin(6 * phase))[:, None] * axis / np.linalg.norm(axis))
    spin = rotations.exp(np.radians(60) * phase[:, None] * [0, 0, 1.0])
    path = np.stack([np.linspace(-0.6, 0.6, frames), np.full(frames, 0.1), 0.6 + 2.4 * phase * (1 - phase)], axis=1)
    return Board(path, spin @ tilt @ rotations.exp(np.array([0.3, -0.4, 0.2])))


def shown(board: Board, camera: Camera, frame: int) -> np.ndarray:
    """(H, W, 3) uint8 picture, four rays a pixel, with noise of one grey level."""
    fine = camera.resized((2 * WH[0], 2 * WH[1]))
    picture = board.over(fine, cv2.resize(plate_of(camera), fine.wh, interpolation=cv2.INTER_NEAREST), frame)
    small = cv2.resize(picture.astype(np.float32), WH, interpolation=cv2.INTER_AREA) * 255
    noise = np.random.default_rng([3, frame, CAMERAS.index(camera) if camera in CAMERAS else 9]).normal(
        0, 1, small.shape
    )
    return np.clip(np.rint(small + noise), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def settings(default_settings: Callable) -> Settings:
    loaded = settings_module.load(Settings, default_settings("objects"), "objects")
    return replace(loaded, shape=replace(loaded.shape, gaussians=400, iterations=200))


def found(settings: Settings, pictured: Callable[[Camera, int], np.ndarray]) -> list[RigidObject]:
    moments = [([pictured(c, frame) for c in CAMERAS], [nobody(c, frame) for c in CAMERAS]) for frame in range(FRAMES)]
    views = [ObjectView(c, Path(), plate_of(c), np.ones(c.hw, bool), np.zeros(c.hw, np.float32)) for c in CAMERAS]
    return find_objects(
        iter(moments), add_typical_difference(views, iter(moments), settings.loose), FRAMES, FPS, settings, 1
    )


def pictured(camera: Camera, frame: int) -> np.ndarray:
    return shown(tumbling(), camera, frame)


def turn_errors_deg(thing: RigidObject, board: Board) -> np.ndarray:
    """(T,) degrees between true and found turns; which way the thing's own axes lie is its own affair."""
    board_from_object, _ = rotations.mean(
        np.swapaxes(board.world_from_board, 1, 2)[thing.valid] @ thing.world_from_object[thing.valid]
    )
    return np.degrees(rotations.angle(board.world_from_board @ board_from_object, thing.world_from_object))


def seen_db(thing: RigidObject | None, pictured: Callable[[Camera, int], np.ndarray]) -> float:
    """PSNR in what the thing truly covers at a camera that nobody has, over every third picture."""
    squares, count = 0.0, 0
    for frame in range(1, FRAMES, 3):
        truth, made = pictured(UNSEEN, frame) / 255, plate_of(UNSEEN)
        mask = np.abs(truth - made).max(axis=-1) > 0.1
        if thing is not None:
            picture = Rasteriser(near_m=0.05, threads=1).forward(thing.posed(frame), UNSEEN)
            made = picture.rgb + (1 - picture.alpha[..., None]) * made
        squares += float(np.square(made - truth)[mask].sum())
        count += 3 * int(mask.sum())
    return -10 * np.log10(squares / count)
