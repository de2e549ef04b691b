# SPDX-License-Identifier: Apache-2.0
"""Every setting, changed alone on a finished scene, re-runs the rules whose steps read it, and what follows from them;
nothing else."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator, Mapping
from typing import Any

import pytest
import yaml
from studiorecon.configuration.schema import mistakes
from studiorecon.configuration.step_settings import section_names, settings_read_by

from tests.workflow.conftest import QUICK, ROOT, House, over

# Read when the run is planned, not by a step: the rules whose parameters (or list of inputs) they change. "" = another
# scene or image.
PLANNED: dict[str, set[str] | None] = {
    "dataset": None,
    "scene": None,
    "capture_yaml": None,
    "images": set(),
    "body": None,
    "device": {"background_kernels", "background_train", "humans_train", "render_shot"},
    "budget_min": None,  # another preset, whose settings these are
    "strict": set(),  # a job more, not another
    "sweep": set(),
    "sweep_minutes": set(),
    "weights": set(),
    "licences": set(),
    "people.identities": None,
    "detect.network": None,  # one that has to be there
    # A folder is refused without the source that reads it.
    "detect.precomputed": None,
    "masks.precomputed": None,
    "depth.precomputed": None,
    "views.precomputed": None,
    "enhance.precomputed": None,
    "detect.network_layout": {"clocks_moments", "detect_people", "people_second_look", "cameras_held_out"},
    "depth.reference": None,  # another calibration's
    "views.people": None,  # of masks by a network
    # Another source is another rule's work.
    "depth.source": {"depth_refine"},
    "views.synthesizer": {"views_synthesize"},
    # An effect forced on is another network in the training of people.
    "survey.force": {"humans_train"},
    "capture.picture_fps": {"clocks_moments", "detect_people", "people_second_look", "detect_keypoints"},
}
# The page prints the settings that a result may depend on.
SHOWN = "report_page"
NOT_SHOWN = {"images", "strict", "sweep", "sweep_minutes"}


def leaves(values: Mapping[str, Any], above: str = "") -> Iterator[str]:
    """Dotted names of all settings of a configuration; a film is one setting, and so is an open table."""
    for name, value in values.items():
        path = f"{above}{name}"
        if isinstance(value, Mapping) and value and path != "render.shots":
            yield from leaves(value, f"{path}.")
        else:
            yield path


def at(values: Any, path: str) -> Any:
    for name in path.split("."):
        values = values[name]
    return values


def with_value(config: dict, path: str, value: Any) -> dict:
    changed = copy.deepcopy(config)
    *above, last = path.split(".")
    inner = changed
    for name in above:
        inner = inner[name]
    inner[last] = value
    return changed


def others(value: Any, schema: Mapping[str, Any]) -> Iterator[Any]:
    """Values that a setting might have instead, likeliest to be allowed first."""
    yield from (v for v in schema.get("enum", ()) if v != value)
    if isinstance(value, bool):
        yield not value
    elif isinstance(value, int):
        yield from (value + 1, value - 1, value + 2)
    elif isinstance(value, float):
        yield from (value * 1.01 + 0.001, value * 0.99 - 0.001, value * 0.99)
    elif isinstance(value, str):
        yield from (0.5, f"{value}x")
    elif isinstance(value, list):
        for index, item in enumerate(value):
            for other in others(item, {}):
                yield [*value[:index], other, *value[index + 1 :]]
    elif isinstance(value, dict):
        # Effects of every step that decides on some.
        effects = ("exposure", "temporal_appearance", "injection")
        yield from (dict.fromkeys(effects, "on"), dict.fromkeys(effects, 0.5), {"cam1": 0.01})
    elif value is None:
        yield from (1, 0.5, "x")


def settings() -> dict[str, Any]:
    """Dotted name → another value that the schema allows, of every setting of the finished house's configuration."""
    schema = yaml.safe_load((ROOT / "workflow/schemas/config.schema.yaml").read_text())
    config = over(yaml.safe_load((ROOT / "config/config.yaml").read_text()), QUICK)
    found = {}
    for path in leaves(config):
        if path == "render.shots":
            continue
        part: Any = schema
        for name in path.split("."):
            part = part.get("properties", {}).get(name, {})
        value = at(config, path)
        allowed = (v for v in others(value, part) if v != value and not mistakes(with_value(config, path, v), schema))
        found[path] = next(allowed, None)
    return found


