# SPDX-License-Identifier: Apache-2.0
"""``snakemake sweep``: asked for by name only; its runs share what their settings leave alone; a run that fails is a
record."""

from __future__ import annotations

from pathlib import Path

import pytest
from studiorecon.sweep.records import FAILED, OK, read_records

from tests.workflow.conftest import House, make_house

TABLE = """name\tparameter\tpreset\tsettings
base\t\t\tdepth.primitives=0 ; \
background.training.iterations=60 ; humans.iterations=40 ; humans.gaussians=1000 ; render.shots.orbit.frames=2
plain\tenhancement\t\tenhance.enhancer=none
refused\tlimits\t\tcalibration.scale=100000
room\tbackground steps\t\tbackground.training.iterations=120
"""


def test_a_sweep_is_two_jobs_of_this_workflow_and_everything_else_of_its_own(house: House) -> None:
    plan = house.plan("sweep")
    assert {rule: count for rule, count in plan.items() if rule.startswith("sweep")} == {
        "sweep": 1,
        "sweep_run": 1,
        "sweep_page": 1,
    }
    assert set(plan) == {"sweep", "sweep_run", "sweep_page"}


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_runs_share_jobs_and_a_failed_one_is_a_record(tmp_path: Path) -> None:
    house = make_house(tmp_path / "swept", "resources/studio/tiny.yaml")
    (house.folder / "few.tsv").write_text(TABLE)
    house.snakemake("--cores", "2", "sweep", "--configfile", house.overlay(sweep="few.tsv"))
    folder = house.folder / "results/tiny/sweep/few"
    base, plain, refused, room = read_records(folder / "records.jsonl")[1]
    assert [r.verdict for r in (base, plain, refused, room)] == [OK, OK, FAILED, OK]
    assert "cameras_refine" in refused.sentence
    assert base.seconds["ran"] == base.seconds["from_nothing"]
    assert {stage for stage, spent in plain.ran_stages.items() if spent} == {"enhance"}
    assert {stage for stage, spent in room.ran_stages.items() if spent} == {"background", "render", "enhance"}
    assert set(room.stages) == set(base.stages), "what was shared is charged all the same"
    assert room.stages["humans"] == base.stages["humans"]
    assert room.seconds["marginal"] == room.seconds["ran"] < 0.7 * room.seconds["from_nothing"]
    assert refused.sentence in (folder / "index.html").read_text()
