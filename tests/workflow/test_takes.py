# SPDX-License-Identifier: Apache-2.0
"""A batch of takes of one rig: who gives the cameras, who gets them, and the table at the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from studiorecon.calibration import files as calibration_files
from studiorecon.camera_files.colmap import write_model
from studiorecon.cli import command, takes
from studiorecon.footage.video import write_watchable
from studiorecon.geometry.rotations import exp
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.capture import Footage, Manifest, write_manifest
from studiorecon.scene.files import read_table, write_json

WH, CAMERAS = (64, 48), ("cam1", "cam2", "cam3")


def film_take(folder: Path, frames: int = 4, calibration: str = "") -> Path:
    (folder / "videos").mkdir(parents=True)
    for k, name in enumerate(CAMERAS):
        write_watchable(
            folder / f"videos/{name}.mp4", [np.full((WH[1], WH[0], 3), 60 + 40 * k, np.uint8)] * frames, 30.0
        )
    if calibration:
        (folder / "intri.yml").write_text(calibration)
        (folder / "extri.yml").write_text(calibration)
    return folder


def lenses() -> list[Lens]:
    found = []
    for k, name in enumerate(CAMERAS):
        pose, centre = np.eye(4), np.array([3.0 * np.cos(2 * k), 3.0 * np.sin(2 * k), 1.5])
        pose[:3, :3] = exp(np.array([np.pi / 2, 0, 0])) @ exp(np.array([0, 0, -2.0 * k]))
        pose[:3, 3] = -pose[:3, :3] @ centre
        matrix = np.array([[70.0, 0, 31.0], [0, 71.0, 25.0], [0, 0, 1.0]])
        distortion = np.array([-0.05, 0.01, 0, 0.001, 0, 0, 0, 0])
        found.append(Lens(name, WH, matrix, "opencv", distortion, pose, np.eye(2, 3)))
    return found


def write_cameras(scene: str, longer: float = 1.0) -> list[Lens]:
    """The cameras of a finished take, ``longer`` in focal length than they were calibrated."""
    folder, given = Path("results") / scene, lenses()
    write_json(folder / "calibration/calibration.json", {"lenses": [lens.as_json() for lens in given]})
    working = [Camera(lens.name, WH, np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), np.eye(4)) for lens in given]
    footage = tuple(
        Footage(c.name, False, WH, c.intrinsics.tolist(), 30.0, 4, 0, "v", "", WH, 0, 0.0, []) for c in working
    )
    write_manifest(folder / "capture/manifest.json", Manifest(scene, 30.0, 4, footage))
    refined = [
        replace(
            c,
            intrinsics=c.intrinsics * [[longer, 1, 1], [1, longer, 1], [1, 1, 1]],
            camera_from_world=lens.camera_from_world,
        )
        for c, lens in zip(working, given, strict=True)
    ]
    write_model(folder / "cameras", refined)
    return given


class Workflow:
    """Notes what it is called with; a take of ``succeeds`` gets cameras, others fail in a step."""

    def __init__(self, succeeds: Sequence[str], stops_at: str = "") -> None:
        self.succeeds, self.stops_at = succeeds, stops_at
        self.calls: list[tuple[str, list[str]]] = []

    def __call__(self, folder: Path, more: Sequence[str]) -> tuple[int, bool]:
        self.calls.append((folder.name, list(more)))
        if folder.name == self.stops_at:
            return 1, True
        if more or folder.name in self.succeeds:
            write_cameras(folder.name)
            return 0, False
        log = Path("logs") / folder.name / "calibration/from_people.log"
        log.parent.mkdir(parents=True, exist_ok=True)
        log.write_text("4 people\ncalibration.from_people: nobody walks\n")
        return 1, False


@pytest.fixture
def house(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(workflow: Workflow, *folders: Path, rig: Path | None = None) -> dict[str, dict[str, str]]:
    rig_of = takes.open_takes([rig])[0][0] if rig else None
    return {row["take"]: row for row in takes.run_takes(takes.open_takes(folders)[0], rig_of, workflow)}


def test_cameras_are_estimated_once_and_the_others_read_them(house: Path) -> None:
    short, long, broken = film_take(house / "takes/short"), film_take(house / "takes/long", 9), house / "takes/broken"
    (short / "capture.yaml").write_text("frames: {first: 1}\n")
    broken.mkdir()
    workflow = Workflow(["long", "short"])
    rows = run(workflow, short, long, broken)
    assert [name for name, _ in workflow.calls] == ["long", "short"], "the longest first"
    assert not workflow.calls[0][1]
    (own, _) = workflow.calls[1][1]
    described = yaml.safe_load(Path(own.removeprefix("capture_yaml=")).read_text())
    assert described["frames"] == {"first": 1}, "what the take's own capture.yaml says still holds"
    assert (short / described["calibration"]).samefile("results/long/rig.toml")
    assert [rows[name]["result"] for name in ("short", "long", "broken")] == ["done", "done", "failed"]
    assert [row["result"] for row in read_table(takes.TABLE, takes.COLUMNS)] == ["done", "done", "failed"]
    # Afterwards a take is run alone: with the same cameras, and what its own capture.yaml says by then.
    (short / "capture.yaml").write_text("frames: {first: 2}\n")
    settings, note = takes.rig_again(short)
    assert [word.partition("=")[0] for word in settings] == ["capture_yaml", "calibration"]
    assert settings[1] == workflow.calls[1][1][1]
    assert yaml.safe_load(Path(own.removeprefix("capture_yaml=")).read_text())["frames"] == {"first": 2}
    assert "those of long" in note
    assert takes.rig_again(long) == ([], "")
    Path("results/long/rig.toml").unlink()
    settings, note = takes.rig_again(short)
    assert not settings
    assert "gone" in note
    assert "videos" in rows["broken"]["notes"]
    assert rows["long"]["frames"] == "4"


def test_the_rig_is_the_cameras_as_refined(house: Path) -> None:
    given = write_cameras("take", longer=1.05)
    path = takes.write_rig("take")
    assert path is not None
    read, _, floor_known = calibration_files.paired_lenses(
        calibration_files.read_calibration([path]), "rig", CAMERAS, {}, calibration_files.Settings(unit="m")
    )
    assert floor_known
    for lens, was in zip(read, given, strict=True):
        np.testing.assert_allclose(np.diag(lens.intrinsics)[:2], 1.05 * np.diag(was.intrinsics)[:2])
        np.testing.assert_allclose(lens.intrinsics[:2, 2], was.intrinsics[:2, 2])
        np.testing.assert_allclose(lens.distortion, was.distortion)
        np.testing.assert_allclose(lens.camera_from_world, was.camera_from_world, atol=1e-12)
    before_ns = path.stat().st_mtime_ns
    assert takes.write_rig("take") == path
    assert path.stat().st_mtime_ns == before_ns, "nothing is computed again for the same cameras"


def test_a_take_that_failed_before_there_was_a_rig_is_tried_again_with_it(house: Path) -> None:
    workflow = Workflow(["b"])
    rows = run(workflow, film_take(house / "a", 9), film_take(house / "b"))
    assert [name for name, _ in workflow.calls] == ["a", "b", "a"]
    assert {row["result"] for row in rows.values()} == {"done"}
    alone = run(Workflow([]), film_take(house / "c"), film_take(house / "d"))
    assert "calibration.from_people: nobody walks" in alone["c"]["notes"]


def test_a_calibration_of_a_take_comes_first_and_another_one_stays(house: Path) -> None:
    workflow = Workflow(["same", "also", "other"])
    folders = [film_take(house / name, 4, text) for name, text in (("same", "K"), ("also", "K"), ("other", "L"))]
    rows = run(workflow, film_take(house / "none", 9), *folders)
    with_rig = {name for name, more in workflow.calls if more}
    first = workflow.calls[0][0]
    assert first != "none"
    assert "none" in with_rig
    assert len({"same", "also"} & with_rig) == (1 if first != "other" else 0)
    assert "its own calibration" in rows["other" if first != "other" else "same"]["notes"]


def test_a_new_take_uses_the_rig_of_an_earlier_batch(house: Path) -> None:
    run(Workflow(["a"]), film_take(house / "a"), film_take(house / "b"))
    workflow = Workflow(["a", "new"])
    run(workflow, film_take(house / "new", 9), house / "a")
    assert [name for name, _ in workflow.calls] == ["a", "new"], "a longer take does not change finished ones"
    named = Workflow([])
    rows = run(named, house / "b", rig=film_take(house / "still"))
    assert [name for name, _ in named.calls] == ["still"]
    assert rows["b"]["result"] == "not run"


def test_a_camera_without_a_place_is_left_out_of_the_others(house: Path) -> None:
    first, second = film_take(house / "first", 9), film_take(house / "second")
    write_watchable(second / "videos/cam9.mp4", [np.zeros((WH[1], WH[0], 3), np.uint8)] * 4, 30.0)
    workflow = Workflow(["first"])
    rows = run(workflow, first, second, rig=first)
    described = yaml.safe_load(Path("results/second/rig.yaml").read_text())
    assert described["train"] == list(CAMERAS)
    assert "cam9" in rows["second"]["notes"]


def test_ctrl_c_ends_the_batch(house: Path) -> None:
    workflow = Workflow(["a", "b"], stops_at="a")
    rows = run(workflow, film_take(house / "a", 9), film_take(house / "b"))
    assert (rows["a"]["result"], rows["b"]["result"]) == ("stopped", "not run")


def test_the_command_prints_and_writes_one_table(
    house: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    workflow = Workflow(["a"])
    monkeypatch.setattr(
        command, "_snakemake", lambda target, dataset, options: workflow(Path(dataset), options.rest)[0]
    )
    film_take(house / "a", 9), film_take(house / "b")
    (house / "notes.txt").touch()
    assert command.main(["run", "a", "b", "notes.txt", "a/"]) == 0
    printed = capsys.readouterr().out
    assert "notes.txt is a file and no take" in printed
    assert [row["result"] for row in read_table(takes.TABLE, takes.COLUMNS)] == ["done", "done"]
    assert workflow.calls[1][1][0] == "--config"
    (house / "c/b").mkdir(parents=True)
    for words, sentence in (
        (["run", "a", "c/b", "b"], "two takes are called b"),
        (["run", "a", "nowhere"], "no folder nowhere"),
        (["run", "notes.txt", "--rig", "a"], "notes.txt is no folder"),
        (["run", "a", "b", "--", "--config", "scene=x"], "scene=x is for one take"),
    ):
        assert command.main(words) == 1
        assert sentence in capsys.readouterr().err
    (house / "d").mkdir()
    assert command.main(["run", "a", "d"]) == 1, "one failed"
