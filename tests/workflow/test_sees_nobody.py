# SPDX-License-Identifier: Apache-2.0
"""Films in which a camera sees nobody, one camera alone sees people, or people are there for half a second: from the
detector to the plan of the background, every run ends, and says what it did."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from studiorecon.camera_files.calibration import read_lenses
from studiorecon.camera_files.colmap import read_model
from studiorecon.footage.frames import decode
from studiorecon.footage.source import open_source
from studiorecon.footage.video import write_lossless
from studiorecon.scene.files import read_table
from studiorecon.scene.people import PEOPLE_COLUMNS
from studiorecon.studio import capture

from tests.workflow.conftest import House, make_house

CAMERAS = ("cam1", "cam2", "cam3", "cam4")
STUDIO = {
    "seed": 3,
    "frames": 24,
    "fps": 15.0,
    "size": [480, 272],
    "people": 2,
    "cameras": {"held_out": 0},
    "detections": {"recorded": False},
    "plates": True,
}
QUICK = {"depth": {"primitives": 0}, "background": {"training": {"iterations": 100}}}


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small studio's films, with the empty room of every camera."""
    folder = tmp_path_factory.mktemp("studio")
    (folder / "small.yaml").write_text(yaml.safe_dump(STUDIO))
    capture.run(folder / "small.yaml", folder / "dataset", folder / "truth")
    return folder / "dataset"


def filmed(studio: Path, folder: Path, people: Callable[[str, int], bool], calibrated: bool = True) -> House:
    """A house whose dataset shows people where ``people`` (camera, frame) says so, and else the empty room, with a
    sensor's noise."""
    dataset = folder / "films"
    (dataset / "videos").mkdir(parents=True)
    for name in ("intri.yml", "extri.yml") if calibrated else ():
        shutil.copy(studio / name, dataset / name)

    def pictures(camera: str) -> Iterator[np.ndarray]:
        empty = cv2.imread(str(studio / f"plates/{camera}.png"))
        assert empty is not None
        rng = np.random.default_rng(CAMERAS.index(camera))
        for frame, picture in enumerate(decode(open_source(studio / f"videos/{camera}.mp4", 30.0), 0, 0)):
            noisy = empty[..., ::-1] + rng.normal(0, 1.5, empty.shape)
            yield picture if people(camera, frame) else np.clip(noisy, 0, 255).astype(np.uint8)

    for camera in CAMERAS:
        write_lossless(dataset / f"videos/{camera}.mkv", pictures(camera), STUDIO["fps"])
    return make_house(folder / "house", str(dataset))


def run(house: House, *targets: str) -> tuple[Path, str]:
    """The scene's results, and every line of its logs."""
    options = "--configfile", str(house.folder / "config/config.yaml"), house.overlay(**QUICK)
    made = [f"results/films/{target}" for target in targets]
    house.snakemake(*made, "results/films/calibration/doctor.json", "--cores", "2", *options)
    logs = sorted((house.folder / "logs/films").rglob("*.log"))
    return house.folder / "results/films", "\n".join(log.read_text() for log in logs)


def named(results: Path) -> dict[str, str]:
    """Person → the cameras that see them."""
    rows = read_table(results / "people/people.tsv", PEOPLE_COLUMNS)
    return {row["person"]: row["cameras"] for row in rows if row["status"] == "person"}


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_camera_that_sees_nobody_still_serves_the_room(studio: Path, tmp_path: Path) -> None:
    house = filmed(studio, tmp_path, lambda camera, _: camera != "cam3")
    plates = [f"plates/{camera}.png" for camera in CAMERAS]
    results, reported = run(house, "people/people.tsv", "views/path.json", "background/scene.ply", *plates)
    assert named(results) == {"p0": "cam1,cam2,cam4", "p1": "cam1,cam2,cam4"}
    assert reported.count("warning: camera cam3 sees nobody: it shows only the room") == 1
    assert "identities come from cam1, cam2, cam4" in reported
    # Its pose is as given, its plate is whole, and views of the room begin and end there.
    given = read_lenses(results / "calibration/calibration.json")["cam3"].camera_from_world
    used = {c.name: c.camera_from_world for c in read_model(results / "cameras")}["cam3"]
    np.testing.assert_allclose(used, given, atol=1e-9)
    plate = cv2.imread(str(results / "plates/cam3.png"), cv2.IMREAD_UNCHANGED)
    assert plate is not None
    assert (plate[..., 3] > 0).mean() > 0.99
    assert "(cam2 to cam3)" in reported
    doctor = json.loads((results / "calibration/doctor.json").read_text())
    assert doctor["verdict"] in ("good", "check"), doctor["advice"]
    assert any(sentence.startswith("camera cam3 sees nobody") for sentence in doctor["advice"])


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_without_a_calibration_a_camera_that_sees_nobody_is_left_out_by_name(studio: Path, tmp_path: Path) -> None:
    house = filmed(studio, tmp_path, lambda camera, _: camera != "cam3", calibrated=False)
    results, reported = run(house, "people/people.tsv", "views/path.json")
    assert named(results) == {"p0": "cam1,cam2,cam4", "p1": "cam1,cam2,cam4"}
    assert "warning: camera cam3 is left out of this reconstruction: it sees no person" in reported
    assert not list((house.folder / "logs/films").rglob("second_look/cam3.log")), "nobody looks at it again"


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_people_whom_one_camera_alone_sees_are_reported_and_the_room_is_made(studio: Path, tmp_path: Path) -> None:
    house = filmed(studio, tmp_path, lambda camera, _: camera == "cam1")
    results, reported = run(house, "people/people.tsv", "background/scene.ply")
    assert named(results) == {}
    assert "no person is visible in two cameras at once: the calibration is used as given, unchecked" in reported
    assert "no person was identified" in reported
    doctor = json.loads((results / "calibration/doctor.json").read_text())
    assert doctor["verdict"] == "cannot tell"
    assert "people are seen by one camera alone" in doctor["advice"][0]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_people_who_are_there_for_half_a_second_are_found(studio: Path, tmp_path: Path) -> None:
    house = filmed(studio, tmp_path, lambda _, frame: 8 <= frame < 16)
    results, _ = run(house, "people/people.tsv", "views/path.json")
    rows = [r for r in read_table(results / "people/people.tsv", PEOPLE_COLUMNS) if r["status"] == "person"]
    assert len(rows) == 2
    assert all(7 <= int(row["frames"]) <= 10 for row in rows), rows
