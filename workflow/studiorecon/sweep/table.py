# SPDX-License-Identifier: Apache-2.0
"""A sweep's table: one configuration per row, ``name parameter preset settings``, tab-separated.

``settings`` holds ``section.key=value`` pairs, separated by `` ; ``, values as in YAML. The first row is ``base``.
Every other row changes it, except rows with a ``preset``, which change that file of ``config/presets`` instead.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from studiorecon.errors import UserError
from studiorecon.scene.files import read_table
from studiorecon.scene.names import check_name

COLUMNS = ("name", "parameter", "preset", "settings")
BASE = "base"


@dataclass(frozen=True)
class Row:
    """One configuration: name, changed parameter ("" for several), preset ("" for none), and dotted key → value."""

    name: str
    parameter: str
    preset: str
    settings: Mapping[str, Any]


def read_rows(path: Path) -> list[Row]:
    """Rows of a table; raises UserError with file and row where a name or a setting cannot be read."""
    rows: list[Row] = []
    for number, cells in enumerate(read_table(path, COLUMNS), 2):
        where, name = f"row {number} of {path}", cells["name"] or ""
        if not re.fullmatch(r"[\w.+-]+", name, re.ASCII):
            raise UserError(f"{where} has the name {name!r}; it becomes a folder's name: use letters, digits, - _ . +")
        check_name(name, where, "give it another")
        if name in [row.name for row in rows]:
            raise UserError(f"{where} repeats the name {name}; give every configuration a name of its own")
        settings = parse_settings(cells["settings"] or "", where)
        rows.append(Row(name, cells["parameter"] or "", cells["preset"] or "", settings))
    if not rows or rows[0].name != BASE:
        raise UserError(f"the first row of {path} must be called {BASE}: all other rows change it")
    return rows


def parse_settings(text: str, where: str) -> dict[str, Any]:
    """``"a.b=1 ; c.d=x"`` → {"a.b": 1, "c.d": "x"}; raises UserError for any other form."""
    settings: dict[str, Any] = {}
    for part in filter(None, (p.strip() for p in text.split(" ; "))):
        key, equals, value = part.partition("=")
        if not equals or not key.strip():
            raise UserError(f"{where}: {part!r} is not of the form section.key=value (separated by ' ; ')")
        try:
            settings[key.strip()] = yaml.safe_load(value)
        except yaml.YAMLError:
            raise UserError(f"{where}: the value of {key.strip()} is not YAML: {value!r}") from None
    return settings


def row_configuration(given: Mapping[str, Any], base: Row, row: Row, presets: Path) -> dict[str, Any]:
    """The whole configuration of one run: the given one, then base or preset, then the row's own settings."""
    below = nested(base.settings)
    if row.preset:
        path = presets / f"{row.preset}.yaml"
        if not path.is_file():
            raise UserError(f"sweep row {row.name} names the preset {row.preset}, which {presets} does not have")
        below = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
    return merge(merge(given, below), nested(row.settings))


def nested(settings: Mapping[str, Any]) -> dict[str, Any]:
    """{"a.b": 1} → {"a": {"b": 1}}."""
    result: dict[str, Any] = {}
    for key, value in settings.items():
        *path, last = key.split(".")
        node = result
        for part in path:
            node = node.setdefault(part, {})
        node[last] = value
    return result


def merge(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """``below`` with the entries of ``above``, section by section, as Snakemake merges configuration files."""
    both = {
        key: merge(below[key], value) if isinstance(value, Mapping) and isinstance(below.get(key), Mapping) else value
        for key, value in above.items()
    }
    return {**below, **both}
