# SPDX-License-Identifier: Apache-2.0
"""Walls that no photo matches: a posterior of upright edges, visible floor and usual rooms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from studiorecon.depth.layout.ground_contacts import GroundContacts, find_ground_contacts
from studiorecon.depth.layout.unseen_walls import FloorEnds, find_floor_ends, place_unseen_walls
from studiorecon.depth.layout.votes import Votes
from studiorecon.depth.stereo.plates import Picture
from studiorecon.geometry.camera_path import scene_centre
from studiorecon.plan.rule_files import Files
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


NO_FLOOR = FloorEnds(np.empty((0, 2)), np.empty((0, 2)))
FAR_M, NOBODY = 14.0, np.zeros((0, 2))
CAMERAS = [camera(-3.0, -1.0), camera(2.8, -1.5)]
WALL = [(float(u), 4.0, 2.0) for u in np.linspace(-2.5, 2.5, 7)]


def open_place(cameras: Sequence[Camera]) -> RoomBox:
    centres = np.stack([c.centre_m for c in cameras]) @ axes().T
    low_m, high_m = centres.min(0) - FAR_M, centres.max(0) + FAR_M
    low_m[2], high_m[2] = 0.0, 3.2
    return RoomBox(YAW_RAD, low_m, high_m, np.zeros(6, bool), np.full(6, np.nan))


def placed(
    cameras: Sequence[Camera],
    pictures: Sequence[np.ndarray],
    floor: FloorEnds = NO_FLOOR,
    box: RoomBox | None = None,
    people_m: np.ndarray = NOBODY,
) -> tuple[RoomBox, np.ndarray]:
    feet = find_ground_contacts(cameras, [RoomPicture(p, np.ones(p.shape, bool)) for p in pictures], 0.0)
    return place_unseen_walls(box or open_place(cameras), feet, floor, cameras, people_m, FAR_M)


def blank(cameras: Sequence[Camera]) -> list[np.ndarray]:
    return [np.full(c.hw, 120, np.uint8) for c in cameras]


def test_a_wall_that_one_camera_sees_is_at_the_feet_of_its_uprights() -> None:
    one = [camera(0.0, -3.0), camera(-3.0, 0.5, (0.0, -1.0))]
    box, interval_m = placed(one, [drawn(one[0], WALL, 0), blank(one)[1]])
    assert box.high_m[1] == pytest.approx(4.0, abs=0.6)
    assert interval_m[3, 0] < 4.0 < interval_m[3, 1]
    assert np.ptp(interval_m[3]) < np.ptp(placed(one, blank(one))[1][3]) / 1.5
    assert not box.fitted.any(), "nothing was matched there"
    np.testing.assert_array_equal(box.high_m[2], 3.2)


def test_without_any_evidence_a_room_is_usual_and_its_interval_wide() -> None:
    box, interval_m = placed(CAMERAS, blank(CAMERAS))
    assert box.low_m[0] == pytest.approx(-3.0 - 1.5, abs=0.5)
    assert (np.ptp(interval_m, axis=1) > 2.5).all()


def test_pictures_that_hang_in_a_line_are_no_wall_where_their_lower_ends_would_meet_the_floor() -> None:
    one = [camera(0.0, -3.0)]
    hung = drawn(one[0], WALL, 0)
    horizon = drawn(one[0], [(u, v, 0.9) for u, v, _ in WALL], 0, 0.5)
    hung[horizon != 120] = 120
    _, interval_m = placed(one, [hung])
    assert interval_m[3, 0] < 4.0 < interval_m[3, 1]


def test_no_wall_is_nearer_than_the_floor_that_was_matched() -> None:
    angle_rad = np.radians(np.arange(-40, 41))
    towards = np.stack([np.sin(angle_rad), np.cos(angle_rad)], 1) @ axes()[:2, :2]
    seen = FloorEnds(7.0 * towards + CAMERAS[0].centre_m[:2], towards)
    box, _ = placed(CAMERAS, blank(CAMERAS), seen)
    assert box.high_m[1] > 5.5
    assert placed(CAMERAS, blank(CAMERAS))[0].high_m[1] < 4.0


def test_where_the_floor_ends_is_read_from_its_confident_pixels() -> None:
    one = CAMERAS[0].resized((240, 135))
    planes = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 1.0, 2.0]])
    points = one.unproject(one.pixel_centres(), np.ones(one.hw)) - one.centre_m
    down = np.divide(one.centre_m[2], -points[..., 2], where=points[..., 2] < -0.01, out=np.full(one.hw, np.inf))
    away_m = np.linalg.norm(points[..., :2], axis=-1) * down
    votes = Votes(planes, [np.zeros(one.hw, int)], [away_m < 5.0])
    picture = Picture(one, np.zeros((*one.hw, 3), np.float32), np.ones(one.hw, bool))
    ends = find_floor_ends([picture], votes, 0.0)
    distance_m = np.linalg.norm(ends.place_m - one.centre_m[:2], axis=1)
    assert len(distance_m) > 40
    assert np.median(distance_m) == pytest.approx(4.6, abs=0.25)
    np.testing.assert_allclose(ends.place_m - one.centre_m[:2], distance_m[:, None] * ends.towards, atol=1e-9)


def test_known_walls_stay_and_make_the_others_alike() -> None:
    sides = []
    for margin_m in (0.8, 3.0):
        box = replace(open_place(CAMERAS), fitted=np.arange(6) < 2)
        box.low_m[0], box.high_m[0] = -3.0 - margin_m, 2.8 + margin_m
        found, interval_m = placed(CAMERAS, blank(CAMERAS), box=box)
        assert (found.low_m[0], found.high_m[0]) == (box.low_m[0], box.high_m[0])
        assert (interval_m[:2, 0] == interval_m[:2, 1]).all()
        sides.append(-1.5 - found.low_m[1])
    assert sides[0] < 1.5 < sides[1]


def test_intervals_cover_the_walls_of_rooms_with_furniture_and_pictures() -> None:
    """Rooms as the model has them: 80 % intervals of the wall that 12 upright edges face."""
    rng, covered = np.random.default_rng(4), []
    towards = np.tile(axes()[1, :2], (12, 1))
    for _ in range(150):
        margin_m = np.exp(rng.normal(np.log(1.5), np.hypot(0.7, 0.6)))
        eye_m, wall_m = CAMERAS[0].centre_m[:2] @ axes()[1, :2], -1.0 + margin_m
        wall_m += max(0.0, placed_from(CAMERAS) + 1.0)
        kind, distance_m = rng.choice(3, 12, p=[0.08, 0.27, 0.65]), wall_m - eye_m
        foot_m = np.choose(kind, [np.full(12, distance_m), distance_m * rng.random(12), distance_m / rng.random(12)])
        foot_m = foot_m + eye_m + rng.normal(0, 0.16, 12)
        feet = GroundContacts(foot_m[:, None] * towards, towards, np.full(12, 0.01), np.zeros(12, int))
        _, interval_m = place_unseen_walls(open_place(CAMERAS), feet, NO_FLOOR, CAMERAS, NOBODY, FAR_M)
        covered.append(interval_m[3, 0] <= wall_m <= interval_m[3, 1])
    assert 0.7 <= np.mean(covered) <= 0.92


def placed_from(cameras: Sequence[Camera]) -> float:
    """Offset along v from which a margin counts: no camera is on that side, so people's space decides."""
    centres_m, middle_m = np.stack([c.centre_m[:2] for c in cameras]), scene_centre(cameras)[:2]
    return float(middle_m @ axes()[1, :2] + 0.5 * np.linalg.norm(centres_m - middle_m, axis=1).mean())


