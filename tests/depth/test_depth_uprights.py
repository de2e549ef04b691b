# SPDX-License-Identifier: Apache-2.0
"""Walls that nothing matches stand where upright edges end on the floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from studiorecon.depth.layout import ground_contacts
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera
from studiorecon.scene.room import RoomBox

from tests.made.cameras import look_at

WH = (960, 540)
YAW_RAD = 0.3
Post = tuple[float, float, float]
"""Where it stands along u and v, and how far up it goes, metres."""


def axes() -> np.ndarray:
    return RoomBox(YAW_RAD, np.zeros(3), np.zeros(3), np.zeros(6, bool), np.full(6, np.nan)).axes


def camera(u: float, v: float, towards: tuple[float, float] = (0.0, 0.0), height_m: float = 1.7) -> Camera:
    """A camera in the room's own directions, a little tilted down."""
    centre, target = np.array([u, v, height_m]) @ axes(), np.array([*towards, 0.9]) @ axes()
    return look_at(f"c{u:g}{v:g}", centre, target, WH, 620.0)


def drawn(view: Camera, posts: Sequence[Post], along: int, width_m: float = 0.35) -> np.ndarray:
    """(H, W) uint8 of upright boards ``width_m`` wide along direction ``along`` of the room, before even grey."""
    picture = np.full(view.hw, 120, np.uint8)
    for k, (u, v, high_m) in enumerate(sorted(posts, key=lambda post: -np.hypot(post[0], post[1]))):
        half = np.eye(2)[along] * width_m / 2
        low, high = np.array([u, v]) - half, np.array([u, v]) + half
        corners = np.array([[*low, 0], [*high, 0], [*high, high_m], [*low, high_m]]) @ axes()
        pixels, depth_m = view.project(corners)
        if (depth_m > 0.2).all():
            cv2.fillConvexPoly(picture, np.rint(pixels * 16).astype(np.int32), 60 if k % 2 else 190, cv2.LINE_AA, 4)
    return picture


def open_place(cameras: Sequence[Camera]) -> RoomBox:
    centres = np.stack([c.centre_m for c in cameras]) @ axes().T
    low_m, high_m = centres.min(0) - 14.0, centres.max(0) + 14.0
    low_m[2], high_m[2] = 0.0, 3.2
    return RoomBox(YAW_RAD, low_m, high_m, np.zeros(6, bool), np.full(6, np.nan))


def placed(cameras: Sequence[Camera], pictures: Sequence[np.ndarray], box: RoomBox) -> tuple[RoomBox, dict[int, int]]:
    rooms = [RoomPicture(p, np.ones(p.shape, bool)) for p in pictures]
    return ground_contacts.place_default_walls(box, ground_contacts.find_ground_contacts(cameras, rooms, 0.0), cameras)


CAMERAS = [camera(-3.0, -1.0), camera(2.8, -1.5)]
WALL = [(float(u), 4.0, 2.0) for u in np.linspace(-2.5, 2.5, 7)]


def test_a_wall_that_one_camera_sees_stands_behind_the_feet_of_its_uprights() -> None:
    one = [camera(0.0, -3.0), camera(-3.0, 0.5, (0.0, -1.0))]
    box, reported = placed(one, [drawn(one[0], WALL, 0), np.full(WH[::-1], 120, np.uint8)], open_place(one))
    assert reported.keys() == {3}, "v_high alone"
    assert reported[3] >= 8
    assert box.high_m[1] == pytest.approx(4.0 + 0.5, abs=0.15)
    assert not box.fitted.any(), "nothing was matched there"
    before = open_place(one)
    np.testing.assert_array_equal(box.low_m, before.low_m)
    np.testing.assert_array_equal(box.high_m[[0, 2]], before.high_m[[0, 2]])


def test_without_uprights_a_place_stays_open() -> None:
    flat = [np.full(c.hw, 120, np.uint8) for c in CAMERAS]
    assert placed(CAMERAS, flat, open_place(CAMERAS))[1] == {}
    lying = [np.tile(np.repeat(np.uint8([60, 190]), 30).repeat(9)[: WH[1], None], (1, WH[0])) for _ in CAMERAS]
    assert placed(CAMERAS, lying, open_place(CAMERAS))[1] == {}


