# SPDX-License-Identifier: Apache-2.0
"""A sweep's table: one configuration a row, ``name parameter preset settings``, tab-separated.

``settings`` holds ``section.key=value`` pairs, separated by `` ; ``, values as in YAML. The first row is called
``base``; every other row is laid over it, except rows with a ``preset``, which start from that file of
``config/presets`` instead.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from studiorecon.errors import UserError
from studiorecon.scene.files import read_table

COLUMNS = ("name", "parameter", "preset", "settings")
BASE = "base"


@dataclass(frozen=True)
class Configuration:
    """One row: its name, the parameter it turns ("" for several), its preset ("" for none) and dotted key → value."""

    name: str
    parameter: str
    preset: str
    settings: Mapping[str, Any]


def read_configurations(path: Path, defaults: Mapping[str, Any], presets: Path) -> list[Configuration]:
    """Every row, checked against the configuration's own keys; UserError naming file, row and key otherwise."""
    rows = read_table(path, COLUMNS)
    if not rows or rows[0]["name"] != BASE:
        raise UserError(f"the first row of {path} must be called {BASE}: all others are laid over it")
    found: list[Configuration] = []
    for number, row in enumerate(rows, 2):
        where = f"row {number} of {path}"
        name = row["name"]
        if not name or not all(c.isalnum() or c in "-_.+" for c in name):
            raise UserError(f"{where} has the name {name!r}; it becomes a folder's name: use letters, digits, - _ . +")
        if any(name == other.name for other in found):
            raise UserError(f"{where} is the second one called {name}; every configuration needs a name of its own")
        if row["preset"] and not (presets / f"{row['preset']}.yaml").is_file():
            raise UserError(f"{where} names the preset {row['preset']}, which {presets} does not have")
        found.append(
            Configuration(
                name, row["parameter"] or "", row["preset"] or "", parse_settings(row["settings"] or "", where)
            )
        )
        for key, value in found[-1].settings.items():
            check_key(defaults, key, value, where)
    return found


def parse_settings(text: str, where: str) -> dict[str, Any]:
    """``"a.b=1 ; c.d=x"`` → {"a.b": 1, "c.d": "x"}; UserError for anything that is not of that form."""
    settings: dict[str, Any] = {}
    for part in filter(None, (p.strip() for p in text.split(" ; "))):
        key, equals, value = part.partition("=")
        if not equals or not key.strip():
            raise UserError(f"{where}: {part!r} is not of the form section.key=value (separated by ' ; ')")
        try:
            settings[key.strip()] = yaml.safe_load(value)
        except yaml.YAMLError:
            raise UserError(f"{where}: the value of {key.strip()} is not readable: {value!r}") from None
    return settings


def format_settings(settings: Mapping[str, Any]) -> str:
    """The inverse of ``parse_settings``."""
    return " ; ".join(
        f"{key}={yaml.safe_dump(value, default_flow_style=True).removesuffix(chr(10)).removesuffix('...').strip()}"
        for key, value in settings.items()
    )


def check_key(defaults: Mapping[str, Any], key: str, value: Any, where: str) -> None:
    """UserError unless the configuration has this key and it holds a value of the same kind.

    A film leaves out what its kind's defaults say, so of a film's own settings only the film is looked for; its run's
    schema does the rest.
    """
    node: Any = defaults
    parts = key.split(".")
    for part in parts[:3] if parts[:2] == ["render", "shots"] else parts:
        if not isinstance(node, Mapping) or part not in node:
            raise UserError(f"{where} sets {key}, which config/config.yaml does not have")
        node = node[part]
    if parts[:2] == ["render", "shots"] and len(parts) > 3:
        return
    if isinstance(node, Mapping) != isinstance(value, Mapping):
        raise UserError(
            f"{where} sets {key} to {value!r}, but that setting is "
            f"{'a section' if isinstance(node, Mapping) else 'one value'}"
        )


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


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """``below`` with the entries of ``above``, section by section, as Snakemake lays one configuration file over
    another."""
    return {
        **below,
        **{
            k: merged(below[k], v) if isinstance(v, Mapping) and isinstance(below.get(k), Mapping) else v
            for k, v in above.items()
        },
    }


def full_configuration(
    given: Mapping[str, Any], base: Configuration, row: Configuration, presets: Path
) -> dict[str, Any]:
    """The whole configuration of one run: as given, then base or preset, then the row's own settings."""
    if row.preset:
        below = merged(given, yaml.safe_load((presets / f"{row.preset}.yaml").read_text(encoding="utf-8")) or {})
    else:
        below = merged(given, nested(base.settings))
    return merged(below, nested(row.settings))


def changes(row: Configuration, base: Configuration) -> dict[str, Any]:
    """Dotted settings in which a run differs from the configuration that the sweep was started with (a preset's own not
    repeated)."""
    return dict(row.settings) if row.preset else {**base.settings, **row.settings}
