# SPDX-License-Identifier: Apache-2.0
"""render: a person who is present for a part of the clip leaves no pixel, no shadow and no obstacle in the
rest of it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.body.avatar.avatar_files import Avatar
from studiorecon.body.model import BodyModel
from studiorecon.render.composite import Composite
from studiorecon.render.composite_renderer import CompositeRenderer
from studiorecon.render.room_light import Lamps, Light
from studiorecon.render.shading import build_shading
from studiorecon.render.statistics import nearby_obstacles
from studiorecon.scene.path import PathStep

from tests.made.scene import FRAMES, avatar, ring, room

# Present from frame 2 to frame 3.
THERE = np.array([False, False, True, True, False, False])


@pytest.fixture(scope="module")
def body(root: Path) -> BodyModel:
    return BodyModel.load(root / "resources/body.npz")


@pytest.fixture(scope="module")
def person(body: BodyModel) -> Avatar:
    return replace(avatar(body, np.random.default_rng(1), "p0"), present=THERE)


def lamp() -> Light:
    lamps = Lamps(np.array([[-1.2, 0.9, 2.6]]), np.array([[0, 0, -1.0]]), np.array([0.3]))
    usual = lamps.falloff(np.zeros((1, 3)))[0]
    return Light(True, "made", lamps, np.array([0.6]), usual, 0.1, 0.1, 0.1, 0.0, {"error": 0.01})


@pytest.mark.parametrize(("frame", "seen"), [(0, 0), (1.4, 0), (1.6, 1), (2, 1), (3.5, 1), (3.6, 0), (5, 0)])
def test_the_picture_is_the_one_without_them_where_they_are_away(person: Avatar, frame: float, seen: bool) -> None:
    static = room(np.random.default_rng(0))
    provenance, camera = np.zeros(static.count, np.uint8), ring([80], "c")[0]
    always = replace(person, present=np.ones(FRAMES, bool))
    with_them, as_ever, without = (
        CompositeRenderer(Composite(static, provenance, people), 0.2).draw(camera, frame, (0, 0, 0))
        for people in ([person], [always], [])
    )
    expected = as_ever if seen else without
    np.testing.assert_array_equal(with_them[0].rgb, expected[0].rgb)
    np.testing.assert_array_equal(with_them[0].depth_m, expected[0].depth_m)
    np.testing.assert_array_equal(with_them[1], expected[1])
    assert (as_ever[0].rgb != without[0].rgb).any()


def test_they_throw_no_shadow_where_they_are_away(person: Avatar) -> None:
    static, always = room(np.random.default_rng(0)), replace(person, present=np.ones(FRAMES, bool))
    shade = build_shading(lamp(), static, [person], [person])
    as_ever = build_shading(lamp(), static, [always], [person])
    assert shade is not None
    assert as_ever is not None
    for frame in (0, 1.4, 5):
        assert shade.factor(frame).min() > 1 - 1e-6, "nothing is darkened"
        assert as_ever.factor(frame).min() < 0.9
    np.testing.assert_array_equal(shade.factor(2.5), as_ever.factor(2.5))


def test_a_plate_does_not_show_the_shadow_of_who_was_away_most_of_the_time(person: Avatar) -> None:
    """A static person shades the plate; a person present for a third of the time does not."""
    static, frames = room(np.random.default_rng(0)), 30
    still = replace(
        person, poses=np.repeat(person.poses[:1], frames, axis=0), trans=np.repeat(person.trans[:1], frames, axis=0)
    )
    stays, visits = replace(still, present=np.ones(frames, bool)), replace(still, present=np.arange(frames) < 10)
    usual = []
    for one in (stays, visits):
        shade = build_shading(lamp(), static, [one], [one])
        assert shade is not None
        usual.append(shade.plate_light)
    assert usual[0].min() < 0.9
    assert usual[1].min() > 0.95


def test_a_camera_may_stand_where_they_will_be(person: Avatar) -> None:
    static = room(np.random.default_rng(0))
    scene = Composite(static, np.zeros(static.count, np.uint8), [person])
    camera = ring([80], "c")[0]
    always = replace(person, present=np.ones(FRAMES, bool))
    near = replace(camera, camera_from_world=camera.camera_from_world.copy())
    near.camera_from_world[:3, 3] = -near.camera_from_world[:3, :3] @ always.joints_m(0.0)[15]
    assert nearby_obstacles([PathStep(near, 0.0, "00"), PathStep(near, 2.0, "00")], scene, 0.3)[0] == ""
    assert nearby_obstacles([PathStep(near, 0.0, "00")], replace(scene, people=[always]), 0.3) == ["p0"]
