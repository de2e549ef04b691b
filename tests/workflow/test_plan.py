# SPDX-License-Identifier: Apache-2.0
"""What the plan holds before anything ran, and what is refused at once."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from studiorecon.plan.budget import read_preset

from tests.made.plan import dataset, on  # noqa: F401
from tests.workflow.conftest import ROOT, House, make_house


def test_a_users_dataset_is_planned_per_camera_and_segment(house: House, dataset: Path) -> None:
    plan = on(house, dataset).plan()
    assert plan["capture_frames"] == 3
    assert plan["depth_sweep"] == 3
    assert plan["survey_decide"] == 1
    assert "studio_capture" not in plan
    assert "render_layers" not in plan, "on request only"


def test_a_camera_that_was_started_early_is_read_from_its_own_frame_on(house: House, dataset: Path) -> None:
    (dataset / "capture.yaml").write_text("starts: {right: 13}\nframes: {first: 4, count: 20}\n")
    there, films = on(house, dataset), [f"results/{dataset.name}/capture/{c}.mkv" for c in ("left", "right")]
    reported = there.snakemake(
        "--dry-run", "--printshellcmds", "--cores", "1", *films, f"results/{dataset.name}/calibration/doctor.html"
    ).stdout
    (dataset / "capture.yaml").unlink()
    for words in ("""--starts '{"back": 0.0, "left": 0.0, "right": 13.0}'""", "--first-frame 4", "--frame-count 20"):
        assert words in reported


def test_videos_and_a_calibration_are_enough(house: House, dataset: Path) -> None:
    (dataset / "keypoints").rename(dataset / "hidden")
    (dataset / "intri.yml").rename(dataset / "no calibration")
    videos_alone = on(house, dataset).plan()
    (dataset / "no calibration").rename(dataset / "intri.yml")
    plan, doctor = on(house, dataset).plan(), on(house, dataset).plan("doctor")
    (dataset / "hidden").rename(dataset / "keypoints")
    assert plan["detect_people"] == 3
    assert videos_alone["clocks_moments"] == doctor["clocks_moments"] == 1
    assert "detect_people" not in doctor, "some moments are enough"
    assert plan["detect_keypoints"] == 3, "when was each camera started?"
    assert videos_alone["detect_keypoints"] == doctor["detect_keypoints"] == 3
    assert videos_alone["calibration_from_people"] == 1
    assert "detect_people" not in on(house, dataset).plan(), "keypoint files come first"


def test_a_network_of_one_s_own_is_an_input_of_the_steps_that_detect_people(house: House, dataset: Path) -> None:
    network = dataset / "mine.onnx"
    network.write_bytes(b"")
    (dataset / "keypoints").rename(dataset / "hidden")
    there = on(house, dataset)
    wanted = ("--configfile", there.overlay(detect={"network": str(network), "network_layout": "halpe26"}))
    found = [f"results/{dataset.name}/detect/found/{camera}.npz" for camera in ("left", "right")]
    reported = there.snakemake("--dry-run", "--printshellcmds", "--cores", "1", *found, *wanted).stdout
    network.unlink()
    refused = there.snakemake("--dry-run", *wanted, check=False)
    (dataset / "hidden").rename(dataset / "keypoints")
    assert reported.count(f"--second {network}") == reported.count("--layout halpe26") == 3
    assert f"detect.network names {network}, which does not exist" in refused.stdout


def test_a_network_that_is_fetched_is_an_input_once_it_is_there(house: House, dataset: Path, tmp_path: Path) -> None:
    (dataset / "keypoints").rename(dataset / "hidden")
    there = on(house, dataset)
    wanted = ("--configfile", there.overlay(detect={"network": "rtmpose"}, weights=str(tmp_path)))
    found = f"results/{dataset.name}/detect/found/left.npz"
    refused = there.snakemake("--dry-run", "--cores", "1", found, *wanted, check=False)
    listed = there.snakemake("--cores", "1", "weights_list", *wanted).stdout
    (dataset / "hidden").rename(dataset / "keypoints")
    assert f"needs {tmp_path}/rtmpose/rtmpose-m-halpe26-256x192.onnx, which is missing" in refused.stdout
    assert "rtmpose-m-halpe26-256x192.onnx: 0.056 GB; free to fetch; SHA-256 26f3a19e" in listed


def test_a_run_begins_only_with_every_file_of_its_networks(house: House, tmp_path: Path) -> None:
    wanted = ("--cores", "1", "--configfile", house.overlay(depth={"source": "moge"}, weights=str(tmp_path)))
    refused = house.snakemake("results/tiny/depth/cam1.exr", *wanted, check=False)
    assert refused.returncode != 0
    assert f"needs {tmp_path}/moge/" in refused.stdout
    assert "Finished job" not in refused.stdout, "no job ran before"
    assert house.plan(*wanted[2:])["depth_network"] == 1, "a plan needs no weights"


@pytest.mark.parametrize(("remove", "words"), [("keypoints/back", "camera back"), ("videos", "neither videos")])
def test_what_is_missing_is_named_before_anything_runs(house: House, dataset: Path, remove: str, words: str) -> None:
    (dataset / remove).rename(dataset / ".hidden")
    files_only = "--configfile", on(house, dataset).overlay(detect={"source": "keypoints"})
    done = on(house, dataset).snakemake("--dry-run", "--cores", "1", *files_only, check=False)
    (dataset / ".hidden").rename(dataset / remove)
    assert done.returncode != 0
    assert words in done.stdout
    assert "Traceback" not in done.stdout


def test_a_missing_dataset_folder_is_named(house: House) -> None:
    done = House(house.folder, "nowhere").snakemake("--dry-run", "--cores", "1", check=False)
    assert done.returncode != 0
    assert "nowhere does not exist" in done.stdout


@pytest.mark.parametrize("file", ["mine.yaml", "config/config.yaml"])
def test_a_file_of_settings_that_holds_none_is_named(house: House, file: str) -> None:
    path = house.folder / file
    whole = path.read_bytes() if path.exists() else None
    overlay = () if whole else ("--configfile", file)
    try:
        for content in (b"", b"# comments alone", b"[1]", b"\x8f\x00", None):
            path.unlink(missing_ok=True)
            os.mkfifo(path) if content is None else path.write_bytes(content)
            done = house.snakemake("--dry-run", "--cores", "1", *overlay, check=False)
            assert done.returncode == 1
            assert done.stdout.splitlines()[-1].startswith(file)
    finally:
        path.unlink()
        if whole:
            path.write_bytes(whole)


def test_a_folder_that_cannot_be_written_into_is_named_before_anything_runs(house: House) -> None:
    there = replace(house, dataset="resources/studio/tiny.yaml")
    shutil.rmtree(house.folder / "logs", ignore_errors=True)
    (house.folder / "logs").touch()
    try:
        done = there.snakemake("--cores", "1", check=False)
    finally:
        (house.folder / "logs").unlink()
    assert done.returncode == 1
    assert f"{house.folder / 'logs'} is no folder that may be written into" in done.stdout
    assert "Traceback" not in done.stdout
    assert not (house.folder / "results").exists()


def test_what_the_command_line_says_is_read_as_what_it_is(house: House, dataset: Path) -> None:
    """A film of which only the kind is said, a number within a section, and an unquoted off in a file."""
    wanted = [f"results/{dataset.name}/{name}" for name in ("render/extra.mkv", "tracks/left.npz")]
    overlay = house.folder / "unquoted.yaml"
    overlay.write_text(
        "survey: {force: {view_synthesis: off, exposure: off, view_dependent_colour: off, moving_shadows: off}}\n"
    )
    messages = [f"dataset={dataset}", "detect={min_confidence: 0.2}", "render={shots: {extra: {kind: orbit}}}"]
    reported = (
        House(house.folder, "")
        .snakemake(
            "--dry-run",
            "--cores",
            "1",
            "--printshellcmds",
            *wanted,
            "--configfile",
            str(overlay),
            "--config",
            *messages,
        )
        .stdout
    )
    assert "--shot extra" in reported
    assert '"min_confidence": 0.2' in reported
    assert "views_synthesize" not in reported


def test_a_captures_calibration_is_checked_on_request(house: House, dataset: Path) -> None:
    requested = on(house, dataset).plan("plan")
    assert requested["placement_advise"] == 1
    assert not [rule for rule in requested if rule.split("_")[0] in ("depth", "background", "humans", "render")]


def test_films_are_taken_apart_into_exr_on_request(house: House, dataset: Path) -> None:
    there = on(house, dataset)
    plan = there.plan("--configfile", there.overlay(render={"exr": True}))
    assert plan["render_layers"] == plan["enhance_shot"] >= 1


def test_workflow_also_runs_from_another_directory(tmp_path: Path) -> None:
    made = make_house(tmp_path / "house", "")
    (tmp_path / "elsewhere").mkdir()
    plan = made.plan("--directory", str(tmp_path / "elsewhere"))
    assert plan["studio_capture"] == 1


def test_a_first_look_makes_one_film_and_measures_nothing(house: House, dataset: Path) -> None:
    (dataset / "capture.yaml").write_text("people: 0\nheld_out: [back]\n")
    there = on(house, dataset)
    off = dict.fromkeys(
        ("exposure", "changing_light", "view_synthesis", "view_dependent_colour", "dynamic_objects"), "off"
    )
    overlays = [str(ROOT / "config/presets/look.yaml"), there.overlay(survey={"force": off})]
    plan = there.plan("look", "--configfile", *overlays)
    (dataset / "capture.yaml").unlink()
    assert plan["render_shot"] == plan["enhance_shot"] == 1
    assert plan["background_train"] == 1
    assert not [rule for rule in plan if rule.split("_")[0] in ("report", "deliver")]
    assert "people_review" not in plan


def test_a_budget_chooses_the_preset_and_leaves_what_the_user_said(house: House) -> None:
    film = "results/tiny/render/orbit.mkv"
    arguments = ("--dry-run", "--printshellcmds", "--cores", "2", film, "--config", f"dataset={house.dataset}")
    reported = replace(house, dataset="").snakemake(*arguments, "budget_min=0.01", "depth={primitives: 44}").stdout
    assert "budget of 0.01 min: look, about" in reported
    assert "no preset is quicker" in reported
    look = read_preset("look")
    assert f'"iterations": {look["background"]["training"]["iterations"]}' in reported
    assert f'"sweep_width": {look["depth"]["sweep_width"]}' in reported
    assert '"primitives": 44' in reported
    assert (house.folder / "timings" / "pace.json").is_file()
    without = replace(house, dataset="").snakemake(*arguments).stdout
    assert "budget" not in without