def test_a_side_whose_floor_goes_on_has_no_wall() -> None:
    angle_rad = np.radians(np.arange(-40, 41))
    towards = np.stack([np.sin(angle_rad), np.cos(angle_rad)], 1) @ axes()[:2, :2]
    seen = FloorEnds(12.0 * towards + CAMERAS[0].centre_m[:2], towards)
    box, interval_m = placed(CAMERAS, blank(CAMERAS), seen)
    assert box.high_m[1] == pytest.approx(placed_from(CAMERAS) + FAR_M, abs=0.3)
    assert interval_m[3, 1] == pytest.approx(box.high_m[1], abs=0.1)
    assert interval_m[0, 1] - interval_m[0, 0] > 2.0, "of the others nothing is known"


def test_people_are_inside_the_walls_that_nothing_measured() -> None:
    box, _ = placed(CAMERAS, blank(CAMERAS))
    person = np.array([[0.0, 9.0, 1.0], [0.0, 0.0, 1.0]]) @ axes()
    wider, interval_m = placed(CAMERAS, blank(CAMERAS), people_m=person[:, :2])
    assert wider.contains(person).all()
    assert not box.contains(person).all()
    assert interval_m[3, 0] > 9.0
    measured = replace(box, fitted=np.ones(6, bool))
    np.testing.assert_array_equal(
        placed(CAMERAS, blank(CAMERAS), box=measured, people_m=person[:, :2])[0].high_m, box.high_m
    )


@pytest.mark.parametrize(("source", "primitives", "taken"), [("embedded", 0, 1), ("moge", 3, 1), ("moge", 0, 0)])
def test_people_take_part_in_the_room_unless_a_network_decides_alone(source: str, primitives: int, taken: int) -> None:
    files = Mock(config={"depth": {"source": source, "primitives": primitives}}, fits=lambda _: ["p0.npz"])
    assert len(Files.people_in_room(files, None)) == taken
