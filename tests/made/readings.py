# SPDX-License-Identifier: Apache-2.0
"""Four made cameras as a calibration file holds them, and two people who walk between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from studiorecon.calibration.formats.reading import Reading
from studiorecon.camera_files.raw_camera import RawCamera
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

from tests.made.cameras import detect, look_at, walk

FRAMES = 24
PEOPLE = [walk([-0.6, -0.5, 0], [0.03, 0, 0], FRAMES), walk([0.7, 0.6, 0], [0, -0.03, 0], FRAMES, 2.0)]
PLACES = ((4.0, 0.0, 1.5), (0.5, 4.2, 2.0), (-3.5, -1.0, 1.2), (0.0, -4.0, 1.8))


def rig(names: tuple[str, ...], wh: tuple[int, int] = (1280, 704)) -> list[Camera]:
    return [look_at(n, np.array(p), [0, 0, 1], wh) for n, p in zip(names, PLACES)]


def reading(cameras: list[Camera], named: bool = True) -> Reading:
    raw = [RawCamera(c.name, c.wh, c.intrinsics, "opencv", np.zeros(8), c.camera_from_world) for c in cameras]
    return Reading("test", tuple(raw), "m", (), named)


def people(cameras: list[Camera], names: list[str]) -> list[Detections]:
    found = detect(cameras, PEOPLE, 2.0, np.random.default_rng(0))
    return [replace(d, camera=n) for d, n in zip(found, names)]
