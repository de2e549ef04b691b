# SPDX-License-Identifier: Apache-2.0
"""What rules ask for: a GPU where they compute on one, and the memory that they took when they were last measured."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from snakemake.utils import update_config
from studiorecon.plan import memory
from studiorecon.plan.decisions import Plan
from studiorecon.plan.make import make_plan
from studiorecon.plan.networks import read_images
from studiorecon.scene.files import read_json

from benchmarks.memory import RESULTS, submitted

# Arguments of steps that compute on a GPU: where to, and networks' files.
COMPUTES = re.compile(r"^ +(device|weights|lpips)=", re.MULTILINE)


def planned(config: dict[str, Any], home: Path, presets: list[str]) -> tuple[Plan, dict[str, Any]]:
    """The plan of these presets, and their configuration, with SMPL's file replaced by the embedded body."""
    for preset in presets:
        update_config(config, yaml.safe_load((home / f"config/presets/{preset}.yaml").read_text(encoding="utf-8")))
    config["body"] = "resources/body.npz"
    return make_plan(config, home), config


def requested(plan: Plan, config: dict[str, Any], home: Path, attempt: int = 1) -> dict[str, tuple[int, int]]:
    """Rule → megabytes and GPUs that its job asks for."""
    names = {
        **vars(memory),
        "PLAN": plan,
        "config": config,
        "gpus": read_images(config, home).gpus,
    }
    found = {}
    for rule, block in submitted().items():
        mem, gpu = (re.search(rf"^ +{key}=(.+),$", block, re.MULTILINE) for key in ("mem_mb", "gpu"))
        assert mem, f"{rule} asks for no memory"
        held = eval(gpu.group(1), names) if gpu else 0
        held = held(None, SimpleNamespace(decided_before=[])) if callable(held) else held
        found[rule] = eval(mem.group(1), names)(None, attempt), held
    return found


def test_on_a_gpu_every_job_that_computes_there_asks_for_one(configured: Callable, home: Path) -> None:
    plan, config = planned(configured(calibration={"source": "pi3"}), home, ["paper", "networks"])
    asked = requested(plan, config, home)
    computing = {rule for rule, block in submitted().items() if COMPUTES.search(block)} - {"weights", "weights_list"}
    assert {"humans_train", "render_shot", "enhance_segment", "views_generate"} <= computing
    assert {rule: asked[rule][1] for rule in computing} == dict.fromkeys(computing, 1)
    assert {rule for rule, (_, gpu) in asked.items() if gpu} == computing
    without, config = planned(configured(device="cpu"), home, ["paper"])
    assert not any(
        requested(without, config, home)[rule][1] for rule in computing - {"views_generate", "humans_canonical"}
    )


@pytest.mark.parametrize("name", sorted(read_json(RESULTS)))
def test_every_rule_asks_for_what_it_took_when_it_was_last_measured(
    configured: Callable, home: Path, name: str
) -> None:
    measured = read_json(RESULTS)[name]
    four_cameras = configured(dataset="resources/studio/tiny.yaml")
    asked = requested(*planned(four_cameras, home, measured["presets"]), home)
    short = {rule: (asked[rule][0], peak) for rule, peak in measured["peak_mb"].items() if asked[rule][0] < peak}
    assert not short, "ask for more in workflow/rules: rule → (asked, took), megabytes"
