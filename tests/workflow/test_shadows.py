# SPDX-License-Identifier: Apache-2.0
"""Light and shadows are in the plan only when the survey calls for them and somebody is there."""

from __future__ import annotations

import json
from pathlib import Path

from tests.workflow.conftest import House


def test_light_is_estimated_when_shadows_move_and_not_otherwise(finished: House) -> None:
    target = "results/tiny/render/orbit.mkv"
    plans = {
        verdict: finished.plan(target, "--configfile", finished.overlay(survey={"force": {"moving_shadows": verdict}}))
        for verdict in ("on", "off")
    }
    decided = json.loads((finished.folder / "results/tiny/survey/decisions.json").read_text())["decisions"]
    measured = next(d["verdict"] for d in decided if d["effect"] == "moving_shadows")
    there = (finished.folder / "results/tiny/render/room.light.json").is_file()
    assert there == (measured == "on"), "the finished film obeyed the survey"
    if not there:
        assert plans["on"]["render_light"] == 1
        assert "render_light" not in plans["off"]
    else:
        assert plans["off"]["render_shot"] == 1, "a film with shadows is made again without"


def test_an_empty_room_needs_no_light(house: House, tmp_path: Path) -> None:
    folder = tmp_path / "empty"
    (folder / "videos").mkdir(parents=True)
    for camera in ("left", "right", "back"):
        (folder / "videos" / f"{camera}.mp4").touch()
    for name in ("intri.yml", "extri.yml"):
        (folder / name).touch()
    (folder / "capture.yaml").write_text("people: 0\n")
    there = House(house.folder, str(folder))
    plan = there.plan("--configfile", there.overlay(survey={"force": {"moving_shadows": "on"}}))
    assert plan["render_shot"] >= 1
    assert "render_light" not in plan
