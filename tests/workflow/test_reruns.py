# SPDX-License-Identifier: Apache-2.0
"""The smallest studio runs to its end once; then single edits re-run exactly what depends on them."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import pytest
from studiorecon.plan.memory import ROOM_MB
from studiorecon.report.sections.cost import cost

from tests.workflow.conftest import House, make_house

AFTER_HUMANS = {
    "render_shot",
    "enhance_shot",
    "report_audit",
    "report_recognition",
    "report_evaluate",
    "report_page",
    "deliver_export",
    "deliver_player",
    "deliver_scene_glb",
}


def results(house: House) -> Path:
    return house.folder / "results" / "tiny"


def filmed(house: House) -> Path:
    """What the studio's cameras took."""
    return house.folder / "results/studio/tiny/dataset"


def another(house: House, folder: Path) -> House:
    """A finished house elsewhere, which a test may leave in another state."""
    shutil.copytree(house.folder, folder, symlinks=True)
    return replace(house, folder=folder)


def test_a_film_a_page_and_every_product_come_out(finished: House) -> None:
    for name in (
        "enhance/orbit.mp4",
        "report/index.html",
        "report/metrics.json",
        "background/scene.ply",
        "people/people.tsv",
    ):
        assert (results(finished) / name).stat().st_size > 0
    assert len((results(finished) / "people/people.tsv").read_text().splitlines()) == 3, "two people and the header"


def test_no_job_needed_more_memory_than_its_rule_asks_for(finished: House) -> None:
    asks = r"(?:rule|checkpoint) (\w+):(?:(?!\n *(?:rule|checkpoint) ).)*?mem_mb=memory\((.*?)\),\n"
    sizes = {"room_mb(PLAN, config)": ROOM_MB, "fit_mb(config)": 1000}
    rules = "\n".join(path.read_text() for path in sorted((finished.folder / "workflow/rules").glob("*.smk")))
    # Of a choice the size without networks; of a sum the part that needs no GPU.
    requested = {
        rule: sizes.get(size) or int(re.search(r"\d+", size.rpartition(" else ")[2])[0])
        for rule, size in re.findall(asks, rules, re.DOTALL)
    }
    stages = cost(finished.folder / "timings/tiny")["stages"]
    measured = {
        f"{stage}_{step}": used["peak_memory_mb"] for stage in stages for step, used in stages[stage]["rules"].items()
    }
    peaks = {rule: peak for rule, peak in measured.items() if peak and rule in requested}
    assert {"background_train", "humans_train", "render_shot", "people_fit"} <= set(peaks)
    assert {rule: peak for rule, peak in peaks.items() if peak > requested[rule]} == {}


def test_nothing_is_left_to_do(finished: House) -> None:
    assert finished.plan() == {}


def test_a_folder_that_is_moved_stays_finished(finished: House, tmp_path: Path) -> None:
    assert another(finished, tmp_path / "elsewhere").plan() == {}


def test_strict_ends_a_run_that_warned_with_all_warnings(finished: House) -> None:
    strict = finished.overlay(strict=True)
    assert finished.plan("--configfile", strict) == {"report_strict": 1}
    planted = finished.folder / "logs/tiny/people/planted.log"
    planted.write_text("warning: camera cam9: its picture is upside down\n")
    done = finished.snakemake("--cores", "2", "--configfile", strict, check=False)
    planted.unlink()
    assert done.returncode != 0
    assert "people.planted: camera cam9: its picture is upside down" in done.stdout
    assert (results(finished) / "report/index.html").is_file()
    assert finished.plan() == {}, "nothing is lost by it"


def test_a_render_setting_renders_again_and_trains_nothing(finished: House) -> None:
    plan = finished.plan("--configfile", finished.overlay(render={"background_rgb": [1.0, 1.0, 1.0]}))
    assert set(plan) == AFTER_HUMANS - {"deliver_scene_glb"}, "which holds the scene, not its films"


def test_a_replaced_person_renders_again_and_trains_nothing(finished: House) -> None:
    stranger = finished.folder / "stranger.ply"
    stranger.touch()
    overlay = finished.overlay(render={"shots": {"orbit": {"replace": {"p0": str(stranger), "p1": "p0"}}}})
    # The held-out film shows everybody as they are, so whom a detector finds there is known.
    assert set(finished.plan("--configfile", overlay)) == AFTER_HUMANS - {"report_recognition", "deliver_scene_glb"}


