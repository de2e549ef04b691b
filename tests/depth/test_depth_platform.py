# SPDX-License-Identifier: Apache-2.0
"""People on something that stands on the floor: the floor is found below them, and a floor that is polished or full of
things is not taken for a platform."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.configuration.settings import load
from studiorecon.depth import box, sweep
from studiorecon.depth.layout.platform import fit_platform
from studiorecon.depth.layout.primitive_fitting import fit_primitives
from studiorecon.depth.stereo.plates import Picture
from studiorecon.depth.sweep_settings import Matching
from studiorecon.geometry import rotations
from studiorecon.geometry.camera_path import with_pose
from studiorecon.scene.room import Platform, RoomBox, read_room

from tests.made.room import Room, made_room, photograph, ring, write_capture

HOW = Matching(window=7, mean_weight=0.3, near_m=0.3, far_m=12.0)
WH = (240, 136)
FLOOR_M = -0.35
# Fewer planes than by default: the room is small.
THIN = {"sweep_width": 144, "wall_step_m": 0.08, "reach_m": 6.0, "furniture_m": 1.0}


def raised() -> Room:
    """A room whose floor is 0.35 m below the top of what stands in its middle, 1.8 × 1.4 m."""
    room = made_room(table=False)
    return replace(
        room,
        room_box=replace(room.room_box, low_m=np.array([*room.room_box.low_m[:2], FLOOR_M])),
        table=replace(room.room_box, low_m=np.array([-0.9, -0.7, FLOOR_M]), high_m=np.array([0.9, 0.7, 0.0])),
    )


def seen(room: Room) -> list[Picture]:
    cameras = ring(wh=WH, target_m=0.2)
    return [Picture(c, photograph(room, c, samples=1)[0], np.ones(c.hw, bool)) for c in cameras]


@pytest.fixture(scope="module")
def on_a_platform() -> list[Picture]:
    return seen(raised())


def test_floor_is_found_below_what_people_stand_on(on_a_platform: list[Picture]) -> None:
    found = fit_platform(on_a_platform, raised().room_box.axes, 0.0, HOW)
    assert found is not None
    assert abs(found.floor_m - FLOOR_M) < 0.06
    assert found.score > 0.8
    assert np.abs(found.platform.low_m - (-0.9, -0.7)).max() < 0.16
    assert np.abs(found.platform.high_m - (0.9, 0.7)).max() < 0.16
    assert found.platform.top_m == 0.0


def test_mats_lie_on_the_floor(on_a_platform: list[Picture]) -> None:
    # A mat over half the room, 0.17 m above the floor: the lower height is the floor's.
    room = raised()
    mat = RoomBox(
        room.room_box.yaw_rad,
        np.array([-2.9, 0.9, FLOOR_M]),
        np.array([3.3, 3.1, FLOOR_M + 0.17]),
        room.room_box.fitted,
        room.room_box.score,
    )
    matted = seen(replace(room, table=mat))
    pictures = []
    for with_mat, without in zip(matted, on_a_platform):
        # Both boxes in one picture: the nearer surface of the two rooms.
        near = photograph(replace(room, table=mat), with_mat.camera, samples=1)[1]
        nearer = near < photograph(room, without.camera, samples=1)[1]
        pictures.append(replace(without, rgb=np.where(nearer[..., None], with_mat.rgb, without.rgb)))
    found = fit_platform(pictures, room.room_box.axes, 0.0, HOW)
    assert found is not None
    assert abs(found.floor_m - FLOOR_M) < 0.06


@pytest.mark.parametrize("table", [False, True], ids=["bare", "furnished"])
def test_floor_that_people_stand_on_is_no_platform(table: bool) -> None:
    room = made_room(table=table)
    assert fit_platform(seen(room), room.room_box.axes, 0.0, HOW) is None


@pytest.mark.parametrize("seed", [0, 3])
def test_cameras_that_are_off_see_no_platform(seed: int) -> None:
    # Two thirds of a degree and a centimetre and a half each: photos agree on the floor in places only.
    room, rng = made_room(), np.random.default_rng(seed)
    pictures = []
    for picture in seen(room):
        turn = rotations.exp(np.radians(rng.normal(0, 0.7 / np.sqrt(3), 3)))
        centre_m = picture.camera.centre_m + rng.normal(0, 0.015, 3)
        moved = with_pose(picture.camera, picture.camera.rotation_camera_from_world.T @ turn, centre_m)
        pictures.append(replace(picture, camera=moved))
    assert fit_platform(pictures, room.room_box.axes, 0.0, HOW) is None


def test_mirrored_things_do_not_lie_below_a_polished_floor() -> None:
    room = made_room()
    assert room.table is not None
    upside_down = replace(
        room,
        room_box=replace(room.room_box, low_m=room.room_box.low_m * (1, 1, 0) - (0, 0, 3.0)),
        table=replace(room.table, low_m=room.table.low_m - (0, 0, 0.8), high_m=room.table.high_m - (0, 0, 0.8)),
    )
    pictures = []
    for picture in seen(room):
        mirrored = photograph(upside_down, picture.camera, samples=1)[0]
        origin, rays = picture.camera.rays()
        _, face = room.room_box.intersect(origin, rays)
        depth_m = photograph(room, picture.camera, samples=1)[1]
        floor = (face == 4) & (np.abs(origin[2] + rays[..., 2] * depth_m) < 1e-6)
        rgb = np.where(floor[..., None], 0.4 * picture.rgb + 0.6 * mirrored, picture.rgb)
        pictures.append(replace(picture, rgb=rgb.astype(np.float32)))
    assert fit_platform(pictures, room.room_box.axes, 0.0, HOW) is None


def test_one_camera_tells_nothing() -> None:
    assert fit_platform(seen(raised())[:1], raised().room_box.axes, 0.0, HOW) is None


@pytest.mark.parametrize("high_m", [0.9, 0.1], ids=["whole", "half of it"])
def test_platform_is_the_first_of_the_furniture_and_whole(on_a_platform: list[Picture], high_m: float) -> None:
    platform = Platform(np.array([-0.9, -0.7]), np.array([high_m, 0.7]), 0.0)
    room_box = replace(raised().room_box, fitted=np.ones(6, bool), platform=platform)
    small = [_at_width(picture, 96) for picture in on_a_platform]
    feet = np.array([[0.0, 0.0, 0.0, 0.05], [0.2, 0.2, 0.0, 0.05]])
    found = fit_primitives(small, room_box, feet, window=5, mean_weight=0.3, least_gain=20.0, most=1)
    assert (found[0].low_m, found[0].high_m) == (FLOOR_M, 0.0)
    assert np.abs(np.array(found[0].size_m) - (1.8, 1.4)).max() < 0.15
    assert np.abs(found[0].centre_m).max() < 0.08
    assert found[0].evidence > 20.0


def _at_width(picture: Picture, width: int) -> Picture:
    camera = picture.camera.resized((width, round(width * WH[1] / WH[0])))
    return Picture(camera, photograph(raised(), camera)[0], np.ones(camera.hw, bool))


def test_room_stands_on_the_lower_floor(
    on_a_platform: list[Picture], tmp_path: Path, default_settings: Callable[..., dict]
) -> None:
    section, cameras = default_settings("depth", **THIN), [picture.camera for picture in on_a_platform]
    plates = write_capture(tmp_path, cameras, [picture.rgb for picture in on_a_platform])
    model, sweeps = tmp_path / "cameras/images.txt", [tmp_path / f"{c.name}.npz" for c in cameras]
    for camera, path in zip(cameras, sweeps):
        sweep.run(load(sweep.Settings, section, "depth"), camera.name, model, plates, path)
    box.run(load(box.Settings, section, "depth"), model, plates, sweeps, tmp_path / "box.json")
    found = read_room(tmp_path / "box.json")
    assert abs(found.low_m[2] - FLOOR_M) < 0.03
    assert abs(found.standing_m) < 0.02
    assert found.fitted[4]
    assert found.score[4] > 0.8
