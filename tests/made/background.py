# SPDX-License-Identifier: Apache-2.0
"""What tests of background and their neighbours share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.background import train
from studiorecon.camera_files.colmap import write_model
from studiorecon.configuration import settings as settings_module
from studiorecon.footage.exr import write_depth
from studiorecon.footage.video import to_bytes, write_lossless
from studiorecon.scene.camera import Camera
from studiorecon.scene.path import PathStep, write_path
from studiorecon.scene.room import RoomBox, write_room

from tests.made.scene import ring
from tests.made.steps import call

BOX = RoomBox(
    yaw_rad=0.2,
    low_m=np.array([-3.0, -2.6, 0.0]),
    high_m=np.array([3.1, 2.7, 2.6]),
    fitted=np.array([1, 1, 1, 1, 1, 0], bool),
    score=np.array([1, 1, 1, 1, 1, np.nan]),
)
WH = (96, 56)


def look(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Picture (H, W, 3) float32 and depth (H, W) of the box room from inside; every face has its own pattern and
    colour."""
    origin, directions = camera.rays()
    depth_m, face = BOX.intersect(origin, directions)
    at = (origin + directions * depth_m[..., None]) @ BOX.axes.T
    tint = np.array(
        [[0.8, 0.4, 0.3], [0.3, 0.6, 0.8], [0.4, 0.8, 0.4], [0.8, 0.8, 0.4], [0.6, 0.5, 0.4], [0.9, 0.9, 0.9]]
    )[face]
    waves = np.sin(2.5 * at[..., :1]) * np.sin(2.5 * at[..., 1:2] + 1) + np.sin(3 * at[..., 2:])
    return np.clip(tint * (1 + 0.25 * waves), 0, 1).astype(np.float32), depth_m.astype(np.float32)


@pytest.fixture(scope="module")
def cameras() -> list[Camera]:
    return ring([0, 90, 180, 270], "cam", wh=WH)


@pytest.fixture(scope="module")
def settings(default_settings: Callable) -> Callable[..., train.Settings]:
    def made(iterations: int = 250, **replaced: object) -> train.Settings:
        section = default_settings("background", **replaced)
        section["training"] = {**section["training"], "iterations": iterations, "warmup_half_resolution": 0.0}
        return settings_module.load(train.Settings, section, "background")

    return made


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory, cameras: list[Camera]) -> dict:
    """Files of the box room; the plate of cam0 has a hole, the depth of cam1 is half default, views repeat the true
    room."""
    folder = tmp_path_factory.mktemp("background")
    write_model(folder / "cameras", cameras)
    write_room(folder / "room.json", BOX)
    options = {
        "model": folder / "cameras/images.txt",
        "room_box": folder / "room.json",
        "plates": [],
        "depths": [],
        "views": [],
        "supports": [],
        "threads": 1,
    }
    for index, camera in enumerate(cameras):
        rgb, depth_m = look(camera)
        alpha = np.full(camera.hw, 255, np.uint8)
        confidence = np.ones(camera.hw)
        if index == 0:
            alpha[20:40, 30:50] = 0
            rgb = np.where(alpha[..., None] == 0, np.float32([1, 0, 1]), rgb)
        if index == 1:
            confidence[:, :48] = 0.1
        options["plates"].append(folder / f"{camera.name}.plate.png")
        cv2.imwrite(str(options["plates"][-1]), np.dstack([to_bytes(rgb)[..., ::-1], alpha]))
        options["depths"].append(folder / f"{camera.name}.exr")
        write_depth(options["depths"][-1], depth_m, confidence)
    steps = []
    for segment, start in enumerate((0, 90, 180, 270)):
        own = [
            PathStep(c, 0.0, f"{segment:02d}") for c in ring([start, start + 30, start + 60], "v", radius_m=2.1, wh=WH)
        ]
        pictures = [to_bytes(look(s.camera)[0]) for s in own]
        for kind, frames in (("views", pictures), ("supports", [np.full(WH[::-1], 255, np.uint8) for _ in own])):
            options[kind].append(folder / f"{segment:02d}.{kind}.mkv")
            write_lossless(options[kind][-1], frames, 30.0)
        steps += own
    options["path"] = folder / "path.json"
    write_path(options["path"], steps, 30.0)
    return options


def run(settings: train.Settings, capture: dict, folder: Path, **replaced: object) -> np.ndarray:
    call(
        train.run,
        settings,
        **(capture | replaced),
        background=folder / "scene.ply",
        provenance=folder / "provenance.npz",
        working=folder / "working",
    )
    with np.load(folder / "provenance.npz") as data:
        return data["provenance"]
