# SPDX-License-Identifier: Apache-2.0
"""The doctor and the room's straight edges: calibrations that people accept, and edges that contradict them or not."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.calibration import choose, doctor, files
from studiorecon.calibration.checks import doctor_page
from studiorecon.calibration.checks.advice import verdict
from studiorecon.clocks import moments, offsets
from studiorecon.detect import keypoints
from studiorecon.plan.discovery import open_dataset
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera
from studiorecon.tracks import keypoints as tracks_keypoints

from tests.defaults import UNSEARCHED, loaded
from tests.made.cameras import detect, ring, walk
from tests.made.edges import about_the_spot, drawn

FRAMES = 30
ON_ONE_SPOT = [walk([0.0, 0.0, 0.0], [0.002, 0.0, 0.0], FRAMES)]
WALKING = [walk([-1.2, -0.5, 0], [0.08, 0.03, 0], FRAMES), walk([1.1, 0.9, 0], [0, -0.06, 0], FRAMES, 2.0)]
OFF_DEG = [1.5, -1.5, 1.2, -0.8]
NO_ROOM: list[RoomPicture | None] = []


def examined(
    given: Sequence[Camera], rooms: Sequence[RoomPicture | None], people: Sequence[Any] = ON_ONE_SPOT, px: float = 6.0
) -> dict[str, Any]:
    """What the doctor says of ``given`` cameras, where ``ring()``'s filmed people."""
    seen = detect(ring(), list(people), px, np.random.default_rng(2))[: len(given)]
    return doctor.examine(given, seen, about(given), loaded(doctor.Settings), rooms=rooms)[0]


@cache
def contradicted(pictures: bool) -> dict[str, Any]:
    """What the doctor says of cameras that people accept and the room's edges contradict, with and without pictures."""
    return examined(about_the_spot(ring(), OFF_DEG), pictured(ring()) if pictures else NO_ROOM)


def about(cameras: Sequence[Camera]) -> list[dict[str, Any]]:
    facts = {"frames": FRAMES, "first_frame": 0.0, "keypoints": True, "video_frames": FRAMES, "fps": 30.0}
    light = {"rotation_deg": 0, "brightness": 0.4, "burnt": 0.0}
    return [{**facts, **light, "camera": c.name, "wh": list(c.wh)} for c in cameras]


def pictured(cameras: Sequence[Camera], clutter: float = 0.2) -> list[RoomPicture | None]:
    return [drawn(c, v, clutter) for v, c in enumerate(cameras)]


def of_edges(report: dict[str, Any]) -> list[str]:
    return [sentence for sentence in report["advice"] if "straight edges" in sentence]


def test_a_calibration_that_people_accept_and_edges_contradict_is_usable_and_reported() -> None:
    people_alone, report = contradicted(False), contradicted(True)
    assert people_alone["verdict"] == "good", people_alone["advice"]
    assert people_alone["edges"] is None
    assert report["verdict"] == "usable", report["advice"]
    assert report["edges"]["off_deg"] > 1.5 > report["edges"]["after_deg"]
    (messages,) = of_edges(report)
    first, second = report["edges"]["cameras"]
    assert f"between cameras {first} and {second} by {report['edges']['off_deg']:.1f}°" in messages
    assert f"by {report['edges']['after_deg']:.1f}° once refinement has moved the cameras" in messages
    assert "with cameras.refine on; calibrate again if that is not enough" in messages
    assert "px" not in messages
    page = doctor_page.page("scene", report, b"png")
    assert page.count("straight edges contradict") == 1


def test_a_calibration_that_is_right_stays_good() -> None:
    report = examined(ring(), pictured(ring()))
    assert (report["verdict"], of_edges(report)) == ("good", [])
    assert report["edges"]["off_deg"] < 1
    assert "straight edges agree with the calibration" in doctor_page.page("scene", report, b"png")


def test_edges_that_run_anywhere_change_nothing_and_that_is_said() -> None:
    given = about_the_spot(ring(), OFF_DEG)
    people_alone, report = contradicted(False), examined(given, pictured(ring(), clutter=1.0))
    assert (report["verdict"], report["advice"]) == (people_alone["verdict"], people_alone["advice"])
    assert "straight edges do not constrain" in doctor_page.page("scene", report, b"png")


def test_edges_of_one_camera_alone_say_nothing_of_two() -> None:
    report = examined(about_the_spot(ring(), OFF_DEG), [pictured(ring())[0], None, None, None])
    assert report["edges"] == {"comparable": False, "clear": False}


@pytest.mark.parametrize(("askew_deg", "named"), [(2.5, "check"), (6.0, "cannot tell")])
def test_furniture_askew_that_people_contradict_is_not_mended(askew_deg: float, named: str) -> None:
    """Past some degrees nobody can say who is right."""
    rooms = pictured(about_the_spot(ring(), [0.0, askew_deg, 0.0, 0.0]))
    report = examined(ring(), rooms, WALKING, 1.0)
    assert report["verdict"] == named, report["advice"]
    assert not report["edges"]["mended"]
    (messages,) = of_edges(report)
    assert "refinement does not correct that; check" in messages
    assert "let a person walk through the whole room" in messages