def steps() -> dict[str, str]:
    """Rule → its step."""
    text = "\n".join(path.read_text() for path in sorted((ROOT / "workflow/rules").glob("*.smk")))
    blocks = re.split(r"\n(?= *(?:(?:use )?rule|checkpoint) )", text)
    reported = (
        (re.search(r"(?:rule|checkpoint) (\w+):", block), re.search(r"command\(\"(\w+\.\w+)\"\)", block))
        for block in blocks
    )
    found = {rule.group(1): step.group(1) for rule, step in reported if rule and step}
    again = re.findall(r"use rule (\w+) as (\w+) with:", text)
    return found | {rule: found[same] for same, rule in again}


def reads(step: str, path: str) -> bool:
    """Whether the step's settings hold the one at ``path``."""
    stage, *names = path.split(".")
    fields: Any = settings_read_by(step) if stage in section_names(step) else {}
    for name in names:
        if fields is None:
            return True
        if name not in fields:
            return False
        fields = fields[name]
    return bool(names) and (fields is None or bool(fields))


def changed_rules(house: House, values: Mapping[str, Any]) -> dict[str, set[str] | None]:
    """Setting → rules whose parameters Snakemake says have changed, each setting changed alone; None where it refuses
    the plan.

    Rules are compared one by one (rerun by time only): what follows from a change is not mixed with what it changes.
    """
    options = ("--quiet", "all", "--rerun-triggers", "mtime", "--cores", "2")
    table = [line.split("\t") for line in house.snakemake("--summary", *options).stdout.splitlines()]
    rule = {row[0]: row[2] for row in table if len(row) > 2}
    found: dict[str, set[str] | None] = {}
    for path, value in values.items():
        tree: Any = value
        for name in reversed(path.split(".")):
            tree = {name: tree}
        overlay = ("--configfile", house.overlay(**tree))
        done = house.snakemake("--list-changes", "params", *overlay, *options, check=False)
        lines = done.stdout.splitlines()
        found[path] = {rule[line] for line in lines if line in rule} if done.returncode == 0 else None
    return found


def expected(path: str, rules: Mapping[str, str], present: set[str]) -> set[str]:
    """Rules of the finished scene whose own parameters hold the setting at ``path``."""
    own = {rule for rule, step in rules.items() if reads(step, path)} | (PLANNED.get(path) or set())
    return (own | (set() if path in NOT_SHOWN else {SHOWN})) & present


def wrong_of(house: House, values: Mapping[str, Any]) -> list[str]:
    rules = steps()
    present = {line.split("\t")[2] for line in house.snakemake("--summary").stdout.splitlines() if "\t" in line}
    wrong = []
    for path, reported in changed_rules(house, values).items():
        if reported != (should := expected(path, rules, present)):
            wrong.append(f"{path}: re-runs {reported and sorted(reported)}, is read by {sorted(should)}")
    return wrong


SOME = (
    "people.association.gate_m",
    "survey.force",
    "enhance.injection.history",
    "capture.width",
    "sweep_minutes",
    "device",
)


def test_every_setting_can_be_changed() -> None:
    unchanged = [path for path, value in settings().items() if value is None and PLANNED.get(path, set()) is not None]
    assert not unchanged, "the schema allows one value only, so it is no setting"


def test_a_changed_setting_re_runs_what_reads_it_and_nothing_else(finished: House) -> None:
    values = settings()
    assert not wrong_of(finished, {path: values[path] for path in SOME})


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_every_changed_setting_re_runs_what_reads_it_and_nothing_else(finished: House) -> None:
    values = {path: value for path, value in settings().items() if PLANNED.get(path, set()) is not None}
    assert not (wrong := wrong_of(finished, values)), "\n".join(wrong)


def test_a_films_settings_are_that_films(finished: House) -> None:
    plan = finished.plan("--configfile", finished.overlay(render={"shots": {"orbit": {"frames": 7}}}))
    assert plan["render_shot"] == 1, "not the held-out film, nor the training cameras"
    assert plan["enhance_shot"] == 1
