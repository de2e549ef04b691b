# SPDX-License-Identifier: Apache-2.0
"""Settings, their values, keys of capture.yaml, steps and commands that messages advise exist and are accepted."""

from __future__ import annotations

import ast
import copy
import re
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from snakemake.utils import update_config
from studiorecon.configuration.schema import mistakes
from studiorecon.scene import capture_yaml

from tests.made.sources import tree

ROOT = Path(__file__).resolve().parents[2]
CONFIG = yaml.safe_load((ROOT / "config/config.yaml").read_text())
# ``set depth.source to embedded``, ``calibration.unit: cm``, ``the setting capture.picture_fps``
SETTING = re.compile(
    rf"\b(?:{'|'.join(k for k, v in CONFIG.items() if isinstance(v, dict))})\.[a-z_]+(?:\.[a-z_]+)*(?![\w./(])"
)
IN_CAPTURE = re.compile(r"\b([a-z_]+): (?:[{\[\d][^\x00]*? )?(?:in|into) capture\.yaml|in capture\.yaml: ([a-z_]+):")
# ``set depth.source to embedded``, ``views.synthesizer: warp``, with a value and not the beginning of a phrase
VALUE = re.compile(rf"({SETTING.pattern})(?: to |: )(?!a |an |the |one |{{|it )([a-z0-9_.]+)")
# ``run masks.network again``, ``snakemake weights``
STEP = re.compile(r"\brun ([a-z_]+\.[a-z_]+) again")
TARGET = re.compile(r"\bsnakemake (?:--cores all )?([a-z_]+)\b")
# Files and texts of other tools: their names have a dot as settings do.
FILE = re.compile(r"\.(?:json|npz|yaml|svg|ply|txt|md|sfm)$")


@cache
def messages() -> list[tuple[str, str]]:
    """(place, text) of every text in the package that is no docstring, with NUL for what is filled in."""
    found = []
    for path in sorted((ROOT / "workflow/studiorecon").rglob("*.py")):
        nodes = list(ast.walk(tree(path)))
        prose = {id(n.value) for n in nodes if isinstance(n, ast.Expr)}
        for node in nodes:
            if isinstance(node, ast.JoinedStr):
                text = "".join(v.value if isinstance(v, ast.Constant) else "\0" for v in node.values)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in prose:
                text = node.value
            else:
                continue
            if " " in text and "{{" not in text:  # no template of a page
                found.append((f"{path.relative_to(ROOT)}:{node.lineno}", text))
    return found


def is_step(name: str) -> bool:
    """Whether the name is a step or another module, STAGE.STEP."""
    return (ROOT / "workflow/studiorecon" / Path(*name.split("."))).with_suffix(".py").is_file()


def exists(setting: str) -> bool:
    """Whether config.yaml has a value at these keys. Below a free mapping, such as survey.force, any key is good."""
    value = CONFIG
    for key in setting.split("."):
        if value == {}:
            return True
        if not isinstance(value, dict) or key not in value:
            return False
        value = value[key]
    return True


def test_settings_that_messages_name_exist() -> None:
    named = [(p, s) for p, text in messages() if "/studio/" not in p for s in SETTING.findall(text)]
    named = [(place, name) for place, name in named if not FILE.search(name) and not is_step(name)]
    assert len(named) > 100
    assert [(place, setting) for place, setting in named if not exists(setting)] == []


def test_keys_of_capture_yaml_that_messages_name_are_read() -> None:
    source = Path(capture_yaml.__file__).read_text()
    named = [(p, a or b) for p, text in messages() for a, b in IN_CAPTURE.findall(text)]
    assert len({key for _, key in named}) > 5
    assert [(place, key) for place, key in named if f'"{key}"' not in source] == []


def test_values_that_messages_advise_are_accepted() -> None:
    schema = yaml.safe_load((ROOT / "workflow/schemas/config.schema.yaml").read_text())
    advised = {found: place for place, text in messages() if "/studio/" not in place for found in VALUE.findall(text)}
    refused, tried = [], 0
    for (setting, value), place in advised.items():
        if exists(setting) and not is_step(setting):
            nested: Any = yaml.safe_load(value.rstrip("."))
            for key in reversed(setting.split(".")):
                nested = {key: nested}
            config = copy.deepcopy(CONFIG)
            update_config(config, nested)
            refused += [(place, wrong) for wrong in mistakes(config, schema)]
            tried += 1
    assert tried > 20
    assert refused == []


def test_steps_and_commands_that_messages_name_exist() -> None:
    rules = "".join(path.read_text() for path in [*ROOT.glob("workflow/**/*.smk"), ROOT / "Snakefile"])
    named = [(place, step) for place, text in messages() for step in STEP.findall(text)]
    assert [(place, step) for place, step in named if not is_step(step)] == []
    targets = [(place, target) for place, text in messages() for target in TARGET.findall(text)]
    assert len(targets) > 3
    assert [(p, target) for p, target in targets if f"rule {target}:" not in rules and target != "again"] == []
