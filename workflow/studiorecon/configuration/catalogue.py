# SPDX-License-Identifier: Apache-2.0
"""Every setting with its meaning and default, from config.yaml's comments and the schema."""

from __future__ import annotations

import dataclasses
import re
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from studiorecon.configuration.schema import find_schema

# A key of block style, after the lines of comment right above it.
_KEY = re.compile(r"^((?: *#.*\n)*)( *)([\w-]+):", re.MULTILINE)


@dataclass(frozen=True)
class Setting:
    """One setting or section.

    Attributes:
        name: dotted, ``people.fit.iterations``.
        meaning: in words; may be empty for a section.
        default: as YAML, None for a section.
        choices: the possible values, if they are words.
    """

    name: str
    meaning: str
    default: str | None
    choices: tuple[str, ...] = ()


def list_settings(configuration: Path, schema: Mapping[str, Any]) -> list[Setting]:
    """Every setting of config.yaml in its order, sections before their settings.

    The comment in config.yaml takes precedence over the schema's description.
    """
    text = configuration.read_text(encoding="utf-8")
    values, comments = yaml.safe_load(text), dict(_comments(text))
    found = []
    for name, value in _flat(values):
        part = find_schema(schema, name)
        meaning = comments.get(name) or part.get("description", "")
        section = isinstance(value, Mapping) and bool(value)
        found.append(
            Setting(name, meaning, None if section else _as_yaml(value), tuple(map(str, part.get("enum", ()))))
        )
    return found


def list_film_settings(kinds: Mapping[str, type], schema: Mapping[str, Any]) -> list[Setting]:
    """The settings of every kind of film, such as ``render.shots.NAME (kind orbit).frames``, with defaults."""
    found = []
    for kind, settings in kinds.items():
        described, name = schema["$defs"][kind]["properties"], f"render.shots.NAME (kind {kind})"
        found.append(Setting(name, described["kind"]["description"], None))
        for field in dataclasses.fields(settings):
            part = described[field.name]
            part = schema["$defs"][part["$ref"].rpartition("/")[2]] if "$ref" in part else part
            if field.name != "kind":
                default = "needed" if field.default is dataclasses.MISSING else _as_yaml(field.default)
                found.append(
                    Setting(f"{name}.{field.name}", part.get("description", ""), default, tuple(part.get("enum", ())))
                )
    return found


def settings_text(settings: list[Setting], columns: int) -> str:
    """The settings as text, wrapped to so many columns."""
    lines = []
    for setting in settings:
        choices = f"One of {', '.join(setting.choices)}." if setting.choices else ""
        words = setting.meaning if choices in setting.meaning else f"{setting.meaning} {choices}".strip()
        lines.append(setting.name if setting.default is None else f"{setting.name} = {setting.default}")
        lines += textwrap.wrap(words, columns, initial_indent="    ", subsequent_indent="    ")
    return "\n".join(lines)


def _flat(values: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        yield f"{above}{key}", value
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{key}.")


def _as_yaml(value: Any) -> str:
    plain = list(value) if isinstance(value, tuple) else value
    return (
        yaml.safe_dump(plain, default_flow_style=True, allow_unicode=True, width=1000)
        .removesuffix("\n")
        .removesuffix("\n...")
    )


def _comments(text: str) -> Iterator[tuple[str, str]]:
    """(dotted name, comment right above it) of every key with one."""
    path: list[str] = []
    for above, indent, name in _KEY.findall(text):
        path[len(indent) // 2 :] = [name]
        words = [line.strip().lstrip("# ") for line in above.splitlines() if not line.startswith("# ----")]
        if words:
            yield ".".join(path), " ".join(words)