def test_what_stands_in_the_middle_is_no_wall() -> None:
    posts = [(float(u), 0.9, 1.2) for u in np.linspace(-1.2, 1.2, 7)]
    assert placed(CAMERAS, [drawn(c, posts, 0) for c in CAMERAS], open_place(CAMERAS))[1] == {}


def test_few_uprights_are_no_wall() -> None:
    posts = [(-1.0, 4.0, 2.0), (1.0, 4.0, 2.0)]
    one = [camera(0.0, -3.0)]
    assert placed(one, [drawn(one[0], posts, 0)], open_place(one))[1] == {}


def test_uprights_at_any_distance_are_no_wall() -> None:
    """Trees."""
    rng = np.random.default_rng(5)
    posts = [(float(u), float(v), 2.5) for u, v in zip(rng.uniform(-4, 4, 12), rng.uniform(2.5, 16.0, 12))]
    one = [camera(0.0, -3.0)]
    assert placed(one, [drawn(one[0], posts, 0, 0.2)], open_place(one))[1] == {}


def test_a_wall_that_was_matched_stays() -> None:
    one = [camera(0.0, -3.0)]
    box = open_place(one)
    box = replace(box, fitted=np.arange(6) == 3)
    assert placed(one, [drawn(one[0], WALL, 0)], box)[1] == {}


def test_what_stands_along_a_wall_says_nothing_of_the_wall_beside_it() -> None:
    """Uprights in a corner face two walls: with one more post before them they would make a line of either."""
    cornered = [*WALL[:5], (2.3, 4.0, 2.0), (2.5, 4.0, 2.0), (2.7, 4.0, 2.0), (2.5, 3.0, 2.0)]
    one = [camera(-2.0, -2.5, (1.5, 2.5))]
    reported = placed(one, [drawn(one[0], cornered, 0, 0.1)], open_place(one))[1]
    assert reported.keys() == {3}


def test_a_wall_that_is_too_far_to_be_measured_stays_a_default() -> None:
    one = [camera(0.0, -3.0, height_m=1.1)]
    far = [(1.5 * u, 9.5, 2.5) for u, _, _ in WALL]
    assert placed(one, [drawn(one[0], far, 0, 0.5)], open_place(one))[1] == {}


def test_a_camera_that_stands_beside_cupboards_is_inside_the_room() -> None:
    pair = [camera(0.0, -3.0), camera(-2.9, 4.1, (0.0, 0.0))]
    box, reported = placed(pair, [drawn(pair[0], WALL, 0), np.full(WH[::-1], 120, np.uint8)], open_place(pair))
    assert 3 in reported
    assert box.high_m[1] >= 4.1 + 0.3


def test_where_two_walls_are_known_the_others_are_not_far_off() -> None:
    one = [camera(0.0, -3.0)]
    blank = np.full(WH[::-1], 120, np.uint8)
    box = replace(open_place(one), fitted=np.arange(6) == 0)
    box.low_m[0] = -3.5
    found, reported = placed(one, [drawn(one[0], WALL, 0)], box)
    assert reported.keys() == {1, 2, 3}
    assert (reported[1], reported[2]) == (0, 0)
    behind_m = found.high_m[1] + 3.0
    assert found.high_m[0] == pytest.approx(behind_m)
    assert found.low_m[1] == pytest.approx(-3.0 - behind_m)
    assert found.low_m[0] == -3.5
    np.testing.assert_array_equal(placed(one, [blank], box)[0].high_m, box.high_m)


@pytest.mark.parametrize(("beside", "reported"), [(10, True), (60, False)])
def test_a_line_that_few_of_the_feet_stand_on_is_no_wall(beside: int, reported: bool) -> None:
    """Among things that stand about, some stand in a row by chance."""
    row = np.stack([np.full(8, 3.0), np.linspace(-1.0, 1.0, 8)], 1)
    rng = np.random.default_rng(0)
    about = np.stack([np.linspace(0.2, 2.5, beside), rng.uniform(-1.5, 1.5, beside)], 1)
    place_m = np.concatenate([row, about])
    count, towards = len(place_m), place_m / np.linalg.norm(place_m, axis=1)[:, None]
    seen = ground_contacts.GroundContacts(
        place_m, towards, np.full(count, 0.02), np.full(count, 3.0), np.zeros(count, int)
    )
    line = ground_contacts.wall_line(seen, np.array([1.0, 0.0]), 0.0, 5.0)
    assert (line is not None) == reported
    if line is not None:
        assert line[0] == pytest.approx(3.0, abs=0.05)
