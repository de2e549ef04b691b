# SPDX-License-Identifier: Apache-2.0
"""objects.find: a board that tumbles, of two colours and with outlines that tell, and things of which nothing tells
that they turn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.geometry import rotations
from studiorecon.masks.loose_objects import subtract_objects
from studiorecon.objects.find import Settings
from studiorecon.objects.rotation import NEVER_DB
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.rigid_object import MEASURED_TURNS, NO_TURNS, RigidObject, read_objects, write_objects

from tests.made.objects import CAMERAS, FRAMES, UNSEEN, Ball, bouncing, drawn
from tests.made.objects_rotation import (  # noqa: F401
    COLOURS,
    HALF_M,
    Board,
    found,
    pictured,
    seen_db,
    settings,
    shown,
    tumbling,
    turn_errors_deg,
)


@pytest.fixture(scope="module")
def tumbled(settings: Settings) -> RigidObject:
    (thing,) = found(settings, pictured)
    return thing


def test_a_tumbling_board_is_followed_in_place_and_turn(tumbled: RigidObject) -> None:
    board = tumbling()
    assert tumbled.turns == MEASURED_TURNS
    assert tumbled.valid.sum() >= FRAMES - 2
    error_deg = turn_errors_deg(tumbled, board)[tumbled.valid]
    assert np.median(error_deg) < 3
    assert error_deg.max() < 8
    assert np.median(np.linalg.norm(tumbled.centres_m - board.path_m, axis=1)[tumbled.valid]) < 0.01


def test_a_thing_that_turns_looks_better_for_it(
    settings: Settings, tumbled: RigidObject, capsys: pytest.CaptureFixture
) -> None:
    never = replace(settings, turn=replace(settings.turn, gain_db=NEVER_DB))
    (still,) = found(never, pictured)
    assert still.turns == NO_TURNS
    assert (still.world_from_object == np.eye(3)).all()
    assert "undetermined" in capsys.readouterr().out
    assert seen_db(tumbled, pictured) > seen_db(still, pictured) + 4


@pytest.mark.parametrize(
    "colours",
    [
        pytest.param(((0.8, 0.15, 0.1), (0.8, 0.15, 0.1)), id="plain", marks=pytest.mark.slow),
        pytest.param(((0.8, 0.15, 0.1), (0.9, 0.85, 0.2)), id="halved"),
    ],
)
def test_of_a_ball_nothing_tells_that_it_turns(settings: Settings, colours: tuple) -> None:
    """Of one colour nothing could; of two, which do not turn, nothing does."""
    (ball,) = found(settings, lambda camera, frame: drawn(camera, [Ball(bouncing(), colours=colours)], frame))
    assert ball.turns == NO_TURNS
    assert (ball.world_from_object == np.eye(3)).all()
    error_m = np.linalg.norm(ball.centres_m - bouncing(), axis=1)[ball.valid]
    assert np.median(error_m) < 0.006


def test_a_turned_things_own_outline_is_nobodys(tumbled: RigidObject) -> None:
    board = tumbling()
    for frame in (2, 10, 20):
        camera = CAMERAS[1]
        truth = np.abs(board.over(camera, np.zeros((*camera.hw, 3)), frame)).max(axis=-1) > 0
        outline = tumbled.outline(camera, frame, 1.15) > 0
        assert outline[truth].mean() > 0.95
        assert truth[outline].mean() > 0.5, "it is no sphere of that reach"
        labels = subtract_objects(
            np.ones(camera.hw, np.uint8), [tumbled], np.zeros((1, *camera.hw), np.float32), camera, frame
        )
        assert ((labels == 255) == outline).all()


def test_a_turned_thing_looks_as_from_a_turned_camera(tumbled: RigidObject) -> None:
    """Means, discs and colours that depend on the view turn together."""
    rng = np.random.default_rng(0)
    glossy = np.concatenate([tumbled.gaussians.sh, rng.normal(0, 0.1, (tumbled.gaussians.count, 8, 3))], axis=1)
    thing = replace(tumbled, gaussians=replace(tumbled.gaussians, sh=glossy))
    for frame in (3, 11.5):
        camera_from_object = UNSEEN.camera_from_world @ thing.pose_at(frame)
        from_it = replace(UNSEEN, camera_from_world=camera_from_object)
        drawing = Rasteriser(near_m=0.05, threads=1)
        there, here = drawing.forward(thing.posed(frame), UNSEEN), drawing.forward(thing.gaussians, from_it)
        assert there.alpha.max() > 0.9
        np.testing.assert_allclose(there.rgb, here.rgb, atol=2e-3)


def test_between_frames_a_thing_is_between_its_turns(tumbled: RigidObject) -> None:
    first, second = tumbled.world_from_object[4:6]
    whole = rotations.angle(first, second)
    assert whole > np.radians(3)
    assert rotations.angle(first, tumbled.turn_at(4.25)) == pytest.approx(whole / 4, rel=1e-3)


def test_turns_survive_their_file_and_an_older_file_is_refused(tumbled: RigidObject, tmp_path: Path) -> None:
    write_objects(tmp_path / "objects.npz", [tumbled], FRAMES)
    (again,) = read_objects(tmp_path / "objects.npz")
    assert again.turns == MEASURED_TURNS
    np.testing.assert_array_equal(again.world_from_object, tumbled.world_from_object)
    with np.load(tmp_path / "objects.npz") as data:
        np.savez(tmp_path / "older.npz", **{name: data[name] for name in data.files if not name.endswith("turns")})
    with pytest.raises(UserError, match=r"older\.npz .*\bo0\.turns\b"):
        read_objects(tmp_path / "older.npz")
