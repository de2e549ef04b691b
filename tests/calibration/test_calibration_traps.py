# SPDX-License-Identifier: Apache-2.0
"""What real captures do to their reader: every trap on disk, from the dataset folder to the doctor's verdict."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from studiorecon.calibration import doctor
from studiorecon.calibration import files as calibration
from studiorecon.clocks import moments
from studiorecon.clocks import offsets as clocks
from studiorecon.configuration import settings as settings_module
from studiorecon.detect import keypoints as sightings
from studiorecon.errors import UserError
from studiorecon.plan.discovery import open_dataset
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import read_json
from studiorecon.tracks import keypoints as tracks_keypoints

from tests.defaults import UNSEARCHED
from tests.made.cameras import detect, ring, walk
from tests.made.cameras_parts import matrix, write_toml
from tests.made.imported import imported

FRAMES = 48
PEOPLE = [walk([-0.6, -0.5, 0], [0.03, 0, 0], FRAMES), walk([0.7, 0.6, 0], [0, -0.03, 0], FRAMES, 2.0)]
NAMES = ("00", "01", "02", "10")


def cameras() -> list[Camera]:
    return [replace(c, name=n) for c, n in zip(ring(), NAMES)]


def write_calibration(
    folder: Path, given: list[Camera], quote: str = '"', scale: float = 1.0, unit: float = 1.0
) -> None:
    """``intri.yml`` and ``extri.yml`` without distortion; ``scale`` goes into the rotation block, as similarity
    pipelines leave it."""
    intri = extri = "%YAML:1.0\n---\nnames:\n" + "".join(f"   - {quote}{c.name}{quote}\n" for c in given)
    for c in given:
        intri += matrix(f"K_{c.name}", c.intrinsics - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]) + matrix(
            f"dist_{c.name}", np.zeros((1, 5))
        )
        extri += matrix(f"Rot_{c.name}", scale * c.camera_from_world[:3, :3])
        extri += matrix(f"T_{c.name}", scale * unit * c.camera_from_world[:3, 3:])
    (folder / "intri.yml").write_text(intri)
    (folder / "extri.yml").write_text(extri)


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """A good capture: pictures of light boxes for people, OpenPose files of two, EasyMocap calibration."""
    found = detect(cameras(), PEOPLE, 1.5, np.random.default_rng(0))
    write_calibration(tmp_path, cameras())
    (tmp_path / "capture.yaml").write_text("keypoint_layout: coco17\n")
    for camera, seen in zip(cameras(), found):
        (tmp_path / "images" / camera.name).mkdir(parents=True)
        (tmp_path / "keypoints" / camera.name).mkdir(parents=True)
        for t in range(FRAMES, FRAMES + 4):
            draw_people(tmp_path, camera.name, t, [])
        for t in range(FRAMES):
            people = [
                {"pose_keypoints_2d": np.nan_to_num(k).reshape(-1).tolist()} for k in seen.keypoints[seen.frame == t]
            ]
            write_people(tmp_path, camera.name, t, people)
    return tmp_path


def draw_people(folder: Path, camera: str, frame: int, people: list[dict[str, Any]]) -> None:
    picture = np.full(cameras()[0].hw, 90, np.uint8)
    for person in people:
        points = np.reshape(person.get("pose_keypoints_2d", []), (-1, 3))
        if (points[:, 2:] > 0).any():
            inside = points[points[:, 2] > 0, :2].astype(int)
            cv2.rectangle(picture, inside.min(0).tolist(), inside.max(0).tolist(), 180, -1)
    cv2.imwrite(str(folder / "images" / camera / f"{frame:06d}.jpg"), picture)


def write_people(folder: Path, camera: str, frame: int, people: list[dict[str, Any]]) -> None:
    draw_people(folder, camera, frame, people)
    (folder / "keypoints" / camera / f"{camera}_{frame:012d}_keypoints.json").write_text(json.dumps({"people": people}))


@pytest.fixture
def examine(default_settings: Callable[..., dict[str, Any]]) -> Callable[..., dict[str, Any]]:
    """The doctor's report of a folder, by the steps that the workflow runs; keyword arguments change the section
    ``cameras``."""

    def run(folder: Path, **changed: Any) -> dict[str, Any]:
        data, out, section = open_dataset(folder), folder / "out", {**default_settings("cameras"), **changed}
        reading = settings_module.load(calibration.Settings, section, "cameras")
        imported(reading, list(data.calibration), list(data.cameras), "{}", out / "calibration.json")
        people = settings_module.load(tracks_keypoints.Settings, default_settings("tracks"), "tracks")
        for c, path in data.keypoints.items():
            files = out / f"{c}.npz", out / f"{c}.recorded.npz", out / f"{c}.json", [], []
            about = data.keypoint_layout, str(data.keypoint_first_frame.get(c, "auto")), data.footage[c]
            sightings.run(people, c, [path], *about, 30.0, "[]", *files)
        sources = [data.footage[c] for c in data.cameras]
        starts = json.dumps(dict(data.starts))
        films = clocks.Take(list(data.cameras), sources, starts, data.first_frame, data.frame_count)
        clock = settings_module.load(clocks.Settings, default_settings("clocks"), "clocks")
        moments.run(clock, films, 0, out / "lags.json", *UNSEARCHED)
        seen, written = [out / f"{c}.npz" for c in data.keypoints], (out / "clocks.json", out / "sync.json")
        clocks.run(clock, films, seen, out / "lags.json", *written, [out / "calibration.json"])
        doctor.run(
            settings_module.load(doctor.Settings, section, "cameras"),
            "trap",
            out / "calibration.json",
            list(data.cameras),
            [data.footage[c] for c in data.cameras],
            [out / f"{c}.npz" for c in data.keypoints],
            [out / f"{c}.json" for c in data.keypoints],
            out / "clocks.json",
            out / "sync.json",
            out / "doctor.json",
            out / "doctor.html",
        )
        return read_json(out / "doctor.json")

    return run


def unquoted(folder: Path) -> None:
    write_calibration(folder, cameras(), quote="")


def numbered_without_zeros(folder: Path) -> None:
    write_calibration(folder, [replace(c, name=str(int(c.name))) for c in cameras()], quote="")


def scaled_rotations(folder: Path) -> None:
    write_calibration(folder, cameras(), scale=1.7)


def millimetres(folder: Path) -> None:
    write_calibration(folder, cameras(), unit=1000.0)


def empty_people(folder: Path) -> None:
    """Frames without anybody, people without keypoints, people whose keypoints are all zero."""
    for camera, frame, people in (
        ("00", 3, []),
        ("01", 5, [{"person_id": [-1]}]),
        ("02", 7, [{"pose_keypoints_2d": []}]),
        ("10", 9, [{"pose_keypoints_2d": [0.0] * 51}]),
    ):
        write_people(folder, camera, frame, people)


def stray_files(folder: Path) -> None:
    for name in (
        "images/00/Thumbs.db",
        "images/00/._000000.png",
        "images/.DS_Store",
        "keypoints/01/.DS_Store",
        "keypoints/01/notes.txt",
    ):
        (folder / name).write_bytes(b"\x00\x05stray")
    (folder / "keypoints" / "01" / "01_000000000004_keypoints.json.old").write_text("{")
    (folder / "keypoints" / "readme.txt").write_text("made with OpenPose")
    (folder / "Config.toml").write_text("[project]\nmulti_person = true\n")


def half_a_clip(folder: Path) -> None:
    for t in range(FRAMES // 2, FRAMES):
        (folder / "keypoints" / "02" / f"02_{t:012d}_keypoints.json").unlink()
        draw_people(folder, "02", t, [])


def everybody_leaves(folder: Path) -> None:
    for name in NAMES:
        for t in range(FRAMES // 2, FRAMES):
            write_people(folder, name, t, [])


def test_a_camera_started_early_is_set_right_unless_capture_yaml_says_otherwise(
    capture: Path, examine: Callable
) -> None:
    """Files with three frames before the others begin; then capture.yaml gets what the doctor says."""
    for path in sorted((capture / "keypoints" / "01").iterdir(), reverse=True):
        frame = int(path.name.split("_")[1])
        path.rename(path.with_name(f"01_{frame + 3:012d}_keypoints.json"))
        picture = capture / "images" / "01" / f"{frame:06d}.jpg"
        picture.rename(picture.with_name(f"{frame + 3:06d}.jpg"))
    for frame in range(3):
        draw_people(capture, "01", frame, [])
    report = examine(capture)
    assert (report["verdict"], report["sync"]["lags_frames"]["01"]["frames"]) == ("good", pytest.approx(0, abs=0.3))
    described = (capture / "capture.yaml").read_text()
    (capture / "capture.yaml").write_text(f"{described}starts: {{{', '.join(f'{c!r}: 0' for c in NAMES)}}}\n")
    (messages,) = re.findall(r"starts: \{.*?\}", " ".join(examine(capture)["advice"]))
    assert re.search(r'"01": (2\.[89]|3)', messages), messages
    (capture / "capture.yaml").write_text(f"{described}{messages}\n")
    after = examine(capture)
    assert after["verdict"] == "good", after["advice"]


# A trap of the calibration and one of the keypoints at once: neither may change anything.
HARMLESS = [
    pytest.param((unquoted, empty_people), id="names with leading zeros, unquoted; empty people entries"),
    pytest.param((numbered_without_zeros, stray_files), id="leading zeros in the videos only; stray files"),
    pytest.param((scaled_rotations, half_a_clip), id="scale inside a rotation; one camera misses half the clip"),
    pytest.param((millimetres, everybody_leaves), id="mm for m; all people leave"),
]


@pytest.mark.parametrize("traps", HARMLESS)
def test_a_trap_that_can_be_seen_through_changes_nothing(capture, examine, traps):
    for spoil in traps:
        spoil(capture)
    report = examine(capture)
    assert report["cameras"] == list(NAMES)
    missing = "no entry for frames" in " ".join(report["advice"])
    assert missing == (half_a_clip in traps)
    assert len([a for a in report["advice"] if "%" not in a]) == missing
    assert report["median_px"] < 3
    found = {
        v["name"]: np.array(v["camera_from_world"]) for v in read_json(capture / "out" / "calibration.json")["lenses"]
    }
    for camera in cameras():
        assert np.abs(found[camera.name] - camera.camera_from_world).max() < 1e-6


def test_inverted_poses_are_named_and_the_named_setting_mends_them(capture, examine):
    write_calibration(capture, [replace(c, camera_from_world=np.linalg.inv(c.camera_from_world)) for c in cameras()])
    report = examine(capture, up="z")
    assert report["verdict"] == "wrong"
    assert "calibration.poses: world_from_camera" in report["advice"][0]
    assert examine(capture, poses="world_from_camera")["verdict"] == "good"


def test_lengths_a_thousand_times_too_small_are_named_and_the_named_setting_mends_them(capture, examine):
    """Millimetres that were divided once too often: every ray still meets, but people are as long as a finger nail."""
    write_calibration(capture, cameras(), unit=0.001)
    report = examine(capture)
    assert report["verdict"] == "wrong"
    assert "divided by 1000" in " ".join(report["advice"])
    assert examine(capture, scale=1000.0)["verdict"] == "good"


def test_keypoints_of_another_picture_size_are_not_called_good(capture, examine):
    for path in (capture / "keypoints" / "01").iterdir():
        content = json.loads(path.read_text())
        for person in content["people"]:
            person["pose_keypoints_2d"] = [
                v * (0.5 if i % 3 < 2 else 1.0) for i, v in enumerate(person["pose_keypoints_2d"])
            ]
        path.write_text(json.dumps(content))
    report = examine(capture)
    assert report["verdict"] != "good"
    assert "01" in " ".join(report["advice"])


def test_two_calibrations_in_one_folder_are_refused_by_name(capture):
    (capture / "intri.yml").unlink()
    write_toml(capture, cameras()).pop().rename(capture / "first.toml")
    write_toml(capture, cameras()).pop().rename(capture / "second.toml")
    with pytest.raises(UserError, match=r"first\.toml, second\.toml"):
        open_dataset(capture)


def test_files_beside_a_toml_calibration_do_not_hide_it(capture):
    """Pose2Sim keeps Config.toml in the same folder, Caliscope charuco.toml and capture_volume.toml."""
    (capture / "intri.yml").unlink()
    file = write_toml(capture, cameras())[0]
    for name in ("Config.toml", "charuco.toml", "capture_volume.toml"):
        (capture / name).write_text("[board]\ncolumns = 4\naruco_scale = 0.75\n")
    assert open_dataset(capture).calibration == (file,)
