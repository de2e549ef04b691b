# SPDX-License-Identifier: Apache-2.0
"""The doctor: what it says about good, perturbed and badly synchronised captures."""

from __future__ import annotations

import copy
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from studiorecon.calibration import doctor
from studiorecon.calibration.checks import coverage as health
from studiorecon.calibration.checks import doctor_page
from studiorecon.calibration.checks.advice import verdict
from studiorecon.configuration import settings as settings_module
from studiorecon.geometry.camera_motion import move_camera
from studiorecon.geometry.rotations import exp
from studiorecon.scene.camera import Camera
from studiorecon.scene.clocks import Clock, ClockFinding, Clocks

from tests.made.cameras import detect, ring, walk

FRAMES = 32
PEOPLE = [walk([-0.6, -0.5, 0], [0.02, 0, 0], FRAMES), walk([0.7, 0.6, 0], [0, -0.02, 0], FRAMES, 2.0)]


@pytest.fixture
def options(default_settings):
    return settings_module.load(doctor.Settings, default_settings("cameras"), "cameras")


def about(cameras: list[Camera], **changed) -> list[dict]:
    facts = {"frames": FRAMES, "first_frame": 5.0, "keypoints": True}
    base = {**facts, "video_frames": FRAMES, "fps": 30.0, "rotation_deg": 0, "brightness": 0.4, "burnt": 0.0}
    return [{**base, "camera": c.name, "wh": list(c.wh), **changed.get(c.name, {})} for c in cameras]


def examined(given: list[Camera], options, **changed) -> dict:
    seen = detect(ring(), PEOPLE, 1.5, np.random.default_rng(0))
    return doctor.examine(given, seen, about(given, **changed), options)[0]


@pytest.fixture(scope="module")
def good(default_settings) -> dict:
    """What the doctor says of a capture without faults."""
    return examined(ring(), settings_module.load(doctor.Settings, default_settings("cameras"), "cameras"))


def test_a_good_capture_needs_nothing(good):
    report = good
    assert report["advice"] == []
    assert report["median_px"] < 3
    assert report["coverage"]["1"] >= report["coverage"]["2"] >= report["coverage"]["4"] > 0.5
    html = doctor_page.page("<scene>", report, b"png")
    assert "&lt;scene&gt;" in html
    assert "http" not in html


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: replace(c, camera_from_world=np.linalg.inv(c.camera_from_world)), "world_from_camera"),
        (lambda c: replace(c, camera_from_world=np.diag([1.0, -1, -1, 1]) @ c.camera_from_world), "opengl"),
        (lambda c: replace(c, camera_from_world=c.camera_from_world * np.array([[1, 1, 1, 1000.0]])), "unit: mm"),
    ],
    ids=["w2c that is c2w", "OpenGL axes", "mm for m"],
)
def test_every_wrong_convention_is_named_with_its_setting(options, change, words):
    assert words in " ".join(examined([change(c) for c in ring()], options)["advice"])


@pytest.mark.parametrize(("close", "name"), [(False, "good"), (True, "cannot tell")])
def test_another_reading_rivals_only_if_people_agree_about_as_well(good, close, name):
    report = copy.deepcopy(good)
    rival = {"hypothesis": "poses are world-from-camera", "score": 0.9, "close": close, "remedy": ""}
    report["hypotheses"] = [report["hypotheses"][0], rival]
    assert verdict(report, 100.0)[0] == name


def test_one_inverted_camera_is_named_with_its_cause(options):
    cameras = ring()
    cameras[2] = replace(cameras[2], camera_from_world=np.linalg.inv(cameras[2].camera_from_world))
    report = examined(cameras, options)
    assert report["verdict"] == "wrong"
    assert "c2" in report["advice"][0]
    assert "world-from-camera" in report["advice"][0]


def test_swapped_cameras_are_named(options):
    """Opposite ones, which is nearly a mirror image; test_cameras swaps neighbours too."""
    cameras = ring()
    for i, j in ((1, 3), (3, 1)):
        cameras[i] = replace(cameras[i], camera_from_world=ring()[j].camera_from_world)
    report = examined(cameras, options)
    assert report["verdict"] == "wrong"
    assert "cameras c1 and c3 are swapped" in " ".join(report["advice"])


def test_a_held_out_camera_without_keypoints_is_no_fault(options):
    cameras = ring(5)
    seen = [*detect(cameras, PEOPLE, 1.5, np.random.default_rng(0))[:4], doctor.empty_detections("c4")]
    report = doctor.examine(cameras, seen, about(cameras, c4={"keypoints": False}), options)[0]
    assert report["verdict"] == "good"
    assert ["c4 has no keypoints" in a for a in report["advice"]] == [True]


def started(advice: str) -> dict[str, float]:
    """What a sentence says to write as starts."""
    return yaml.safe_load(re.search(r"starts: (\{.*?\})", advice)[1])


