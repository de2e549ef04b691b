# SPDX-License-Identifier: Apache-2.0
"""Turns of cameras from the straight edges of a room: planted rooms, clutter, and what must not be believed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.body.model import BodyModel
from studiorecon.calibration import from_people
from studiorecon.calibration.room_pictures import read_room_pictures
from studiorecon.geometry.camera_motion import move_camera
from studiorecon.geometry.rotations import angle, exp
from studiorecon.rig.room_turns import room_turns, straight_edges
from studiorecon.scene.camera import Camera

from tests.defaults import loaded
from tests.made.cameras import ring
from tests.made.edges import edges_in
from tests.made.take import made_take


def turned(camera: Camera, axis: np.ndarray, degrees: float) -> Camera:
    rotation = exp(np.radians(degrees) * axis / np.linalg.norm(axis)) @ camera.camera_from_world[:3, :3]
    return move_camera(camera, rotation, camera.centre_m)


def worst_deg(rotations: dict[int, np.ndarray], truth: list[Camera]) -> float:
    true = [c.camera_from_world[:3, :3] for c in truth]
    pairs = [(a, b) for a in rotations for b in rotations if a < b]
    return max(float(np.degrees(angle(rotations[a] @ rotations[b].T, true[a] @ true[b].T))) for a, b in pairs)


@pytest.mark.parametrize("seed", range(4))
def test_edges_turn_cameras_that_people_left_degrees_off(seed: int) -> None:
    truth, rng = ring(), np.random.default_rng(seed)
    start = {v: turned(c, rng.normal(size=3), rng.uniform(2, 4)) for v, c in enumerate(truth)}
    before = worst_deg({v: c.camera_from_world[:3, :3] for v, c in start.items()}, truth)
    found = room_turns(start, {v: edges_in(c, 10 * seed + v) for v, c in enumerate(truth)})
    assert sorted(found) == [0, 1, 2, 3]
    after = worst_deg({v: t.rotation_camera_from_world for v, t in found.items()}, truth)
    assert before > 1.5
    assert after < 0.4
    assert after < 3 * np.sqrt(2) * max(t.sigma_deg for t in found.values())
    assert max(t.sigma_deg for t in found.values()) < 1.0


def test_edges_that_run_anywhere_say_nothing() -> None:
    cameras = dict(enumerate(ring()))
    assert room_turns(cameras, {v: edges_in(c, v, clutter=1.0) for v, c in cameras.items()}) == {}


def test_a_camera_that_sees_edges_along_one_direction_only_is_left_as_it_is() -> None:
    cameras = dict(enumerate(ring()))
    edges = {v: edges_in(c, v, clutter=0.1, only=2 if v == 1 else -1) for v, c in cameras.items()}
    assert sorted(room_turns(cameras, edges)) == [0, 2, 3]


def test_a_camera_that_stands_further_off_than_people_can_be_is_not_bent_to_the_room() -> None:
    truth = ring()
    start = dict(enumerate(truth)) | {2: turned(truth[2], np.array([0.2, 1.0, 0.1]), 20.0)}
    found = room_turns(start, {v: edges_in(c, v) for v, c in enumerate(truth)})
    assert sorted(found) == [0, 1, 3]


def test_one_camera_s_edges_say_nothing_about_two_cameras() -> None:
    cameras = dict(enumerate(ring()))
    assert room_turns(cameras, {0: edges_in(cameras[0], 0)}) == {}


def test_the_order_of_edges_and_their_ends_does_not_matter() -> None:
    cameras = dict(enumerate(ring()))
    edges = {v: edges_in(c, v) for v, c in cameras.items()}
    shuffled = {v: e[np.random.default_rng(v).permutation(len(e))][:, [2, 3, 0, 1]] for v, e in edges.items()}
    first, second = room_turns(cameras, edges), room_turns(cameras, shuffled)
    for v in cameras:
        ours, theirs = (t[v].rotation_camera_from_world for t in (first, second))
        assert np.degrees(angle(ours, theirs)) < 1e-3


def test_edges_of_another_shape_are_refused() -> None:
    cameras = dict(enumerate(ring()))
    with pytest.raises(ValueError, match="edges"):
        room_turns(cameras, {v: np.zeros((5, 3)) for v in cameras})


def test_a_detector_that_always_errs_the_same_way_is_put_right_by_the_room(root: Path) -> None:
    """The same few pixels off in every frame, joint by joint and view by view: people leave degrees, the room does
    not."""
    truth, detections = made_take(frames=40, people=1, still=True, occluded=False)
    rng = np.random.default_rng(3)
    shifts = [
        np.column_stack([rng.normal(0, 8.0, (d.keypoints.shape[1], 2)), np.zeros(d.keypoints.shape[1])])
        for d in detections
    ]
    biased = [replace(d, keypoints=d.keypoints + s) for d, s in zip(detections, shifts)]
    edges = {c.name: edges_in(c, v) for v, c in enumerate(truth)}
    template, settings = (
        from_people.mean_body(BodyModel.load(root / "resources/body.npz")),
        loaded(from_people.Settings),
    )
    focal, off = {c.name: c.focal_px[0] for c in truth}, {}
    for name, reported in (("people", {}), ("room", edges)):
        found, report = from_people.pose_cameras(
            biased, [c.wh for c in truth], focal, 40, template, settings, edges=reported
        )
        off[name] = worst_deg({v: c.camera_from_world[:3, :3] for v, c in enumerate(found)}, truth)
        assert off[name] < report["between_deg"]
        assert set(report["along_edges"]) == set(reported)
    assert off["people"] > 1.5
    # A room is square to 0.4°, and the detector errs by 8 px in every frame.
    assert off["room"] < 0.8


def test_edges_of_footage_are_those_of_the_empty_room(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "cam"
    folder.mkdir()
    for k in range(9):
        picture = np.full((240, 320, 3), 90, np.uint8)
        cv2.rectangle(picture, (60, 40), (260, 200), (200, 200, 200), -1)
        cv2.line(picture, (20 + 30 * k, 10), (50 + 30 * k, 230), (0, 0, 0), 9)
        cv2.imwrite(str(folder / f"{k:03}.png"), picture)
    size = {"cam": (320, 240), "gone": (320, 240)}
    rooms = read_room_pictures(["cam", "gone"], [folder, tmp_path / "gone.mp4"], size)
    found = {name: straight_edges(room.grey) for name, room in rooms.items()}
    assert list(found) == ["cam"]
    assert "gone" in capsys.readouterr().out
    ends = found["cam"].reshape(-1, 2, 2)
    ways = np.abs(ends[:, 1] - ends[:, 0])
    assert len(ends) >= 4
    assert (ways.min(1) < 2).all(), "what passes through is no edge of the room"
    assert ways.max() == pytest.approx(200, abs=6)
    hidden = rooms["cam"].known.copy()
    hidden[:, :150] = False
    beside = replace(rooms["cam"], known=hidden)
    assert beside.edges_px[:, [0, 2]].min() > 150, "where nobody knows the room it has no edges"
    assert np.array_equal(beside.edges_px, straight_edges(beside.grey, beside.known))
    assert beside.edges_px is beside.edges_px, "they are found once"


@pytest.mark.parametrize("count", [1, 4, 7])
def test_the_room_is_the_median_of_its_pictures(tmp_path: Path, count: int) -> None:
    """And known where half of the pictures are within 12 levels of it; of two in the middle their mean counts."""
    grey = np.random.default_rng(0).integers(0, 256, (count, 24, 32), dtype=np.uint8)
    for k, picture in enumerate(grey):
        cv2.imwrite(str(tmp_path / f"{k:03}.png"), picture)
    room = read_room_pictures(["cam"], [tmp_path], {"cam": (32, 24)})["cam"]
    median = np.median(grey, axis=0).astype(np.uint8)
    np.testing.assert_array_equal(room.grey, median)
    beside = np.abs(grey.astype(int) - median)
    np.testing.assert_array_equal(room.known, np.median(beside, axis=0) < 12)


def test_a_bare_picture_has_no_edges() -> None:
    assert straight_edges(np.full((50, 60), 128, np.uint8)).shape == (0, 4)
    with pytest.raises(ValueError, match="grey"):
        straight_edges(np.zeros((4, 4, 3), np.uint8))