def test_people_s_refinement_that_takes_the_contradiction_away_counts() -> None:
    """Cameras that were turned where they stand: people put them right, and the edges agree then."""
    report = examined(about_the_spot(ring(), [0.0, 3.0, 0.0, 0.0]), pictured(ring()), WALKING, 1.0)
    assert report["verdict"] == "usable"
    assert report["edges"]["clear"]
    assert report["edges"]["mended"]
    assert report["edges"]["after_deg"] < 1


def test_of_a_calibration_that_is_wrong_anyway_edges_say_nothing() -> None:
    wrong = [replace(c, camera_from_world=np.linalg.inv(c.camera_from_world)) for c in ring()]
    report = examined(wrong, pictured(ring()), WALKING, 1.0)
    assert report["verdict"] == "wrong"
    assert of_edges(report) == []
    assert verdict({**report, "edges": contradicted(True)["edges"]}, 100.0)[1] == report["advice"]


def test_a_camera_that_only_judges_takes_no_part() -> None:
    """It sees nobody and its room is not looked at: neither moved nor counted in how well the others are known."""
    given = about_the_spot(ring(), OFF_DEG)
    alone = contradicted(True)["edges"]
    held_out = replace(ring(5)[4], name="view")
    seen = [*detect(ring(), ON_ONE_SPOT, 6.0, np.random.default_rng(2)), doctor.empty_detections("view")]
    rooms = [*pictured(ring()), None]
    scored = doctor.examine([*given, held_out], seen, about([*given, held_out]), loaded(doctor.Settings), rooms=rooms)
    assert scored[0]["edges"]["moves"].keys() == alone["moves"].keys()
    assert scored[0]["edges"]["between_deg"] < 1.2 * alone["between_deg"]
    assert scored[0]["edges"]["mended"]


def test_two_cameras_are_distinguished_by_edges_too() -> None:
    """Two cameras have no third one that people could refine them on; edges and people move them all the same."""
    report = examined(about_the_spot(ring(), OFF_DEG)[:2], pictured(ring())[:2])
    assert report["edges"]["clear"]
    assert report["edges"]["off_deg"] > 1.5
    assert of_edges(report)


# Cheaper: test_a_calibration_that_is_right_stays_good, and one that people accept and edges contradict.
@pytest.mark.slow
@pytest.mark.real
@pytest.mark.parametrize(
    ("file", "clear", "off_deg"),
    [("Calib.qca.txt", False, (0.0, 1.2)), ("Calib_scene.toml", True, (1.8, 3.4))],
)
def test_of_a_real_man_s_two_calibrations_edges_contradict_the_hand_picked_one(
    real_data: Path, root: Path, tmp_path: Path, file: str, clear: bool, off_deg: tuple[float, float]
) -> None:
    """One is a motion-capture system's, the other 3.4° off it; the man's keypoints accept both."""
    take = real_data / "pose2sim_balancing"
    dataset = open_dataset(take / "single", root / "tests/captures/pose2sim_single.yaml")
    names, out = list(dataset.cameras), tmp_path
    maps = json.dumps(dict(dataset.pixel_maps))
    calibrated = out / "calibration.json"
    files.run(loaded(files.Settings), [take / "calibration" / file], names, out / "read.json")
    footage = [dataset.footage[c] for c in names]
    choose.run(loaded(choose.Settings), out / "read.json", names, footage, [], maps, 60.0, [], calibrated)
    for c in names:
        first = str(dataset.keypoint_first_frame.get(c, "auto"))
        recorded = dataset.keypoint_layout, first, dataset.footage[c], 60.0
        reported = json.dumps(dataset.pixel_maps[c])
        found = out / f"{c}.npz", out / f"{c}.recorded.npz", out / f"{c}.json", [], []
        keypoints.run(loaded(tracks_keypoints.Settings), c, [dataset.keypoints[c]], *recorded, reported, *found)
    seen = [out / f"{c}.npz" for c in names]
    clocks = out / "clocks.json", out / "sync.json"
    lags = out / "lags.json"
    take = offsets.Take(names, footage)
    moments.run(loaded(offsets.Settings), take, 0, lags, *UNSEARCHED)
    offsets.run(loaded(offsets.Settings), take, seen, lags, *clocks)
    sizes, written = [out / f"{c}.json" for c in names], (out / "doctor.json", out / "doctor.html")
    doctor.run(loaded(doctor.Settings), "single", calibrated, names, footage, seen, sizes, *clocks, *written)
    report = json.loads(written[0].read_text())
    assert report["edges"]["clear"] == clear
    assert off_deg[0] <= report["edges"]["off_deg"] <= off_deg[1]
    assert report["verdict"] == "usable", report["advice"]
    assert len(of_edges(report)) == clear
