# SPDX-License-Identifier: Apache-2.0
"""Light and shadows are in the plan only when the survey calls for them."""

from __future__ import annotations

import json

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