def test_a_human_setting_trains_the_humans_and_leaves_the_room(finished: House) -> None:
    plan = finished.plan("--configfile", finished.overlay(humans={"iterations": 7}))
    assert plan["humans_train"] == 2
    assert set(plan) == {"humans_train", *AFTER_HUMANS}


def test_a_changed_line_of_one_step_runs_that_step_and_what_follows(finished: House) -> None:
    module = finished.folder / "workflow/studiorecon/views/synthesize.py"
    before = module.read_text()
    module.write_text(before + "\nPLANTED = 1\n")
    plan = finished.plan()
    module.write_text(before + "\n# only a comment\n")
    commented = finished.plan()
    module.write_text(before)
    assert "views_synthesize" in plan
    assert "background_train" in plan
    assert not {"capture_frames", "people_fit", "depth_refine", "humans_train"} & set(plan)
    assert commented == {}


def test_a_changed_setting_counts_where_kernels_are_compiled_anew_as_well(finished: House) -> None:
    kernels = finished.folder / "workflow/studiorecon/depth/kernels.py"
    text = kernels.read_text()
    kernels.write_text(text.replace("the depth kernels are compiled", "kernels are compiled"))
    assert kernels.read_text() != text
    plan = finished.plan("--configfile", finished.overlay(depth={"primitives": 3}))
    kernels.write_text(text)
    assert plan["depth_kernels"] == 1
    assert plan["depth_room"] == 1
    assert plan["background_train"] == 1


def test_a_person_whose_training_fails_is_retried_alone_and_no_stale_film_counts_as_finished(
    finished: House, tmp_path: Path
) -> None:
    house = another(finished, tmp_path / "house")
    overlay = ("--configfile", house.overlay(humans={"iterations": 20}))
    broken = house.snakemake("--cores", "2", *overlay, check=False, path=house.failing_python("humans.train", "p1"))
    assert broken.returncode != 0
    assert (results(house) / "humans/p0.ply").is_file()
    assert (results(house) / "background/scene.ply").is_file()
    plan = house.plan(*overlay)
    assert plan["humans_train"] == 1, "exactly the person that failed"
    assert set(plan) >= AFTER_HUMANS, "the old film is not finished"


def test_a_killed_run_is_resumed(finished: House, tmp_path: Path) -> None:
    house = make_house(tmp_path / "killed", str(shutil.copytree(filmed(finished), tmp_path / "tiny")))
    run = subprocess.Popen(
        house.command("--cores", "2", "--until", "capture_manifest"),
        cwd=house.folder,
        env=house.environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    incomplete = house.folder / ".snakemake" / "incomplete"
    deadline = time.monotonic() + 120
    while not (incomplete.is_dir() and any(incomplete.iterdir())):
        assert time.monotonic() < deadline, "no job started"
        time.sleep(0.1)
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    # What a power cut leaves behind: Snakemake's lock, which its own message says how to take away, and half-made
    # files.
    house.snakemake("--unlock")
    house.snakemake("--cores", "2", "--until", "capture_manifest")
    assert (results(house) / "capture/manifest.json").is_file()


def test_a_truncated_video_is_named_before_anything_runs(finished: House, tmp_path: Path) -> None:
    dataset = shutil.copytree(filmed(finished), tmp_path / "truncated")
    video = sorted((dataset / "videos").iterdir())[0]
    video.write_bytes(video.read_bytes()[:2000])
    house = House(finished.folder, str(dataset))
    done = house.snakemake("--cores", "2", "--until", "capture_manifest", check=False)
    assert done.returncode != 0
    assert video.name in done.stdout
    assert not list((finished.folder / "results/truncated").rglob("*.mkv"))


@pytest.mark.slow
def test_an_empty_room_becomes_a_background_film(tmp_path: Path) -> None:
    house = make_house(tmp_path / "empty", "resources/studio/empty.yaml")
    house.snakemake("--cores", "2")
    assert (house.folder / "results/empty/enhance/orbit.mp4").stat().st_size > 0
    assert not (house.folder / "results/empty/humans").exists()
    assert house.plan() == {}
