# SPDX-License-Identifier: Apache-2.0
"""Every setting is declared once, and config.yaml, schema and the tables of config/README.md are what that makes."""

from __future__ import annotations

import dataclasses
import importlib
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import pytest
import yaml
from studiorecon.configuration import generate
from studiorecon.configuration.sections import SECTIONS, Section
from studiorecon.configuration.setting import Setting, field_default, is_setting
from studiorecon.configuration.step_settings import Fields, find_section, settings_read_by
from studiorecon.home import CONFIGURATION

# Tables of which a step is told what concerns it.
OPEN = {"thresholds", "force"}
RULES = Path(__file__).resolve().parents[2] / "workflow/rules"


@pytest.mark.parametrize(("path", "text_of"), generate.FILES.items(), ids=lambda value: getattr(value, "name", ""))
def test_generated_files_are_up_to_date(path: Path, text_of: Callable[[str], str]) -> None:
    there = path.read_text(encoding="utf-8")
    assert text_of(there) == there, "run: python -m studiorecon.configuration.generate"


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.name)
def test_a_setting_is_declared_once_with_its_meaning(section: Section) -> None:
    names = [setting.name for setting in section.settings()]
    assert len(names) == len(set(names))
    for setting in every(section.settings()):
        assert setting.description.meaning.endswith("."), f"{section.name}.{setting.name} says nothing"


def every(settings: Iterable[Setting]) -> Iterator[Setting]:
    for setting in settings:
        yield setting
        if setting.is_section:
            yield from every(setting.inner())


def steps() -> list[str]:
    return sorted({s for p in RULES.glob("*.smk") for s in re.findall(r'settings\("(\w+\.\w+)"', p.read_text())})


@pytest.mark.parametrize("step", steps())
def test_what_a_step_reads_stands_where_it_looks(step: str) -> None:
    there = find_section(step, yaml.safe_load(CONFIGURATION.read_text(encoding="utf-8")))
    assert not missing(settings_read_by(step), there), f"{step} reads what no section declares"


def missing(wanted: Fields, there: dict) -> list[str]:
    return [
        name
        for name, below in wanted.items()
        if name not in there or (isinstance(below, dict) and name not in OPEN and missing(below, there[name]))
    ]


@pytest.mark.parametrize("step", steps())
def test_a_constant_has_no_setting_s_name(step: str) -> None:
    """Else what is set for another step of the section would turn it."""
    there = find_section(step, yaml.safe_load(CONFIGURATION.read_text(encoding="utf-8")))
    kind = getattr(importlib.import_module(f"studiorecon.{step}"), "Settings", None)
    fields = dataclasses.fields(kind) if kind else ()
    constants = {f.name for f in fields if not is_setting(f) and field_default(f) is not dataclasses.MISSING}
    assert not constants & set(there)
