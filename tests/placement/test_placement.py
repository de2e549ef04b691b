# SPDX-License-Identifier: Apache-2.0
"""placement: the predicted error is what noise makes of it, advice is worth what it says, and symmetric rooms get
symmetric rigs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from studiorecon.camera_files.colmap import write_model
from studiorecon.cli import command
from studiorecon.errors import UserError
from studiorecon.geometry.camera_path import look_at
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.placement import advise
from studiorecon.placement.camera_placement import advise_moves, lens_from_fov, move_text, place_cameras, with_pose
from studiorecon.placement.picture import camera_position_text
from studiorecon.placement.rig_quality import RigEvaluator, errors_m, information, is_in_picture
from studiorecon.placement.room import TALL_M, WIDTH_M, Room, is_blocked, read_room, room_about
from studiorecon.scene.camera import Camera

ROOM = read_room("6x5x2.8")


def lenses(count: int, hfov_deg: float = 65.0) -> list[Camera]:
    return [lens_from_fov(f"cam{k + 1}", hfov_deg, (1920, 1080)) for k in range(count)]


@pytest.fixture(scope="module")
def rig() -> list[Camera]:
    return place_cameras(ROOM, lenses(4))


def noise_px(camera: Camera, point_m: np.ndarray) -> float:
    """Deviation per coordinate that the planner assumes of the detector, written out once more."""
    person_px = np.mean(camera.focal_px) * 1.7 / camera.project(point_m[None])[1][0]
    return float(np.hypot(0.5, 0.0075 * person_px))


@pytest.mark.parametrize("point", [(3.0, 2.5, 1.0), (2.2, 3.1, 1.65), (4.0, 2.0, 0.6)])
@pytest.mark.parametrize("count", [2, 4])
def test_the_predicted_error_is_what_noise_makes_of_triangulation(rig: list[Camera], point: tuple, count: int) -> None:
    cameras, place_m = rig[:count], np.array(point)
    predicted = errors_m(information(cameras, place_m[None]), is_in_picture(cameras, place_m[None]))[0]
    draws = 3000
    rng = np.random.default_rng(5)
    pixels = np.stack([c.project(place_m[None])[0] + rng.normal(0, noise_px(c, place_m), (draws, 2)) for c in cameras])
    limits = Limits(min_confidence=0.0, huber_share=0.05, outlier_units=50.0, min_angle_deg=1.0, near_m=0.1)
    # Weights as the noise is: the bound is for an estimate that knows it.
    weights = np.tile([[1 / noise_px(c, place_m) ** 2] for c in cameras], (1, draws))
    found = triangulate(pixels, weights / weights.max(), cameras, limits, solver="huber")
    error = np.sqrt(np.mean(np.sum((found.points_m - place_m) ** 2, axis=1)))
    assert error == pytest.approx(predicted, rel=0.06)


def test_a_point_that_one_camera_sees_and_one_on_the_line_between_two_are_undetermined(rig: list[Camera]) -> None:
    opposite = [
        with_pose(c, np.array(eye), look_at(np.array(eye), np.array([0, 0, 1.0])))
        for c, eye in zip(rig, [(3, 0, 1), (-3, 0, 1.0)])
    ]
    reported = information(opposite, np.array([[0.0, 0, 1.0], [0.0, 0.5, 1.0]]))
    both = np.ones((2, 2), bool)
    assert errors_m(reported, both)[0] > 10, "on the base line: T02"
    assert errors_m(reported, both)[1] < 0.2
    assert np.isinf(errors_m(reported, np.array([[True, True], [False, False]]))).all()


def test_somebody_in_the_way_hides_what_lies_behind_them() -> None:
    rng = np.random.default_rng(0)
    eyes, points = rng.uniform((-2, -2, 0.2), (2, 2, 2.8), (12, 3)), rng.uniform((-2, -2, 0), (2, 2, 2.5), (200, 3))
    stands = np.array([0.3, -0.1])
    line = np.linspace(0, 1, 4001)[:, None, None, None]
    along = eyes[:, None] + line * (points - eyes[:, None])
    inside = (np.linalg.norm(along[..., :2] - stands, axis=-1) < WIDTH_M / 2) & (along[..., 2] < TALL_M)
    expected, found = inside.any(axis=0), is_blocked(eyes, points, stands, 0.0)
    assert (expected != found).mean() < 0.002, "but for lines that graze"
    assert 0.02 < found.mean() < 0.5


def turned_by_half(camera: Camera, room: Room, turns: float) -> tuple:
    angle = turns * 2 * np.pi
    matrix = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    eye = room.middle_m + matrix @ (camera.centre_m[:2] - room.middle_m)
    return tuple(np.round([*eye, camera.centre_m[2], *(matrix @ camera.forward[:2]), camera.forward[2]], 6) + 0.0)


@pytest.mark.parametrize(("size", "count", "turns"), [("5x5x2.8", 4, 0.25), ("7x4x2.6", 4, 0.5), ("7x4x2.6", 2, 0.5)])
def test_a_symmetric_room_gets_a_symmetric_rig(size: str, count: int, turns: float) -> None:
    room = read_room(size)
    cameras = place_cameras(room, lenses(count))
    assert {turned_by_half(c, room, turns) for c in cameras} == {turned_by_half(c, room, 0) for c in cameras}
    errors = RigEvaluator(room).joint_errors_m(cameras, room.at_height(1.0))
    assert errors[::-1] == pytest.approx(errors, rel=1e-6), "the stage's grid turned by half a turn"


def test_cameras_stand_in_the_room_and_a_named_rig_is_well_placed(rig: list[Camera]) -> None:
    assert all(ROOM.holds(camera.centre_m, 0.1) for camera in rig)
    figures = RigEvaluator(ROOM).figures(rig)
    assert figures.two["head"] > 0.95
    assert 0.008 < figures.error_m < 0.03
    assert figures.unseen["floor"] < 0.1


def test_another_camera_never_makes_anything_worse(rig: list[Camera]) -> None:
    evaluator = RigEvaluator(ROOM)
    eye = np.array([3.0, 0.3, 2.2])
    fewer, more = (
        evaluator.figures(rig),
        evaluator.figures([*rig, with_pose(rig[0], eye, look_at(eye, np.array([3.0, 3.0, 1.0])))]),
    )
    assert more.error_m <= fewer.error_m
    assert more.worst_error_m <= fewer.worst_error_m
    for name in ("two", "three", "two_hidden", "three_hidden"):
        assert all(getattr(more, name)[height] >= share for height, share in getattr(fewer, name).items())
    assert all(more.unseen[part] <= share for part, share in fewer.unseen.items())
    with_none = evaluator.figures(rig[:1])
    assert with_none.undetermined == 1.0


def displaced(rig: Sequence[Camera]) -> list[Camera]:
    turned = look_at(rig[2].centre_m, np.array([5.5, 1.0, 1.6]))
    return [*rig[:2], with_pose(rig[2], rig[2].centre_m - [0.5, 0.3, 1.2], turned), rig[3]]


def test_advice_names_the_camera_that_stands_badly_and_is_worth_what_it_says(rig: list[Camera]) -> None:
    cameras = displaced(rig)
    evaluator = RigEvaluator(ROOM)
    before, moves = evaluator.cost_m(cameras), advise_moves(cameras, ROOM)
    assert moves[0].camera == "cam3"
    assert moves[0].gain > 0.1
    for move in moves:
        after = evaluator.cost_m([move.better if camera.name == move.camera else camera for camera in cameras])
        assert after == pytest.approx(before * (1 - move.gain))
        assert ROOM.holds(move.better.centre_m, 0.1)
        assert move.camera in move.words
    assert [move.gain for move in moves] == sorted((move.gain for move in moves), reverse=True)
    assert not [move for move in advise_moves(rig, ROOM) if move.gain > 0.1], "a planned rig has little to gain"


def test_a_move_is_reported_as_seen_from_behind_the_camera() -> None:
    camera = with_pose(
        lens_from_fov("cam3", 65, (1920, 1080)),
        np.array([3.0, 0.5, 1.5]),
        look_at(np.array([3.0, 0.5, 1.5]), np.array([3.0, 4.0, 1.5])),
    )
    here, rotation = camera.centre_m, camera.world_from_camera[:3, :3]
    assert move_text(camera, with_pose(camera, here - [0.6, 0, 0], rotation)) == "move cam3 60 cm left"
    assert (
        move_text(camera, with_pose(camera, np.add(here, (0.6, -0.3, 0.1)), rotation))
        == "move cam3 60 cm right, 30 cm back, 10 cm up"
    )
    assert (
        move_text(camera, with_pose(camera, here, look_at(here, np.array([2.0, 4.0, 1.5]))))
        == "turn cam3 16° to the left"
    )
    nearer = np.add(here, (0, 0.3, 0))
    lowered = with_pose(camera, nearer, look_at(nearer, np.array([3.0, 4.0, 1.0])))
    assert move_text(camera, lowered) == "move cam3 30 cm forward and tilt it 9° down"


def test_a_room_is_taken_to_be_where_the_cameras_stand(rig: list[Camera]) -> None:
    found = room_about(rig)
    assert found.size_m == pytest.approx([6.3, 5.3, 2.9])
    row = [
        with_pose(c, np.array([x, 0.0, 1.5]), look_at(np.array([x, 0.0, 1.5]), np.array([1.5, 4.0, 1.0])))
        for c, x in zip(rig, (0, 1, 2, 3))
    ]
    assert room_about(row).high_m[1] > 3.0, "cameras in a row look into a room that lies before them"


def test_the_command_plans_a_room_the_same_every_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["plan", "--room", "4x3x2.5", "--cameras", "2", "--hfov", "80", "60"]
    assert command.main(words) == 0
    reported = capsys.readouterr().out
    first = (tmp_path / "plan.svg").read_bytes(), (tmp_path / "plan.json").read_bytes()
    assert command.main([*words, "--picture", "again.svg"]) == 0
    assert ((tmp_path / "again.svg").read_bytes(), (tmp_path / "again.json").read_bytes()) == first
    assert "2 cameras of 80° and 60° (1920 × 1080) in 4 × 3 × 2.5 m" in reported
    assert "Seen by two cameras at head height" in reported
    assert "plan.svg" in reported
    assert reported.count("m from the left wall") == 2
    words_in_picture = " ".join(ElementTree.parse(tmp_path / "plan.svg").getroot().itertext())
    assert "cam2" in words_in_picture
    assert len(json.loads((tmp_path / "plan.json").read_text())["cameras"]) == 2
    assert command.main(["plan"]) == 1
    assert "give the room" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("eye", "towards", "words"),
    [
        (
            (0.15, 0.2, 2.5),
            (3.0, 3.0, 1.0),
            "0.15 m from the left wall, 0.20 m from the near one, 2.50 m high; faces far right",
        ),
        (
            (5.8, 4.9, 0.5),
            (3.0, 4.9, 1.0),
            "5.80 m from the left wall, 4.90 m from the near one, 0.50 m high; faces left",
        ),
        (
            (3.0, 4.9, 1.0),
            (3.0, 1.0, 1.0),
            "3.00 m from the left wall, 4.90 m from the near one, 1.00 m high; faces to the near",
        ),
    ],
)
def test_where_a_camera_stands_is_said_in_metres_and_directions_of_the_picture(
    eye: tuple, towards: tuple, words: str
) -> None:
    low = np.array(ROOM.low_m)
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3], world_from_camera[:3, 3] = look_at(low + eye, low + towards), low + eye
    camera = replace(lenses(1)[0], camera_from_world=np.linalg.inv(world_from_camera))
    messages = camera_position_text(camera, ROOM)
    assert words in messages
    assert eye[2] == towards[2] or messages.endswith("down" if eye[2] > towards[2] else "up")


def test_a_finished_calibration_is_advised(
    rig: list[Camera], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_model(tmp_path, displaced(rig))
    advise.run(tmp_path / "images.txt", tmp_path / "advice.svg", tmp_path / "advice.json")
    found = json.loads((tmp_path / "advice.json").read_text())
    assert found["advice"][0]["camera"] == "cam3"
    assert found["advice"][0]["words"][1:] in capsys.readouterr().out
    assert found["advice"][0]["words"][1:] in " ".join(ElementTree.parse(tmp_path / "advice.svg").getroot().itertext())
    write_model(tmp_path / "one", [replace(rig[0], name="alone")])
    with pytest.raises(UserError, match="1 camera, which cannot measure distance"):
        advise.run(tmp_path / "one/images.txt", tmp_path / "a.svg", tmp_path / "a.json")
