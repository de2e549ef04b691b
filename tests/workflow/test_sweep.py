# SPDX-License-Identifier: Apache-2.0
"""``snakemake sweep``: part of no other target; a row runs again only what it changes; a failed run is a record."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.workflow.conftest import House, make_house

TABLE = """name\tparameter\tpreset\tsettings
base\t\t\tdepth.primitives=0 ; \
background.training.iterations=60 ; humans.iterations=40 ; humans.gaussians=1000 ; render.shots.orbit.frames=2
plain\tenhancement\t\tenhance.enhancer=none
refused\tlimits\t\tcalibration.scale=100000
room\tbackground steps\t\tbackground.training.iterations=120
"""


def test_a_sweep_is_one_job_per_row_and_a_page(house: House) -> None:
    (house.folder / "two.tsv").write_text("".join(TABLE.splitlines(keepends=True)[:3]))
    plan = house.plan("sweep", "--configfile", house.overlay(sweep="two.tsv"))
    assert plan == {"sweep": 1, "sweep_row": 2, "sweep_page": 1}


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_rows_share_jobs_and_a_failed_one_is_a_record(tmp_path: Path) -> None:
    house = make_house(tmp_path / "swept", "resources/studio/tiny.yaml")
    (house.folder / "few.tsv").write_text(TABLE)
    house.snakemake("--cores", "2", "sweep", "--configfile", house.overlay(sweep="few.tsv"))
    folder = house.folder / "results/tiny/sweep/few"
    names = ("base", "plain", "refused", "room")
    base, plain, refused, room = (json.loads((folder / f"{name}.json").read_text()) for name in names)
    assert [bool(r["failed"]) for r in (base, plain, refused, room)] == [False, False, True, False]
    assert "cameras_refine" in refused["failed"]
    assert base["ran_s"] == base["from_nothing_s"]
    assert plain["ran_s"] < 0.5 * plain["from_nothing_s"], "only enhancement changed"
    assert set(room["stages_s"]) == set(base["stages_s"]), "shared jobs are charged all the same"
    assert room["stages_s"]["humans"] == base["stages_s"]["humans"]
    assert 0 < room["ran_s"] < 0.7 * room["from_nothing_s"]
    assert refused["failed"] in (folder / "index.html").read_text()
