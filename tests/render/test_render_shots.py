# SPDX-License-Identifier: Apache-2.0
"""render: the kinds of camera paths, and what a film's ledger says about them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from studiorecon.body.model import BodyModel
from studiorecon.camera_files.colmap import write_model
from studiorecon.errors import UserError
from studiorecon.render.keyframes import read_keys, spline_steps
from studiorecon.render.kinds import KINDS, read_film_settings
from studiorecon.render.look_at_targets import LookAtTargets
from studiorecon.render.moves import DollyZoom, Follow, Oscillate, dolly_zoom_steps, follow_steps, oscillate_steps
from studiorecon.render.path_file import GivenPath, path_steps
from studiorecon.render.planning import plan_steps
from studiorecon.render.shot import aim_m, find_targets
from studiorecon.scene.path import PathStep

from tests.made.cameras import look_at
from tests.made.scene import FPS, WH, avatar, ring, room

CAMERAS = ring([0, 90, 180, 270], "cam")
T = 41


@pytest.fixture(scope="module")
def subjects() -> LookAtTargets:
    """One person walks 2 m along x and faces that way; another is static at (0, 1)."""
    walk = np.stack([np.linspace(-1, 1, T), np.zeros(T), np.full(T, 0.95)], axis=1)
    facing = np.tile([1.0, 0.0], (T, 1))
    stands = np.tile([0.0, 1.0, 0.95], (T, 1))
    present = np.ones(T, bool)
    return LookAtTargets(
        {"p0": walk, "p1": stands},
        {"p0": facing, "p1": facing},
        {"p0": present, "p1": present},
        np.array([0, 0, 1.0]),
        T,
        FPS,
    )


def seen_size(step: PathStep, place_m: np.ndarray) -> float:
    """Size in pixels of a horizontal metre at a position, perpendicular to the view."""
    return step.camera.focal_px[0] / float(step.camera.project(place_m[None])[1][0])


DOLLY = DollyZoom("dolly_zoom", 31, (0.0, 0.0, 1.0), "cam1", (1.0, 0.5), 2, 1.5, "stretch")


def test_a_dolly_zoom_keeps_the_size_of_its_target_while_the_camera_travels(subjects: LookAtTargets) -> None:
    steps = dolly_zoom_steps(DOLLY, "dolly", CAMERAS, subjects, WH)
    sizes = [seen_size(step, np.array(DOLLY.target)) for step in steps]
    assert sizes == pytest.approx([sizes[0]] * 31)
    own = PathStep(CAMERAS[1], 0.0, "")
    assert sizes[0] == pytest.approx(1.5 * seen_size(own, np.array(DOLLY.target))), (
        "a multiple of its size in the camera's own picture"
    )
    travel = np.array([np.linalg.norm(s.camera.centre_m - DOLLY.target) for s in steps]) / np.linalg.norm(
        CAMERAS[1].centre_m - DOLLY.target
    )
    assert travel[[0, 15, 30]] == pytest.approx([1, 0.5, 1])
    assert (np.diff(travel[:16]) < 0).all()
    behind = np.array([0.0, -1.5, 1.0])
    assert seen_size(steps[15], behind) < 0.8 * seen_size(steps[0], behind), "the room behind the target opens up"


def test_a_dolly_zoom_is_locked_on_a_person_who_walks(subjects: LookAtTargets) -> None:
    steps = dolly_zoom_steps(replace(DOLLY, target="p0", camera="cam3"), "dolly", CAMERAS, subjects, WH)
    places = subjects.at("p0", np.array([s.frame for s in steps]), "dolly")
    sizes = [seen_size(step, place) for step, place in zip(steps, places)]
    assert sizes == pytest.approx([sizes[0]] * 31)
    pixels = np.array([s.camera.project(p[None])[0][0] for s, p in zip(steps, places)])
    assert np.abs(pixels - np.array(WH) / 2).max() < 1e-6
    assert places[-1, 0] - places[0, 0] > 1.5


def test_an_oscillation_swings_evenly_about_its_camera(subjects: LookAtTargets) -> None:
    shot = Oscillate("oscillate", 80, "scene", "cam2", 20.0, 0.1, 2.0, 0.9, 1.0, "loop")
    steps = oscillate_steps(shot, "swing", CAMERAS, subjects, WH, np.ones(80))
    eyes = np.array([s.camera.centre_m for s in steps]) - subjects.scene_m
    azimuth = np.degrees(np.unwrap(np.arctan2(eyes[:, 1], eyes[:, 0]))) - 180
    assert (azimuth.min(), azimuth.max()) == pytest.approx((-20, 20), abs=0.1)
    assert np.linalg.norm(eyes[:, :2], axis=1) == pytest.approx(0.9 * 2.4)
    assert np.ptp(eyes[:, 2]) == pytest.approx(0.2, abs=1e-3)
    # The path has no jump, also from the last picture to the first: the film can be looped.
    gaps = np.linalg.norm(np.diff(eyes, axis=0, append=eyes[:1]), axis=1)
    assert gaps.max() < 2 * np.median(gaps)


def test_a_following_camera_keeps_its_place_beside_the_person(subjects: LookAtTargets) -> None:
    shot = Follow("follow", T, "p0", 2.0, 0.5, 180.0, "person", 0.2, 1.0, "stretch")
    steps = follow_steps(shot, "follow", CAMERAS, subjects, WH, np.ones(T))
    places = subjects.at("p0", np.arange(float(T)), "follow", 0.2)
    offsets = np.array([s.camera.centre_m for s in steps]) - places
    assert np.abs(offsets - [-2.0, 0, 0.5]).max() < 1e-9, "behind a person who faces x"
    turned = replace(subjects, facing={"p0": np.tile([0.0, 1.0], (T, 1))})
    beside = follow_steps(shot, "follow", CAMERAS, turned, WH, np.ones(T))
    assert np.abs(np.array([s.camera.centre_m for s in beside]) - places - [0, -2.0, 0.5]).max() < 1e-9
    fixed = follow_steps(replace(shot, beside="world"), "follow", CAMERAS, turned, WH, np.ones(T))
    assert np.abs(np.array([s.camera.centre_m for s in fixed]) - places - [-2.0, 0, 0.5]).max() < 1e-9


def test_facing_does_not_wrap(subjects: LookAtTargets) -> None:
    """A person who faces 179 and -179 degrees in turn faces 180, not 0 (F01's trap, for headings)."""
    angle = np.radians(np.where(np.arange(T) % 2, 179, -179))
    turned = replace(subjects, facing={"p0": np.stack([np.cos(angle), np.sin(angle)], axis=1)})
    facing = turned.facing_at("p0", np.arange(float(T)), "follow", 1.0)
    assert np.abs(np.degrees(np.abs(facing)) - 180).max() < 1.0


def key(picture: int, frame: float, eye: tuple, target: object = "scene", zoom: float = 1.0) -> dict:
    return {"picture": picture, "frame": frame, "eye_m": list(eye), "target": target, "zoom": zoom}


KEYS = [
    key(0, 0, (2, 0, 1.5)),
    key(20, 20, (2, 1, 1.5)),
    key(60, 20, (-2, 1, 1.5), zoom=2.0),
    key(80, 40, (-2, 0, 1.5), zoom=2.0),
]


def test_a_spline_passes_through_its_keys_and_stops_time_between_equal_frames(subjects: LookAtTargets) -> None:
    steps = spline_steps(read_keys(KEYS, "bullet"), "bullet", CAMERAS, subjects, WH)
    assert len(steps) == 81
    for given in KEYS:
        step = steps[given["picture"]]
        assert step.camera.centre_m == pytest.approx(given["eye_m"])
        assert step.frame == pytest.approx(given["frame"])
        assert step.camera.focal_px[0] == pytest.approx(given["zoom"] * 0.7 * WH[0])
    frames = np.array([s.frame for s in steps])
    assert frames[20:61] == pytest.approx(20), "bullet time"
    assert (np.diff(frames) >= -1e-12).all(), "time never runs backwards"
    speed = np.linalg.norm(np.diff([s.camera.centre_m for s in steps], axis=0), axis=1)
    assert np.abs(np.diff(speed)).max() < 0.2 * speed.max(), "no jerk at the keys"
    for step in steps:
        assert step.camera.project(subjects.scene_m[None])[0][0] == pytest.approx(np.array(WH) / 2, abs=1e-6)


def test_a_spline_through_training_cameras_turns_on_so3(subjects: LookAtTargets) -> None:
    keys = [
        {"picture": p, "frame": 0.0, "camera": c, "zoom": 1.0} for p, c in ((0, "cam0"), (10, "cam1"), (20, "cam2"))
    ]
    steps = spline_steps(read_keys(keys, "tour"), "tour", CAMERAS, subjects, WH)
    for picture, camera in ((0, 0), (10, 1), (20, 2)):
        assert steps[picture].camera.camera_from_world == pytest.approx(CAMERAS[camera].camera_from_world, abs=1e-9)
    for step in steps:
        rotation = step.camera.camera_from_world[:3, :3]
        assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)


