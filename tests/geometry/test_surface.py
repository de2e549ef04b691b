# SPDX-License-Identifier: Apache-2.0
"""Depth to points and normals, and the room as a box: exact on planes, honest at breaks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.geometry.camera_path import look_at, with_pose
from studiorecon.geometry.depth_surface import depth_breaks, points_and_normals
from studiorecon.scene.camera import Camera
from studiorecon.scene.room import FACES, RoomBox, read_room, write_room

LENS = Camera("a", (96, 64), np.array([[70.0, 0, 47], [0, 72.0, 33], [0, 0, 1]]), np.eye(4))


def camera_at(eye: list[float], target: list[float]) -> Camera:
    return with_pose(LENS, look_at(np.array(eye), np.array(target)), np.array(eye))


def made_room_box(yaw_rad: float = 0.3) -> RoomBox:
    return RoomBox(
        yaw_rad, np.array([-3.0, -4, 0]), np.array([3.5, 2, 2.7]), np.array([1, 1, 0, 1, 1, 0], bool), np.full(6, 0.9)
    )


def test_normals_and_points_are_exact_on_slanted_planes() -> None:
    camera, room_box = camera_at([0.5, -1.0, 1.6], [2.5, 0.5, 0.9]), made_room_box()
    depth, face = room_box.intersect(*camera.rays())
    points, normals, valid = points_and_normals(depth, camera, jump=0.04)
    faces = room_box.faces[face]
    assert np.abs((points * faces[..., :3]).sum(-1) - faces[..., 3]).max() < 1e-9
    # Normals mix at the creases between walls, where neighbours lie on two planes.
    crease = np.zeros(face.shape, bool)
    crease[1:] |= face[1:] != face[:-1]
    crease[:-1] |= face[1:] != face[:-1]
    crease[:, 1:] |= face[:, 1:] != face[:, :-1]
    crease[:, :-1] |= face[:, 1:] != face[:, :-1]
    inside = valid & ~crease
    assert inside.mean() > 0.8
    assert np.abs(np.abs((normals * faces[..., :3]).sum(-1)[inside]) - 1).max() < 1e-9
    assert ((camera.centre_m - points) * normals).sum(-1)[inside].min() > 0


def test_breaks_mark_jumps_and_unknown_depth_but_no_slope() -> None:
    camera = camera_at([0, 0, 1.6], [1.5, 0, 0.0])
    depth, face = replace(made_room_box(), high_m=np.array([50.0, 50, 9])).intersect(*camera.rays())
    assert (face == FACES.index("floor")).all()
    assert depth.max() > 1.5 * depth.min()
    # On the floor of a level camera depth changes along columns alone.
    for turned in (depth, depth.T):
        assert not depth_breaks(turned, 0.001).any()
    depth[20:30, 40:50] *= 0.8
    broken = depth_breaks(depth, 0.04)
    assert broken[20:30, 39:41].all()
    assert broken[20:30, 49:51].all()
    assert not broken[24:26, 44:46].any()
    depth[:, 70] = 0
    assert depth_breaks(depth, 0.04)[:, 69:72].all()


def test_every_ray_from_inside_meets_a_wall_and_the_point_lies_on_it() -> None:
    room_box = made_room_box(1.2)
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(500, 3))
    directions[:3] = np.eye(3)  # parallel to faces of an unturned box
    length, face = room_box.intersect(np.array([0.2, -0.3, 1.1]), directions)
    assert (length > 0).all()
    points = np.array([0.2, -0.3, 1.1]) + length[:, None] * directions
    planes = room_box.faces[face]
    assert np.abs((points * planes[:, :3]).sum(-1) - planes[:, 3]).max() < 1e-9
    assert room_box.contains(points, 1e-9).all()
    assert set(face.tolist()) == set(range(6))


def test_rays_that_leave_the_box_behind_meet_nothing() -> None:
    room_box = replace(made_room_box(), yaw_rad=0.0)
    outside = np.array([[10.0, 0, 1], [10.0, 0, 1], [0, 0, 9.0]])
    length, face = room_box.intersect(outside, np.array([[1.0, 0, 0], [-1.0, 0, 0], [1.0, 0, 0]]))
    assert length.tolist() == [0, 13, 0]
    assert face.tolist() == [-1, FACES.index("u_low"), -1]


def test_room_box_survives_its_file(tmp_path: Path) -> None:
    room_box = replace(
        made_room_box(),
        gains={"cam 1": np.array([1.0, 0.9, 1.1])},
        score=np.where(made_room_box().fitted, 0.5, np.nan),
    )
    write_room(tmp_path / "room.json", room_box)
    again = read_room(tmp_path / "room.json")
    for name in ("yaw_rad", "low_m", "high_m", "fitted", "score"):
        assert np.array_equal(getattr(again, name), getattr(room_box, name), equal_nan=True), name
    assert np.array_equal(again.gains["cam 1"], room_box.gains["cam 1"])
    with pytest.raises(UserError, match="nowhere"):
        read_room(tmp_path / "nowhere.json")
