# SPDX-License-Identifier: Apache-2.0
"""What the room's floor says of calibrated cameras, and a refinement that neither tilts nor lifts it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from studiorecon.cameras import refine
from studiorecon.geometry.camera_motion import move_camera
from studiorecon.geometry.rotations import exp
from studiorecon.rig.calibrated import estimate_calibrated
from studiorecon.rig.room_picture import make_room_picture
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

from tests.defaults import loaded
from tests.made.cameras import detect, ring, walk
from tests.made.floors import between_deg, carpet, off, room

FRAMES = 40
PEOPLE = [walk([-1.2, -0.5, 0], [0.04, 0.02, 0], FRAMES), walk([1.1, 0.9, 0], [0, -0.04, 0], FRAMES, 2.0)]


def leant(cameras: list[Camera], degrees: float, lift_m: float) -> list[Camera]:
    """The same cameras in a world whose floor is tilted about x and lifted."""
    turn, up = exp(np.radians([degrees, 0.0, 0.0])), np.array([0, 0, lift_m])
    return [move_camera(c, c.camera_from_world[:3, :3] @ turn.T, turn @ c.centre_m + up) for c in cameras]


def small_ring() -> list[Camera]:
    """Four cameras of 640×352."""
    intrinsics = np.array([[500.0, 0, 320], [0, 500, 176], [0, 0, 1]])
    return [Camera(c.name, c.wh, intrinsics, c.camera_from_world) for c in ring(wh=(640, 352), height_m=1.8)]


def seen_askew(truth: list[Camera], seed: int, bias_px: float) -> list[Detections]:
    """Joints that lie beside themselves in every camera's own way: no number of frames averages that away."""
    found = []
    for v, d in enumerate(detect(truth, PEOPLE, 1.0, np.random.default_rng(seed))):
        points = d.keypoints.copy()
        points[..., :2] += bias_px * np.random.default_rng(100 * seed + v).normal(size=(points.shape[1], 2))
        found.append(replace(d, keypoints=points))
    return found


def test_a_carpet_puts_knocked_cameras_right_where_a_detector_errs_all_the_time() -> None:
    truth, settings = small_ring(), loaded(refine.Settings)
    seen, given = seen_askew(truth, 1, 1.5), off(truth, 1, 2.0, 0.1)
    rooms = [room(c, carpet(1), v) for v, c in enumerate(truth)]
    by_people, with_floor = (
        estimate_calibrated(
            given,
            seen,
            np.arange(FRAMES),
            settings.gate_m,
            settings.limits,
            settings.pose_error,
            lost=True,
            rooms=reported,
        )
        for reported in ((), rooms)
    )
    assert by_people is not None
    assert with_floor is not None
    left_deg, by_people_deg = between_deg(with_floor.cameras, truth), between_deg(by_people.cameras, truth)
    assert left_deg < 0.1 < 0.5 * by_people_deg, (left_deg, by_people_deg)
    assert with_floor.intervals.between_deg > left_deg


def test_pictures_of_other_rooms_move_no_camera() -> None:
    truth = small_ring()
    seen = detect(truth, PEOPLE, 1.0, np.random.default_rng(0))
    rooms = [room(c, carpet(10 + v), v) for v, c in enumerate(truth)]
    outcome = refine.decide(truth, [], seen, FRAMES, 30.0, True, loaded(refine.Settings), rooms)
    assert not outcome.report["refined"]
    assert all(np.array_equal(a.camera_from_world, b.camera_from_world) for a, b in zip(outcome.training, truth))


def test_a_floor_that_people_contradict_moves_no_camera() -> None:
    """What lies on it agrees among all cameras, as if these were turned; whoever walks on it shows that they are
    not."""
    truth = small_ring()
    seen = detect(truth, PEOPLE, 5.0, np.random.default_rng(0))
    rooms = [room(c, carpet(1), v) for v, c in enumerate(off(truth, 3, 0.25, 0.0))]
    outcome = refine.decide(truth, [], seen, FRAMES, 30.0, True, loaded(refine.Settings), rooms)
    assert outcome.report["room"]["places"] == 0
    assert all(np.array_equal(a.camera_from_world, b.camera_from_world) for a, b in zip(outcome.training, truth))


def test_cameras_that_were_all_knocked_stand_on_the_floor_under_people() -> None:
    """Their mean leans by a degree; nothing but feet shows it."""
    truth, settings = small_ring(), loaded(refine.Settings)
    given = off(leant(truth, 1.0, 0.05), 3, 2.0, 0.1)
    seen = detect(truth, PEOPLE, 1.0, np.random.default_rng(0))
    found = estimate_calibrated(
        given, seen, np.arange(FRAMES), settings.gate_m, settings.limits, settings.pose_error, lost=True
    )
    assert found is not None
    assert found.freedom == "moved"
    turned = [a.camera_from_world[:3, :3].T @ b.camera_from_world[:3, :3] for a, b in zip(found.cameras, truth)]
    assert max(np.degrees(np.arccos(t[2, 2])) for t in turned) < 0.5
    assert max(abs(a.centre_m[2] - b.centre_m[2]) for a, b in zip(found.cameras, truth)) < 0.05


def test_a_plate_shows_the_room_where_it_was_measured(tmp_path: Path) -> None:
    picture = np.full((20, 30, 4), 255, np.uint8)
    picture[:, 10:, :3] = 51
    picture[:5, :, 3] = 0
    cv2.imwrite(str(tmp_path / "cam.1.png"), picture)
    shown = make_room_picture(tmp_path / "cam.1.png")
    assert shown.grey[10, 5] == 255
    assert shown.grey[10, 20] == 51
    assert shown.known[5:].all()
    assert not shown.known[:5].any()
