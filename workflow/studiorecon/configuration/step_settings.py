# SPDX-License-Identifier: Apache-2.0
"""The settings that one step reads, so that a changed setting reruns only the steps that read it."""

from __future__ import annotations

import dataclasses
import importlib
import json
import os
import sys
import types
import typing
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from studiorecon import code
from studiorecon.configuration.setting import is_setting
from studiorecon.configuration.settings import literal_keys

# Name → the fields read below it; None = the value as a whole.
Fields = dict[str, Any]


def select_settings(step: str, section: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a stage's ``section`` that ``"stage.step"`` reads; empty for a step without settings."""
    return restrict_settings(section, settings_read_by(step))


# Steps with settings in the sections of earlier stages, in addition to their own stage's.
_SECTIONS = {
    "clocks": ("capture", "clocks"),
    "tracks": ("detect",),
    "cameras": ("calibration", "cameras"),
    "humans.train": ("survey", "humans"),
    "report.audit": ("survey",),
    "enhance.shot": ("survey", "enhance"),
}


def find_section(step: str, config: Mapping[str, Any]) -> dict[str, Any]:
    """The configuration of ``"stage.step"``: its stage's section, after those of earlier stages that it shares."""
    return {key: value for name in section_names(step) for key, value in config.get(name, {}).items()}


def section_names(step: str) -> tuple[str, ...]:
    """The sections of the configuration with settings of ``"stage.step"``."""
    stage = step.partition(".")[0]
    return _SECTIONS.get(step, _SECTIONS.get(stage, (stage,)))


def restrict_settings(values: Mapping[str, Any], fields: Fields) -> dict[str, Any]:
    """``values`` restricted to ``fields``, at every level; fields missing in ``values`` are left out."""
    cut: dict[str, Any] = {}
    for name, below in fields.items():
        if name in values:
            value = values[name]
            cut[name] = restrict_settings(value, below) if below is not None and isinstance(value, Mapping) else value
    return cut


def settings_read_by(step: str) -> Fields:
    """The settings that a step reads, from importing the step; cached until its code changes.

    Raises FileNotFoundError when there is no such step.
    """
    known, mark = _known(_memory()), f"{step} {code.digest(step)}"
    if mark not in known:
        module = importlib.import_module(f"studiorecon.{step}")
        known[mark] = setting_fields(module.Settings) if hasattr(module, "Settings") else {}
        _remember(known)
    return known[mark]


def setting_fields(kind: type) -> Fields:
    """The settings of a dataclass, without its constants; groups are dataclasses, or mappings with named keys."""
    hints = typing.get_type_hints(kind)
    return {field.name: _below(hints[field.name]) for field in dataclasses.fields(kind) if is_setting(field)}


def _below(hint: Any) -> Fields | None:
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return setting_fields(hint)
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        options = typing.get_args(hint)
        groups = [option for option in options if isinstance(option, type) and dataclasses.is_dataclass(option)]
        return setting_fields(groups[0]) if len(groups) == 1 else None
    return dict.fromkeys(literal_keys(hint)) or None


def _memory() -> Path:
    """The cache file, next to the byte code: importing every step takes seconds."""
    return code.PACKAGE / "__pycache__" / f"settings.{sys.implementation.cache_tag}.json"


@cache
def _known(memory: Path) -> dict[str, Fields]:
    # Without a readable file the steps are imported.
    with suppress(OSError, ValueError):
        stored = json.loads(memory.read_text(encoding="ascii"))
        return stored if isinstance(stored, dict) else {}
    return {}


def _remember(known: dict[str, Fields]) -> None:
    # As with Python's byte code, a read-only place means no cache.
    with suppress(OSError):
        memory = _memory()
        memory.parent.mkdir(exist_ok=True)
        partial = memory.with_suffix(f".{os.getpid()}.partial")
        # Number of steps whose fields are cached; the oldest are dropped first.
        partial.write_text(json.dumps(dict(list(known.items())[-500:])), encoding="ascii")
        partial.replace(memory)
