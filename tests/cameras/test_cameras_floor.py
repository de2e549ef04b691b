# SPDX-License-Identifier: Apache-2.0
"""What the room's floor says of calibrated cameras, and a refinement that neither tilts nor lifts it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.cameras import refine
from studiorecon.geometry.bundle import move_camera
from studiorecon.geometry.rotations import angle, exp
from studiorecon.rig.correspondences import make_observations
from studiorecon.rig.floor_alignment import align_to_floor, fit_floor, floor_under_feet
from studiorecon.rig.moved_cameras import refine_with_wider_prior
from studiorecon.rig.room_picture import make_room_picture
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

from tests.defaults import loaded
from tests.made.cameras import LIMITS, detect, ring, walk
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
        refine_with_wider_prior(
            given, seen, np.arange(FRAMES), settings.gate_m, settings.limits, settings.bundle, lost=True, rooms=reported
        )
        for reported in ((), rooms)
    )
    assert by_people is not None
    assert with_floor is not None
    left_deg, by_people_deg = between_deg(with_floor.cameras, truth), between_deg(by_people.cameras, truth)
    assert left_deg < 0.1 < 0.5 * by_people_deg, (left_deg, by_people_deg)
    assert max(with_floor.report["sigma_deg"].values()) > left_deg / 2


def test_pictures_of_other_rooms_move_no_camera() -> None:
    truth = small_ring()
    seen = detect(truth, PEOPLE, 1.0, np.random.default_rng(0))
    rooms = [room(c, carpet(10 + v), v) for v, c in enumerate(truth)]
    outcome = refine.decide(truth, [], seen, FRAMES, 30.0, True, loaded(refine.Settings), rooms)
    assert not outcome.report["refined"]
    assert all(np.array_equal(a.camera_from_world, b.camera_from_world) for a, b in zip(outcome.training, truth))


def test_a_floor_that_people_contradict_moves_no_camera(capsys: pytest.CaptureFixture[str]) -> None:
    """What lies on it agrees among all cameras, as if these were turned; whoever walks on it shows that they are
    not."""
    truth = small_ring()
    seen = detect(truth, PEOPLE, 5.0, np.random.default_rng(0))
    rooms = [room(c, carpet(1), v) for v, c in enumerate(off(truth, 3, 0.25, 0.0))]
    outcome = refine.decide(truth, [], seen, FRAMES, 30.0, True, loaded(refine.Settings), rooms)
    assert outcome.report["room"]["off_sigmas_before"] > 2, "or nothing is asked"
    assert not outcome.report["room"]["believed"]
    assert all(np.array_equal(a.camera_from_world, b.camera_from_world) for a, b in zip(outcome.training, truth))
    assert "and people's keypoints" in capsys.readouterr().out


@pytest.mark.parametrize(("degrees", "lift_m"), [(1.0, 0.05), (-0.4, 0.0), (0.0, -0.03)])
def test_a_world_that_was_tilted_and_lifted_is_put_back(degrees: float, lift_m: float) -> None:
    rng = np.random.default_rng(0)
    before_m = rng.uniform([-2, -2, 0], [2, 2, 1.8], (400, 3))
    turn = exp(np.radians([degrees, 0.0, 0.0]))
    risen_m = before_m @ turn.T + [0, 0, lift_m] + rng.normal(0, 0.01, before_m.shape)
    floor = fit_floor(before_m, risen_m[:, 2] - before_m[:, 2])
    assert floor is not None
    cameras = ring()
    back, tilt_deg, _ = align_to_floor(leant(cameras, degrees, lift_m), floor, np.zeros(2))
    assert tilt_deg == pytest.approx(abs(degrees), abs=0.1)
    for camera, true in zip(back, cameras):
        assert np.degrees(angle(camera.camera_from_world[:3, :3], true.camera_from_world[:3, :3])) < 0.1
        assert np.abs(camera.centre_m - true.centre_m).max() < 0.012


def test_a_floor_that_stayed_keeps_the_cameras() -> None:
    rng = np.random.default_rng(1)
    points_m = rng.uniform(-2, 2, (400, 3))
    floor = fit_floor(points_m, rng.normal(0, 0.01, 400))
    assert floor is not None
    assert align_to_floor(ring(), floor, np.zeros(2))[1:] == (0.0, 0.0)


def test_feet_that_rise_on_one_spot_tilt_no_world() -> None:
    """Somebody who balances: the higher the foot, the further to the side, however sure the detector is."""
    across = np.linspace(-0.15, 0.15, 80)
    points = np.column_stack([across, np.tile([0.02, -0.02], 40), 0.9 * across])
    floor = fit_floor(points, points[:, 2])
    assert floor is not None
    assert floor.tilt_deg > 40
    back, tilt_deg, _ = align_to_floor(ring(), floor, np.zeros(2))
    assert tilt_deg == 0.0
    for camera, before in zip(back, ring()):
        np.testing.assert_allclose(camera.camera_from_world[:3, :3], before.camera_from_world[:3, :3], atol=1e-12)


def test_somebody_on_a_platform_lifts_no_world() -> None:
    rng = np.random.default_rng(3)
    points_m = rng.uniform(-1, 1, (400, 3))
    floor = fit_floor(points_m, 0.44 + rng.normal(0, 0.005, 400))
    assert floor is not None
    assert align_to_floor(ring(), floor, np.zeros(2))[1:] == (0.0, 0.0)


def test_one_spot_shows_no_slope_and_too_few_points_no_floor() -> None:
    rng = np.random.default_rng(2)
    points_m = np.tile([0.4, 0.2, 0.0], (100, 1)) + rng.normal(0, 1e-4, (100, 3))
    floor = fit_floor(points_m, np.full(100, 0.02) + rng.normal(0, 1e-3, 100))
    assert floor is not None
    assert floor.tilt_deg < 0.2
    assert fit_floor(points_m[:20], np.zeros(20)) is None


def test_feet_and_marks_tell_the_floor_that_people_stand_on() -> None:
    cameras = leant(ring(), 2.0, 0.0)
    seen, _ = make_observations(
        detect(cameras, PEOPLE, 0.5, np.random.default_rng(3)), cameras, np.arange(FRAMES), 0.25
    )
    rng = np.random.default_rng(4)
    marks_m = np.column_stack([rng.uniform(-2, 2, (300, 2)), np.zeros(300)]) @ exp(np.radians([2.0, 0, 0])).T
    floor = floor_under_feet(cameras, seen, marks_m, LIMITS)
    assert floor is not None
    assert floor[0].tilt_deg == pytest.approx(2.0, abs=0.1)
    assert floor_under_feet(cameras, seen.of(np.zeros(len(seen.frame), bool)), marks_m, LIMITS) is None


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