@pytest.mark.parametrize(
    ("frames", "late"),
    [
        ([0, 0.3, -0.2, None], {}),
        ([0, 3, 0, None], {"c1": 3}),
        ([3, 0, 0, 0], {"c0": 3}),
        ([0, -2, 11, 0], {"c1": -2, "c2": 11}),
    ],
    ids=["within half a frame", "one camera", "the reference", "two cameras"],
)
def test_what_people_say_against_the_clocks_in_use_is_named_with_all_starts(good, frames, late):
    used = Clocks(30.0, 0.1, FRAMES, tuple(Clock(f"c{k}", 30.0, 99, offset_s=0.1 * k) for k in range(4)))
    found = [ClockFinding(f"c{k}", "", None if f is None else (0.1 * k - f / 30, 0.01)) for k, f in enumerate(frames)]
    report = copy.deepcopy(good)
    report["sync"]["lags_frames"] = doctor.lags_frames(found, used)
    advice = verdict(report, 100.0)[1]
    assert len(advice) == bool(late)
    for camera, count in late.items():
        assert f"camera {camera} is {count:+.1f} frames late" in advice[0]
    if late:
        starts = started(advice[0])
        ahead = {c: start - starts["c3"] for c, start in starts.items()}
        assert ahead == pytest.approx({f"c{k}": late.get(f"c{k}", 0) for k in range(4)}, abs=0.01)


@pytest.mark.parametrize(("radius_m", "refused"), [(1.1, False), (4.0, True)])
def test_an_error_of_pixels_counts_by_its_metres_near_the_cameras(options, radius_m, refused):
    """16 px are 2 cm at 1 m, which detectors differ by from view to view, and 8 cm at 4 m."""
    cameras = ring(4, radius_m, 1.2)
    seen = detect(cameras, [walk(np.zeros(3), np.array([0.002, 0.001, 0]), FRAMES)], 20, np.random.default_rng(0))
    report = doctor.examine(cameras, seen, about(cameras), options)[0]
    assert report["median_px"] > 0.01 * 1280
    assert any("px are allowed" in sentence for sentence in report["advice"]) == refused


def test_unequal_footage_and_exposures_are_reported(options):
    advice = examined(ring(), options, c1={"video_frames": 20, "fps": 25.0, "brightness": 0.1})["advice"]
    assert [w for w in ("frame rates", "exposures") if not any(w in a for a in advice)] == []


def test_what_was_found_about_clocks_comes_first(options):
    """And what the footage would be refused for is the first thing to mend."""
    sync = {
        "sentences": ["c1: started 7.000 ± 0.009 s (210.00 frames) after c0"],
        "refusal": "videos/c2.mp4 has 40 frames and …",
        "lags_frames": {},
    }
    seen = detect(ring(), PEOPLE, 1.5, np.random.default_rng(0))
    report = doctor.examine(ring(), seen, about(ring()), options, sync=sync)[0]
    assert (report["verdict"], report["advice"][0]) == ("check", sync["refusal"])
    html = doctor_page.page("scene", report, b"png")
    assert html.index("210.00 frames") < html.index("What to check")


def test_blind_sectors_and_coverage():
    gaps = health.blind_sectors(ring(4)[:2], np.zeros(2))
    assert gaps == [(90.0, 360.0)]
    assert health.coverage(ring(4), np.zeros(2), 0.8)[3] > 0.9
    assert health.coverage(ring(4)[:1], np.zeros(2), 0.8)[1] == 0


def off(camera: Camera, degrees: float, metres: float) -> Camera:
    turn = exp(np.radians([0.0, degrees, 0.0]))
    return move_camera(camera, turn @ camera.camera_from_world[:3, :3], camera.centre_m + np.array([0.0, 0.0, metres]))


def test_what_people_leave_open_is_reported_where_it_is_much(good):
    report = copy.deepcopy(good)
    assert 0 < report["refined"]["disagreement_deg"] < report["refined"]["between_deg"] < 3
    # As a real man on one spot leaves it.
    report["refined"] |= {"disagreement_deg": 3.9, "between_deg": 3.4}
    name, sentences = verdict(report, 12.8)
    assert name == "good", "nothing speaks against the calibration"
    assert any("a calibration that is off by up to 7.3° fits these people" in sentence for sentence in sentences)


def test_a_camera_that_was_knocked_is_usable_and_its_move_is_named(options):
    report = examined([*ring()[:2], off(ring()[2], 1.0, 0.05), ring()[3]], options)
    assert report["verdict"] == "usable"
    assert re.search(r"mm at their distance\).*c2 by [01]\.\d° and \d+ cm", report["advice"][0]), report["advice"]


def test_a_calibration_that_is_degrees_old_is_usable_when_people_say_where_the_cameras_are(options):
    report = examined(
        [off(c, d, m) for c, d, m in zip(ring(), (3.0, -2.5, 2.0, -3.5), (0.2, -0.3, 0.1, 0.15))], options
    )
    assert report["verdict"] == "usable", report["advice"]
    assert report["refined"]["elsewhere"]
