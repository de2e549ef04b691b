# SPDX-License-Identifier: Apache-2.0
"""Upright boxes: where rays meet them, what they are worth as evidence, and that only what photos agree on is put
up."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.depth.layout.primitive_fitting import contains_any, fit_primitives, is_allowed
from studiorecon.depth.layout.primitives import Primitive, depth_with_primitives
from studiorecon.depth.layout.primitives_picture import overview_sheet
from studiorecon.depth.layout.proposals import leg_candidates
from studiorecon.depth.layout.visibility import append_distance, joint_places
from studiorecon.depth.stereo.kernels import draw_primitive
from studiorecon.depth.stereo.photo_cost import PhotoCostVolume
from studiorecon.depth.stereo.plates import Picture
from studiorecon.scene.room import RoomBox

from tests.made.fitted import fitted_person
from tests.made.room import Room, made_room, photograph, ring

BOX = Primitive((0.3, -0.2), 0.5, (0.8, 0.4), 0.1, 0.9, 0.0)
POST = Primitive((-0.4, 0.3), 0.0, (0.5, 0.5), 0.0, 1.2, 0.0)
NOBODY = np.zeros((0, 4))


def cupboard(room: Room) -> Primitive:
    """The primitive that stands in ``made_room``."""
    low, high = room.table.low_m, room.table.high_m
    x, y, _ = (low + high) / 2 @ room.table.axes
    return Primitive((x, y), room.table.yaw_rad, tuple((high - low)[:2]), low[2], high[2], 0.0)


def looks(room: Room, width: int = 96) -> list[Picture]:
    cameras = ring(wh=(width, round(width * 0.5625)))
    return [Picture(c, photograph(room, c)[0], np.ones(c.hw, bool)) for c in cameras]


def put_up(pictures: list[Picture], room_box: RoomBox, least_gain: float = 20.0, most: int = 3) -> list[Primitive]:
    gates = {"window": 5, "mean_weight": 1.5, "least_gain": least_gain, "most": most}
    return fit_primitives(pictures, room_box, NOBODY, **gates)


@pytest.fixture(scope="module")
def furnished() -> tuple[Room, list[Picture], list[Primitive]]:
    """The room with its cupboard, four looks at it, and what is found in them."""
    room = made_room()
    pictures = looks(room)
    return room, pictures, put_up(pictures, room.room_box)


@pytest.mark.parametrize("primitive", [BOX, POST], ids=["box", "post"])
def test_rays_enter_a_primitive_on_its_surface(primitive: Primitive) -> None:
    for camera in ring(3):
        depth_m = primitive.depth(camera)
        hit = depth_m > 0
        assert 0.02 < hit.mean() < 0.5
        points = camera.unproject(camera.pixel_centres(), depth_m)[hit]
        c, s = np.cos(primitive.yaw_rad), np.sin(primitive.yaw_rad)
        u, v = ((points[:, :2] - primitive.centre_m) @ np.array([[c, -s], [s, c]]) / (np.array(primitive.size_m) / 2)).T
        side = np.maximum(np.abs(u), np.abs(v))
        level = np.abs(
            (points[:, 2] - (primitive.low_m + primitive.high_m) / 2) / ((primitive.high_m - primitive.low_m) / 2)
        )
        np.testing.assert_allclose(np.maximum(side, level), 1.0, atol=1e-9)


def test_a_camera_inside_a_primitive_sees_the_room() -> None:
    camera = ring(1)[0]
    around = Primitive(tuple(camera.centre_m[:2]), 0.0, (1.0, 1.0), 0.0, 3.0, 0.0)
    assert not around.depth(camera).any()
    depth_m, shown = depth_with_primitives([around], camera, np.full(camera.hw, 2.0, np.float32))
    assert (depth_m == 2.0).all()
    assert not shown.any()


def test_a_primitive_stands_before_what_is_behind_it_and_before_the_unknown() -> None:
    camera = ring(1)[0]
    own = BOX.depth(camera)
    for behind, seen in ((50.0, own > 0), (0.0, own > 0), (0.5, np.zeros(camera.hw, bool))):
        depth_m, shown = depth_with_primitives([BOX], camera, np.full(camera.hw, behind, np.float32))
        assert (shown == seen).all()
        np.testing.assert_allclose(depth_m, np.where(seen, own, behind), rtol=1e-6)
        assert depth_m.dtype == np.float32


def test_the_true_primitive_is_worth_most_and_gains_no_more_than_adding_brings() -> None:
    room = made_room()
    seen = PhotoCostVolume(looks(room), room.room_box, 5, 1.5)
    true = cupboard(room).numbers
    beside, larger, thin_air = true.copy(), true.copy(), true.copy()
    beside[0] += 0.4
    larger[3:5] += 0.4
    thin_air[5:] += 1.2
    gains = seen.gains(np.stack([true, beside, larger, thin_air]))
    assert gains[0] > 100
    assert (gains[1:] < 0.6 * gains[0]).all()
    before = float(seen.cost.sum(dtype=np.float64))
    seen.add(true)
    # What it hides counts no more than what it shows; colour odds are no part of the cost.
    assert 0.5 < gains[0] / (before - float(seen.cost.sum(dtype=np.float64))) < 1.1
    assert seen.gains(true[None])[0] == pytest.approx(0.0, abs=1e-6)


def test_what_reaches_behind_a_camera_is_drawn_where_rays_meet_it() -> None:
    """Only what is before a camera bounds where a primitive is looked for in its picture; as each ray says for
    itself."""
    cameras = ring(wh=(96, 54))
    lens = np.array([[*c.focal_px, *c.principal_px] for c in cameras])
    pose, centre = np.stack([c.camera_from_world[:3] for c in cameras]), np.stack([c.centre_m for c in cameras])
    rng, cut, known = np.random.default_rng(0), 0, np.ones((4, 54, 96), bool)
    for k in range(200):
        camera = cameras[k % 4]
        beside = camera.centre_m[:2] + rng.normal(0, 0.7, 2)
        size, low = rng.uniform(0.1, 2.0, 2), rng.uniform(0, 1.5)
        numbers = np.array([*beside, rng.uniform(0, 3), *size, low, low + rng.uniform(0.1, 1.5)])
        expected = Primitive.from_numbers(numbers, 0.0).depth(camera)
        depth_m, surface = np.full(known.shape, 50, np.float32), np.zeros(known.shape, np.int32)
        draw_primitive(lens, pose, centre, known, depth_m, surface, numbers, 10)
        assert np.array_equal(surface[k % 4] >= 10, expected > 0.1)
        cut += bool(((expected > 0.1) & (expected < 0.4)).any())
    assert cut > 5, "some pass right before a camera"


def test_what_only_hides_a_floor_in_the_wrong_place_gains_nothing() -> None:
    """A floor that is taken to be 0.4 m too high matches nowhere, and any box in mid-air hides some of it."""
    room = made_room(table=False)
    too_high = replace(room.room_box, low_m=room.room_box.low_m + np.array([0, 0, 0.4]))
    seen = PhotoCostVolume(looks(room), too_high, 5, 1.5, looks=False)
    rng = np.random.default_rng(0)
    upright = np.array([[*rng.uniform(-1, 1, 2), 0, 1.2, 0.1, 0.5, 0.9] for _ in range(40)])
    assert np.mean(seen.gains(upright) < 20) > 0.9


def test_the_cupboard_is_found(furnished: tuple[Room, list[Picture], list[Primitive]]) -> None:
    room, pictures, found = furnished
    assert found
    truth = [photograph(room, p.camera)[1] for p in pictures]
    bare = [room.room_box.intersect(*p.camera.rays())[0] for p in pictures]
    error = {}
    for name, primitives in (("bare", []), ("found", found)):
        depths = [depth_with_primitives(primitives, p.camera, d)[0] for p, d in zip(pictures, bare)]
        error[name] = np.mean([np.mean(np.abs(d - t) / t) for d, t in zip(depths, truth)])
    assert error["found"] < 0.4 * error["bare"]


def test_a_table_gets_its_legs() -> None:
    """Four legs of 8 cm under a top: each is too thin to be found by what stands on the floor."""
    room, legs = made_room(table=False), [np.array([u, v]) for u in (-0.5, 0.5) for v in (-0.3, 0.3)]
    solids = [
        solid(room, np.zeros(2), (0.6, 0.4), 0.7, 0.75),
        *(solid(room, at, (0.04, 0.04), 0.0, 0.7) for at in legs),
    ]
    pictures = []
    for camera in ring(wh=(160, 90)):
        rgb, depth_m = photograph(room, camera)
        for one in solids:
            own, own_m = photograph(replace(room, table=one), camera)
            rgb, depth_m = np.where((own_m < depth_m)[..., None], own, rgb), np.minimum(depth_m, own_m)
        pictures.append(Picture(camera, rgb, np.ones(camera.hw, bool)))
    found = put_up(pictures, room.room_box, least_gain=60.0, most=8)
    top, *rest = sorted(found, key=lambda one: -one.size_m[0] * one.size_m[1])
    assert top.high_m == pytest.approx(0.75, abs=0.04)
    places = [room.room_box.axes[:2, :2] @ np.array(one.centre_m) for one in rest if max(one.size_m) < 0.2]
    assert all(min(np.linalg.norm(at - place) for place in places) < 0.08 for at in legs)
    assert len(places) == len(rest) == 4
    assert {(one.low_m, one.high_m) for one in rest} == {(0.0, top.low_m)}, "from the floor to the top"


def solid(room: Room, middle_m: np.ndarray, half_m: tuple[float, float], low_m: float, high_m: float) -> RoomBox:
    """A box in the room's own directions."""
    low, high = (np.array([*(middle_m + side * np.array(half_m)), z]) for side, z in ((-1, low_m), (1, high_m)))
    return replace(room.room_box, low_m=low, high_m=high)


