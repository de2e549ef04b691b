# SPDX-License-Identifier: Apache-2.0
"""One list per kind: what schema, configuration and prose say of formats and effects is what their registries say."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from studiorecon.calibration.formats import FORMATS
from studiorecon.survey.effects import EARLY, EFFECTS

from tests.layout import registry_tables

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def schema() -> dict[str, Any]:
    return yaml.safe_load((ROOT / "workflow/schemas/config.schema.yaml").read_text(encoding="utf-8"))["properties"]


@pytest.mark.parametrize(("page", "name"), registry_tables.TABLES, ids=lambda v: str(v))
def test_tables_of_the_prose_are_those_of_the_registries(page: str, name: str) -> None:
    again = "run: python -m tests.layout.registry_tables"
    assert registry_tables.standing(page, name) == registry_tables.TABLES[page, name](), again


def test_the_schema_knows_every_calibration_format(schema: dict[str, Any]) -> None:
    assert schema["calibration"]["properties"]["format"]["enum"] == ["auto", *FORMATS]


def test_every_format_file_is_listed() -> None:
    folder = ROOT / "workflow/studiorecon/calibration/formats"
    with_format = {path.stem for path in folder.glob("*.py") if "\nFORMAT = " in path.read_text(encoding="utf-8")}
    listed = {form.read.__module__.rpartition(".")[2] for form in FORMATS.values()}
    assert with_format == listed


@pytest.mark.parametrize("name", FORMATS)
def test_a_format_is_found_by_the_files_it_declares(name: str, tmp_path: Path) -> None:
    from studiorecon.plan.discovery import find_calibration

    for names in FORMATS[name].files:
        folder = tmp_path / "_".join(names).replace("/", "_").replace("*", "any")
        for file in names:
            path = folder / file.replace("*", "any")
            path.parent.mkdir(parents=True, exist_ok=True)
            # What tells a calibration from other files of its ending.
            xml = "<matrix><K>1</K><R>1</R><translation>1</translation></matrix>"
            path.write_text(xml if path.suffix == ".xml" else "{K: 1, R: 1, translation: 1} # matrix aruco_scale")
        found = [str(path.relative_to(folder)) for path in find_calibration(folder)]
        assert found == [file.replace("*", "any") for file in names]


def test_the_configuration_and_its_schema_know_every_effect(schema: dict[str, Any]) -> None:
    config = yaml.safe_load((ROOT / "config/config.yaml").read_text(encoding="utf-8"))["survey"]
    assert config["thresholds"] == config["force"] == {}, "an effect's own threshold stands in its file"
    known = schema["survey"]["properties"]
    assert set(known["thresholds"]["properties"]) == {effect.name for effect in EFFECTS if effect.tunable}
    assert set(known["force"]["propertyNames"]["enum"]) == {effect.name for effect in EFFECTS if effect.acts}


def test_rules_ask_for_effects_and_files_that_are_listed() -> None:
    """The plan names them itself: importing the list costs a second at every start."""
    plan = (ROOT / "workflow/studiorecon/plan/rule_files.py").read_text(encoding="utf-8")
    artefacts = {effect.name: effect.artefact.file for effect in EARLY if effect.artefact}
    requested = re.findall(r'self\.verdict\("(\w+)", wildcards\)(?:.*\n.*"?survey/([\w.]+)"\])?', plan)
    assert {name for name, _ in requested} <= {effect.name for effect in EARLY}
    assert {name: file for name, file in requested if file} == artefacts


def test_every_effect_file_is_listed_and_named_after_its_effect() -> None:
    folder = ROOT / "workflow/studiorecon/survey/effects"
    files = {path.stem for path in folder.glob("*.py") if "\nEFFECT = " in path.read_text(encoding="utf-8")}
    assert files <= {effect.name for effect in EFFECTS}


def test_an_effect_comes_after_those_that_hide_it() -> None:
    names = [effect.name for effect in EFFECTS]
    for place, effect in enumerate(EFFECTS):
        assert set(effect.hidden_by) <= set(names[:place]), f"{effect.name} is decided before what hides it"


def test_the_rule_makes_the_file_of_every_effect_that_writes_one() -> None:
    rule = (ROOT / "workflow/rules/survey.smk").read_text(encoding="utf-8")
    assert [e.artefact.file for e in EARLY if e.artefact and f"survey/{e.artefact.file}" not in rule] == []