def test_a_path_file_is_followed_as_it_stands(tmp_path: Path) -> None:
    """transforms.json in OpenGL axes and a COLMAP model of the same cameras give the same pictures."""
    frames = []
    for index, camera in enumerate(CAMERAS):
        pose = camera.world_from_camera @ np.diag([1.0, -1, -1, 1])
        frames.append({"transform_matrix": pose.tolist(), "frame": 1.5 * index})
    lens = CAMERAS[0]
    content = {"fl_x": lens.focal_px[0], "fl_y": lens.focal_px[1], "w": WH[0], "h": WH[1], "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    given = path_steps(GivenPath("path", str(tmp_path / "transforms.json"), "hold"), "fly", (2 * WH[0], 0), T)
    assert [s.frame for s in given] == [0, 1.5, 3.0, 4.5]
    assert given[0].camera.wh == (2 * WH[0], 2 * WH[1])
    write_model(tmp_path / "sparse", CAMERAS)
    colmap = path_steps(GivenPath("path", str(tmp_path / "sparse/images.txt"), "stretch"), "fly", (2 * WH[0], 0), T)
    assert [s.frame for s in colmap] == pytest.approx(np.linspace(0, T - 1, 4))
    for a, b, camera in zip(given, colmap, CAMERAS):
        assert a.camera.camera_from_world == pytest.approx(camera.camera_from_world, abs=1e-9)
        assert b.camera.camera_from_world == pytest.approx(camera.camera_from_world, abs=1e-9)
        assert a.camera.intrinsics == pytest.approx(b.camera.intrinsics)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (None, "is missing"),
        ({"frames": []}, "has no frames"),
        ({"fl_x": 100, "w": 10, "frames": [{"transform_matrix": np.eye(4).tolist()}]}, "picture 0 .* has no h"),
        (
            {"fl_x": 100, "w": 10, "h": 10, "frames": [{"transform_matrix": np.diag([1.0, 2, 1, 1]).tolist()}]},
            "not a rotation",
        ),
        (
            {"fl_x": 100, "w": 10, "h": 10, "frames": [{"transform_matrix": np.diag([2.0, 2.0, 2.0, 1.0]).tolist()}]},
            "no rigid pose; remove its scale of 2",
        ),
    ],
)
def test_a_broken_path_file_is_refused_by_name(tmp_path: Path, content: dict | None, sentence: str) -> None:
    file = tmp_path / "transforms.json"
    if content is not None:
        file.write_text(json.dumps(content))
    with pytest.raises(UserError, match=sentence):
        path_steps(GivenPath("path", str(file), "hold"), "fly", WH, T)