def test_nothing_that_stands_on_the_floor_has_legs() -> None:
    hanging = np.array([0.3, -0.2, 0.5, 1.2, 0.8, 0.7, 0.75])
    legs = leg_candidates(hanging, 0.0)
    assert len(legs)
    assert (legs[:, 5] == 0.0).all()
    assert (legs[:, 6] == 0.7).all()
    c, s = np.cos(0.5), np.sin(0.5)
    under = np.abs((legs[:, :2] - hanging[:2]) @ np.array([[c, -s], [s, c]])) + legs[:, 3:5] / 2
    assert (under <= np.array([0.6, 0.4]) + 1e-9).all(), "not beside the top"
    assert not len(leg_candidates(np.array([0.3, -0.2, 0.5, 1.2, 0.8, 0.1, 0.75]), 0.0)), (
        "it stands nearly on the floor"
    )


def test_an_empty_room_stays_empty() -> None:
    room = made_room(table=False)
    assert put_up(looks(room), room.room_box) == []


def test_nothing_is_put_where_somebody_walked_or_a_camera_is(
    furnished: tuple[Room, list[Picture], list[Primitive]], tmp_path: Path
) -> None:
    room, pictures, found = furnished
    numbers = np.stack([primitive.numbers for primitive in found])
    place = np.array([*found[0].centre_m, (found[0].low_m + found[0].high_m) / 2])
    assert is_allowed(numbers, room.room_box, NOBODY)[0]
    assert not is_allowed(numbers, room.room_box, append_distance(place[None], 0.0))[0]
    assert not contains_any(numbers, append_distance(np.stack([p.camera.centre_m for p in pictures]), 0.0)).any()
    joints = np.tile(place, (3, 24, 1))
    joints[1], joints[2, 0] = 9.0, np.nan
    person = fitted_person("p0", "mpfb", 30.0, 3, joints=joints, valid=np.array([True, False, True]))
    places = joint_places([person])
    assert len(places) == 1
    assert np.abs(places[0, :3] - place).max() <= 0.1 + 1e-9
    assert joint_places([]).shape == (0, 4)


def test_the_sheet_shows_every_photo_and_the_plan(furnished: tuple[Room, list[Picture], list[Primitive]]) -> None:
    room, pictures, found = furnished
    depths = [p.plane_depths_of_pixels(np.broadcast_to([0, 0, 1.0, 0], (*p.camera.hw, 4))) for p in pictures]
    with_them, without = (
        overview_sheet(pictures, room.room_box, [*found, POST], depths),
        overview_sheet(pictures, room.room_box, [], depths),
    )
    assert with_them.shape == without.shape == (3 * 360, 2 * 640, 3)
    assert (with_them != without).any(axis=-1).mean() > 0.002
