# SPDX-License-Identifier: Apache-2.0
"""people: the film that shows keypoints and skeletons over one camera's footage."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import write_person
from studiorecon.errors import UserError
from studiorecon.footage.video import read_stack
from studiorecon.images.palette import NOBODY, person_colour
from studiorecon.people import overlay
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections, Person, write_detections, write_identities

from tests.made.scene import FPS, FRAMES, ring, write_scene

CAMERA = ring([0, 90, 180, 270], "cam", wh=(320, 200))[0]


@pytest.fixture(scope="module")
def person(root: Path) -> Person:
    body = BodyModel.load(root / "resources/body.npz")
    poses, trans = np.zeros((FRAMES, 72)), np.tile([0.0, 0.0, 0.95], (FRAMES, 1))
    poses[:, 0] = np.pi / 2
    valid = np.ones(FRAMES, bool)
    valid[1] = False
    joints = body.joints(poses, np.zeros(10), trans)
    return Person("p0", body.identity, FPS, poses, trans, np.zeros(10), joints, valid, np.zeros((FRAMES, 24)), True)


def painted(canvas: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    return (np.abs(canvas.astype(int) - colour) < 30).all(axis=-1)


def at(camera: Camera, point_m: np.ndarray) -> tuple[int, int]:
    x, y = camera.project(point_m)[0]
    return int(y), int(x)


def test_the_skeleton_lies_on_the_joints_and_filled_frames_are_thinner(person: Person) -> None:
    grey = np.full((200, 320, 3), 90, np.uint8)
    solid, filled = (painted(overlay.draw_frame(grey, f, CAMERA, [person], None, {}), person_colour(0)) for f in (0, 1))
    for joint in (4, 5, 18, 19):
        assert solid[at(CAMERA, person.joints[0, joint])]
    assert 0.3 * solid.sum() < filled.sum() < 0.8 * solid.sum()
    assert (grey == 90).all(), "the footage itself is left alone"


def test_a_body_behind_the_camera_is_not_drawn(person: Person) -> None:
    away = replace(person, joints=person.joints + np.array([10.0, 0, 0]))
    grey = np.full((200, 320, 3), 90, np.uint8)
    assert (overlay.draw_frame(grey, 0, CAMERA, [away], None, {}) == 90).all()


def test_dots_have_the_colour_of_their_owner(person: Person) -> None:
    points = np.zeros((2, 17, 3))
    points[0, :3] = [[20.5, 30.5, 0.9], [50.5, 30.5, 0.5], [300.5, 20.5, 0.0]]
    points[1, :1] = [[20.5, 150.5, 0.9]]
    seen = Detections("cam0", "coco17", np.array([0, 0]), np.array([3, 4]), points)
    drawn = overlay.draw_frame(
        np.zeros((200, 320, 3), np.uint8), 0, CAMERA, [person], seen, {("cam0", 3): "p0", ("cam0", 4): ""}
    )
    assert painted(drawn, person_colour(0))[30, 20]
    assert painted(drawn, person_colour(0))[30, 50]
    assert painted(drawn, NOBODY)[150, 20]
    assert not drawn[20, 300].any(), "a keypoint without confidence was not seen"


def test_the_film_has_every_frame(tmp_path: Path, root: Path, person: Person) -> None:
    write_scene(tmp_path, root, people=0)
    write_person(tmp_path / "people/p0.npz", person)
    seen = Detections("cam0", "coco17", np.zeros(0, int), np.zeros(0, int), np.zeros((0, 17, 3)))
    write_detections(tmp_path / "people/detections/cam0.npz", seen)
    write_identities(tmp_path / "people/identities.tsv", {})
    options = {
        "camera": "cam0",
        "model": tmp_path / "cameras/images.txt",
        "manifest": tmp_path / "capture/manifest.json",
        "video": tmp_path / "capture/cam0.mkv",
        "detections": [tmp_path / "people/detections/cam0.npz"],
        "identities": tmp_path / "people/identities.tsv",
        "fits": [tmp_path / "people/p0.npz"],
        "film": tmp_path / "people/overlay/cam0.mp4",
    }
    overlay.run(**options)
    film, footage = read_stack(options["film"]), read_stack(options["video"])
    assert film.shape == footage.shape
    changed = np.abs(film.astype(int) - footage).max(axis=-1) > 60
    assert all(20 < frame.sum() < 0.2 * frame.size for frame in changed)
    overlay.run(**{**options, "detections": []})
    np.testing.assert_array_equal(
        read_stack(options["film"]), film, err_msg="without keypoints there is nothing but the skeleton, as here"
    )
    short = replace(
        person,
        **{name: getattr(person, name)[:2] for name in ("poses", "trans", "joints", "valid", "present", "sigma")},
    )
    write_person(tmp_path / "people/p0.npz", short)
    with pytest.raises(UserError, match="it has 2 frames, the capture 6"):
        overlay.run(**options)
    write_person(tmp_path / "people/p0.npz", replace(person, poses=person.poses[:2]))
    with pytest.raises(UserError, match=r"p0\.npz .*trans .*T = 2"):
        overlay.run(**options)
    with pytest.raises(UserError, match="it has no camera cam9"):
        overlay.run(**{**options, "camera": "cam9"})


def test_a_person_who_is_away_has_no_skeleton(person: Person) -> None:
    late = replace(person, present=np.arange(FRAMES) >= 2)
    grey = np.full((200, 320, 3), 90, np.uint8)
    assert (overlay.draw_frame(grey, 1, CAMERA, [late], None, {}) == 90).all()
    np.testing.assert_array_equal(
        overlay.draw_frame(grey, 2, CAMERA, [late], None, {}), overlay.draw_frame(grey, 2, CAMERA, [person], None, {})
    )
