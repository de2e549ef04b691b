# SPDX-License-Identifier: Apache-2.0
"""The paper's presets as a whole: planned on videos alone, as the paper has it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from studiorecon.body.model import BodyModel
from studiorecon.plan.memory import ROOM_MB

from tests.made.smpl import write_smpl
from tests.workflow.conftest import ROOT, House

PRESETS = [str(ROOT / f"config/presets/{name}.yaml") for name in ("paper", "networks")]


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four cameras' videos and a held-out fifth; no calibration, no keypoints."""
    folder = tmp_path_factory.mktemp("uncalibrated")
    (folder / "videos").mkdir()
    for camera in ("front", "left", "right", "back", "between"):
        (folder / "videos" / f"{camera}.mp4").touch()
    (folder / "capture.yaml").write_text("held_out: [between]\n")
    return folder


@pytest.fixture(scope="module", autouse=True)
def registered(house: House) -> None:
    """SMPL's file where who registered puts it."""
    write_smpl(house.folder / "resources/weights/smpl/SMPL_NEUTRAL.pkl", BodyModel.load(ROOT / "resources/body.npz"))


def test_the_whole_preset_is_planned_on_videos_alone(house: House, videos: Path) -> None:
    plan = House(house.folder, str(videos)).plan("--configfile", *PRESETS)
    assert {"calibration_network": 1, "clocks_moments": 1, "tracks_bodies": 4}.items() <= plan.items()
    # Depth is the first moment's by the network that finds the cameras: no planes, no depth of plates.
    assert {"depth_first": 4, "capture_frames": 5}.items() <= plan.items()
    assert not {"depth_network", "depth_refine"} & set(plan)
    assert plan["body_plain"] == 1
    # Pelvises at the scene's depth: association waits for them.
    assert plan["people_lift"] == 4
    # What hangs on who is found is planned when association has run.
    assert not {"tracks_keypoints", "views_synthesize", "calibration_from_people"} & set(plan)


@pytest.fixture(scope="module")
def jobs(house: House, videos: Path) -> dict[str, str]:
    """Rule → what the plan of the whole preset prints of its last job; rules with a message print that instead."""
    text = House(house.folder, str(videos)).snakemake("--dry-run", "--configfile", *PRESETS).stdout
    return {block.split(":")[0]: block for block in re.split(r"\n(?:local)?(?:rule|checkpoint) ", text)[1:]}


def test_every_job_that_computes_on_a_gpu_asks_for_one(jobs: dict[str, str]) -> None:
    on_gpu = {rule for rule, job in jobs.items() if "gpu=1" in job}
    drawn = {"background_half", "report_evaluate"}
    networks = {"calibration_network", "tracks_bodies", "people_lift", "views_generate", "views_people"}
    assert drawn | networks | {"background_refined"} <= on_gpu


def test_jobs_ask_for_the_memory_that_the_preset_needs(jobs: dict[str, str]) -> None:
    requested = {rule: int(m.group(1)) for rule, job in jobs.items() if (m := re.search(r"mem_mb=(\d+)", job))}
    # 4 photos, 480 views and 240 refined ones at 1280×720 with four float32 numbers a pixel.
    assert requested["background_half"] == ROOM_MB + round(724 * 1280 * 720 * 16 / 1e6)


def test_no_setting_of_people_changes_the_views(house: House, videos: Path) -> None:
    """With depth of the first moment views need nobody: they start beside people, and stay when people are changed."""
    needed = f"results/{videos.name}/views/00.mkv"
    changed = {"people": {"smooth": {"sigma_s": 0.1}, "fit": {"beta_weight": 1.0}, "association": {"method": "tracks"}}}
    plans = [
        House(house.folder, str(videos)).snakemake(
            needed, "--dry-run", "--printshellcmds", "--configfile", *PRESETS, *overlay
        )
        for overlay in ([], [house.overlay(**changed)])
    ]
    commands = [sorted(re.findall(r"^Shell command: (.+)$", plan.stdout, re.MULTILINE)) for plan in plans]
    assert commands[0] == commands[1]
    steps = {command.split()[3] for command in commands[0]}
    assert {"views.request", "views.generate", "views.people", "views.fitted"} <= steps
    assert not [step for step in steps if step.startswith(("people.", "masks."))]


@pytest.mark.parametrize(
    ("changed", "messages"),
    [
        ({"calibration": {"source": "people"}, "depth": {"reference": "planes"}}, "set calibration.source to pi3"),
        ({"depth": {"source": "pi3"}}, "needs the depth of every frame"),
        ({"detect": {"source": "auto"}}, "the built-in detector is used"),
        (
            {"calibration": {"source": "people"}, "people": {"association": {"position": "rays"}}},
            "depth.reference is calibration",
        ),
        ({"masks": {"source": "embedded"}}, "views.people is network"),
    ],
    ids=["first moment", "every frame", "second look", "depth", "people in views"],
)
def test_a_setting_that_lacks_what_it_reads_is_refused(
    house: House, videos: Path, changed: dict, messages: str
) -> None:
    refused = House(house.folder, str(videos)).snakemake(
        "--dry-run", "--configfile", *PRESETS, house.overlay(**changed), check=False
    )
    assert refused.returncode != 0
    assert messages in refused.stdout