def test_a_shot_of_people_looks_where_they_are_while_they_are_there(subjects: LookAtTargets) -> None:
    """The path of an absent person leads to the place of return; it is no position of theirs."""
    early = np.arange(T) < 10
    left = replace(subjects, present={"p0": early, "p1": np.ones(T, bool)})
    assert left.still("p0", "shot") == pytest.approx(np.median(subjects.aim_m["p0"][:10], axis=0))
    both = np.concatenate([subjects.aim_m["p0"][:10], subjects.aim_m["p1"]])
    assert left.still("people", "shot") == pytest.approx(np.median(both, axis=0))


def test_somebody_who_watches_from_behind_the_cameras_is_no_aim(subjects: LookAtTargets) -> None:
    behind = replace(subjects, aim_m={**subjects.aim_m, "p1": subjects.aim_m["p1"] + [0, 4.0, 0]}, reach_m=3.0)
    np.testing.assert_allclose(behind.still("people", "shot"), np.median(subjects.aim_m["p0"], axis=0))
    np.testing.assert_allclose(behind.still("p1", "shot"), [0, 5, 0.95])
    alone = replace(behind, aim_m={"p1": behind.aim_m["p1"]})
    np.testing.assert_allclose(alone.still("people", "shot"), [0, 5, 0.95])


def test_a_film_aims_at_what_cameras_have_in_view_of_somebody_at_a_desk(root: Path) -> None:
    person = avatar(BodyModel.load(root / "resources/body.npz"), np.random.default_rng(0), "p0")
    assert np.array_equal(aim_m(person, CAMERAS), person.trans)
    # Cameras at a metre, whose pictures end above the hips.
    near = [
        look_at(f"cam{k}", np.array([np.sin(a), -np.cos(a), 1.5]), [0, 0, 1.5], (320, 180), 320.0)
        for k, a in enumerate((-0.4, 0.4))
    ]
    above_m = aim_m(person, near) - person.trans
    np.testing.assert_allclose(above_m, np.tile(above_m[0], (len(above_m), 1)), atol=1e-12)
    assert 0.4 < above_m[0, 2] < 0.7


