# SPDX-License-Identifier: Apache-2.0
"""Compiles the kernels of the room's fit while cameras and people are still being estimated.

That takes a quarter of a minute of one core on a new machine, and a second where they are compiled already.
"""

from __future__ import annotations

import numpy as np

from studiorecon.depth.layout.primitive_fitting import is_allowed
from studiorecon.depth.layout.primitives import Primitive, depth_with_primitives
from studiorecon.depth.layout.visibility import append_distance
from studiorecon.depth.stereo.photo_cost import PhotoCostVolume
from studiorecon.depth.stereo.plates import Picture
from studiorecon.depth.sweep_settings import Comparison
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.room import RoomBox
from studiorecon.signature import Written

_HALF_ROOM_M, _HEIGHT_M = 2.0, 3.0
_WH, _FOCAL_PX = (24, 16), 20.0


def run(kernels: Written) -> None:
    """Fit two noise pictures of a bare box as a room is fitted, and discard the result; write ``kernels`` when done."""
    settings = Comparison()
    pictures = _pictures()
    low_m = np.array([-_HALF_ROOM_M, -_HALF_ROOM_M, 0.0])
    bare = RoomBox(0.0, low_m, np.array([_HALF_ROOM_M, _HALF_ROOM_M, _HEIGHT_M]), np.ones(6, bool), np.full(6, np.nan))
    primitive = np.array([0, 0, 0, 0.5, 0.5, 0, 1.0])
    room = PhotoCostVolume(pictures, bare, settings.refine_window, settings.mean_weight)
    is_allowed(primitive[None], bare, append_distance(room.centre, 0.0))
    room.gains(primitive[None])
    room.add(primitive)
    for picture in pictures:
        depth_with_primitives(
            [Primitive.from_numbers(primitive, 1.0)], picture.camera, bare.intersect(*picture.camera.rays())[0]
        )
    say("the depth kernels are compiled")
    kernels.write_text("compiled\n", encoding="utf-8")


def _pictures() -> list[Picture]:
    """Two cameras that face each other across the box."""
    rng = np.random.default_rng(0)
    intrinsics = np.array([[_FOCAL_PX, 0, _WH[0] / 2], [0, _FOCAL_PX, _WH[1] / 2], [0, 0, 1]])
    pictures = []
    for name, side in (("first", -1.0), ("second", 1.0)):
        rotation = np.array([[0, side, 0], [0, 0, -1], [-side, 0, 0]])
        camera_from_world = np.eye(4)
        camera_from_world[:3, :3] = rotation
        camera_from_world[:3, 3] = -rotation @ [side * 0.9 * _HALF_ROOM_M, 0, _HEIGHT_M / 2]
        rgb = rng.random((_WH[1], _WH[0], 3)).astype(np.float32)
        pictures.append(Picture(Camera(name, _WH, intrinsics, camera_from_world), rgb, np.ones((_WH[1], _WH[0]), bool)))
    return pictures
