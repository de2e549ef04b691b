# SPDX-License-Identifier: Apache-2.0
"""Surfaces in mid-air that another camera looks through are taken back; confirmed furniture stays."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.depth.stereo.free_space import is_looked_through, snap_to_room_box
from studiorecon.depth.stereo.passes import PlaneLabelling
from studiorecon.geometry.camera_path import look_at
from studiorecon.scene.camera import Camera
from studiorecon.scene.room import RoomBox

ROOM_BOX = RoomBox(0.0, np.array([-4.0, -4, 0]), np.array([4.0, 4, 3]), np.ones(6, bool), np.ones(6))


def camera(name: str, centre_m: list[float]) -> Camera:
    intrinsics = np.array([[60.0, 0, 40], [0, 60, 30], [0, 0, 1]])
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = look_at(np.array(centre_m), np.array([0, 0, 1.0])).T
    camera_from_world[:3, 3] = -camera_from_world[:3, :3] @ np.array(centre_m)
    return Camera(name, (80, 60), intrinsics, camera_from_world)


def walls(cam: Camera) -> np.ndarray:
    return ROOM_BOX.intersect(*cam.rays())[0]


@pytest.fixture
def rig() -> tuple[Camera, Camera]:
    return camera("a", [3.0, 0, 1.5]), camera("b", [0, 3.0, 1.5])


def test_a_patch_in_mid_air_is_looked_through(rig: tuple[Camera, Camera]) -> None:
    a, b = rig
    depth_m = walls(a)
    depth_m[25:35, 35:45] = 2.5
    found = is_looked_through(a, depth_m, [(b, walls(b))])
    assert found[27:33, 37:43].all()
    found[25:35, 35:45] = False
    assert not found.any()


def test_a_confirmed_surface_stays(rig: tuple[Camera, Camera]) -> None:
    a, b = rig
    depth_m = walls(a)
    depth_m[25:35, 35:45] = 2.5
    witness = (camera("c", [3.0, 0, 1.5]), depth_m)
    assert is_looked_through(a, depth_m, [(b, walls(b))]).any()
    assert not is_looked_through(a, depth_m, [(b, walls(b)), witness]).any()


def test_unknown_depth_has_no_vote(rig: tuple[Camera, Camera]) -> None:
    a, b = rig
    assert not is_looked_through(a, np.full((60, 80), 2.5), [(b, np.zeros((60, 80)))]).any()


def test_floating_pixels_go_to_the_room_box_unjudged(rig: tuple[Camera, Camera]) -> None:
    a, b = rig
    depth_m = walls(a)
    plane = ROOM_BOX.intersect(*a.rays())[1]
    depth_m[25:35, 35:45], plane[25:35, 35:45] = 2.5, 7
    labelled = PlaneLabelling(
        plane, depth_m.astype(np.float32), np.zeros((60, 80), np.float32), np.ones((60, 80), bool)
    )
    back, share = snap_to_room_box(labelled, a, ROOM_BOX, [(b, walls(b))])
    assert share > 0.01
    changed = back.plane != plane
    np.testing.assert_allclose(back.depth_m[changed], walls(a)[changed], rtol=1e-6)
    assert not back.judged[changed].any()
    assert (back.plane[changed] < 6).all()


def test_a_plane_inside_the_room_stays_only_where_somebody_s_match_speaks_for_it(rig: tuple[Camera, Camera]) -> None:
    """Nobody looks through it: the other camera does not see there, or agrees badly."""
    a, _ = rig
    depth_m, plane = walls(a), ROOM_BOX.intersect(*a.rays())[1]
    depth_m[25:35, 35:45], plane[25:35, 35:45] = 2.5, 7
    cost, judged = np.full((60, 80), 0.2, np.float32), np.ones((60, 80), bool)
    cost[25:35, 35:40] = 0.8
    judged[30:35, 40:45] = False
    back, share = snap_to_room_box(PlaneLabelling(plane, depth_m.astype(np.float32), cost, judged), a, ROOM_BOX, [])
    assert (back.plane[25:30, 40:45] == 7).all(), "matched"
    assert (back.plane[25:35, 35:40] < 6).all(), "matched badly"
    assert (back.plane[30:35, 40:45] < 6).all(), "judged by nobody"
    assert share == pytest.approx(75 / (60 * 80))