def test_every_example_shot_is_planned(root: Path) -> None:
    """config/presets/shots.yaml, on a room with one walking person: right number of pictures, level or rigid cameras,
    times in range."""
    shots = yaml.safe_load((root / "config/presets/shots.yaml").read_text())["render"]["shots"]
    rng = np.random.default_rng(0)
    person = avatar(BodyModel.load(root / "resources/body.npz"), rng, "p0", frames=40)
    subjects = find_targets([person], CAMERAS, 40, FPS)
    static = room(rng, 0.3)
    for name, described in shots.items():
        steps = plan_steps(name, shots, 0, 0.3, CAMERAS, [], subjects, static)
        expected = (
            described["keys"][-1]["picture"] + 1 if "keys" in described else read_film_settings(described, name).frames
        )
        assert len(steps) == expected, name
        assert {s.camera.wh for s in steps} == {WH}
        assert all(0 <= s.frame <= 39 and np.isfinite(s.camera.camera_from_world).all() for s in steps), name


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "path"])
def test_a_film_needs_only_its_kind(kind: str, subjects: LookAtTargets) -> None:
    rng = np.random.default_rng(0)
    held_out = ring([45], "held")
    steps = plan_steps("extra", {"extra": {"kind": kind}}, 0, 0.3, CAMERAS, held_out, subjects, room(rng, 0.3))
    assert len(steps) == (
        T if kind == "heldout" else 91 if kind == "spline" else read_film_settings({"kind": kind}, "extra").frames
    )
    assert all(0 <= s.frame <= T - 1 and np.isfinite(s.camera.camera_from_world).all() for s in steps)


def test_a_spline_without_keys_goes_from_camera_to_camera_while_time_runs_through(subjects: LookAtTargets) -> None:
    shuffled = [CAMERAS[i] for i in (1, 3, 0, 2)]
    steps = plan_steps(
        "tour", {"tour": {"kind": "spline"}}, 0, 0.3, shuffled, [], subjects, room(np.random.default_rng(0), 0.3)
    )
    for picture, camera in ((0, 1), (30, 2), (60, 3), (90, 0)):
        assert steps[picture].camera.centre_m == pytest.approx(CAMERAS[camera].centre_m), "once around, by azimuth"
    assert [steps[0].frame, steps[-1].frame] == pytest.approx([0, T - 1])
    assert np.diff([s.frame for s in steps]) == pytest.approx((T - 1) / 90)


def test_a_key_without_a_frame_leaves_time_to_the_keys_around_it(subjects: LookAtTargets) -> None:
    keys = [{k: v for k, v in key.items() if k != "frame"} for key in KEYS]
    keys[1]["frame"] = keys[2]["frame"] = 20.0
    steps = spline_steps(read_keys(keys, "bullet"), "bullet", CAMERAS, subjects, WH)
    frames = np.array([s.frame for s in steps])
    assert frames[[0, 80]] == pytest.approx([0, T - 1])
    assert frames[20:61] == pytest.approx(20)


def test_a_person_faces_where_the_body_does(root: Path) -> None:
    person = avatar(BodyModel.load(root / "resources/body.npz"), np.random.default_rng(0), "p0")
    toes = person.model.joints(person.poses, person.betas, person.trans)[:, [10, 11]].mean(axis=1)
    ankles = person.model.joints(person.poses, person.betas, person.trans)[:, [7, 8]].mean(axis=1)
    forward = (toes - ankles)[:, :2]
    assert (np.sum(forward * person.facing(), axis=1) > 0.95 * np.linalg.norm(forward, axis=1)).all()


def test_a_path_through_bent_lenses_is_drawn_straight_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    pose = (CAMERAS[0].world_from_camera @ np.diag([1.0, -1, -1, 1])).tolist()
    content = {"fl_x": 100, "w": 10, "h": 10, "k1": -0.1, "frames": [{"transform_matrix": pose}]}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    (step,) = path_steps(GivenPath("path", str(tmp_path / "transforms.json"), "hold"), "fly", WH, T)
    assert step.camera.camera_from_world == pytest.approx(CAMERAS[0].camera_from_world)
    assert "without the distortion of its lenses" in capsys.readouterr().out
