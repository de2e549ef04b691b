# SPDX-License-Identifier: Apache-2.0
"""A step is told the settings that it reads, and no other."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import pytest
from studiorecon import code
from studiorecon.configuration import step_settings
from studiorecon.configuration.setting import setting
from studiorecon.configuration.settings import load


@dataclasses.dataclass(frozen=True)
class Inner:
    sigma: float = setting(1.0, "Width.")
    constant: float = 2.0


@dataclasses.dataclass(frozen=True)
class Outer:
    count: int = setting(0, "How many.")
    inner: Inner = setting(Inner(), "A group.")
    maybe: Inner | None = setting(None, "A group or none.")
    own: Mapping[Literal["mine", "ours"], float] = setting({}, "What it reads of a table.")
    any_of: dict[str, float] = setting({}, "A whole table.")
    constant: int = 3


GIVEN = {
    "count": 1,
    "others": 5,
    "inner": {"sigma": 1.0, "others": 5},
    "constant": 3,
    "maybe": None,
    "own": {"mine": 1.0, "theirs": 2.0},
    "any_of": {"a": 1.0, "b": 2.0},
}
TOLD = {"count": 1, "inner": {"sigma": 1.0}, "maybe": None, "own": {"mine": 1.0}, "any_of": {"a": 1.0, "b": 2.0}}


def test_what_a_step_does_not_read_is_left_out_at_every_level() -> None:
    assert step_settings.restrict_settings(GIVEN, step_settings.setting_fields(Outer)) == TOLD


def test_a_step_loads_the_same_from_its_settings_as_from_the_whole_section() -> None:
    assert load(Outer, TOLD, "x") == load(Outer, GIVEN, "x")


def test_a_step_says_once_what_it_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        code,
        "PACKAGE",
        shutil.copytree(code.PACKAGE, tmp_path / "studiorecon", ignore=shutil.ignore_patterns("__pycache__")),
    )
    step_settings._known.cache_clear()
    smooth = {"forget_s": 1.0, "sigma_s": 2.0, "passes": "average"}
    assert step_settings.select_settings("people.fit", {"smooth": smooth, "review": {}}) == {
        "smooth": {"forget_s": 1.0, "sigma_s": 2.0}
    }, "the third is a constant"
    (memory,) = (tmp_path / "studiorecon/__pycache__").glob("settings.*.json")
    assert len(json.loads(memory.read_text())) == 1
    step_settings._known.cache_clear()
    monkeypatch.setattr(step_settings.importlib, "import_module", lambda name: pytest.fail("imported again"))
    assert "smooth" in step_settings.settings_read_by("people.fit")
    (tmp_path / "studiorecon/people/fit.py").write_text("class Settings: ...\n")
    with pytest.raises(pytest.fail.Exception):
        step_settings.settings_read_by("people.fit")
    step_settings._known.cache_clear()
