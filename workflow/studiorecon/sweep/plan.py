# SPDX-License-Identifier: Apache-2.0
"""``sweep.plan``: a table of configurations from the list of parameters: one at a time, a full factorial of some, or a
Latin hypercube.

``python -m studiorecon sweep.plan --parameters-file config/sweeps/parameters.tsv --design one_at_a_time --table
config/sweeps/one_at_a_time.tsv``
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.progress import say
from studiorecon.scene.files import read_table, write_table
from studiorecon.sweep.table import BASE, COLUMNS, Configuration, format_settings, parse_settings

PARAMETER_COLUMNS = ("parameter", "levels", "stage", "cost grows with", "missing")


@dataclass(frozen=True)
class Level:
    """One position of a parameter: a short name, and what it sets; nothing where it is the base's own."""

    name: str
    settings: Mapping[str, Any]


@dataclass(frozen=True)
class Parameter:
    """A parameter of the method; without levels there is a sentence in ``missing`` why this project cannot turn it."""

    name: str
    levels: tuple[Level, ...]
    missing: str


def parameters(path: Path) -> list[Parameter]:
    """Every parameter of the list, the row called base included; UserError naming the row for anything unreadable.

    Levels are written ``name: key=value ; key=value | name: …``; ``name:`` alone is the base's own position.
    """
    found = []
    for number, row in enumerate(read_table(path, PARAMETER_COLUMNS), 2):
        where = f"row {number} of {path}"
        levels = []
        for part in filter(None, (p.strip() for p in (row["levels"] or "").split(" | "))):
            name, colon, settings = part.partition(":")
            if not colon:
                raise UserError(f"{where}: level {part!r} is not of the form name: key=value")
            levels.append(Level(name.strip(), parse_settings(settings, where)))
        if bool(levels) == bool(row["missing"]):
            raise UserError(
                f"{where}: parameter {row['parameter']} needs either levels or the reason why there are none"
            )
        found.append(Parameter(row["parameter"], tuple(levels), row["missing"] or ""))
    if not found or found[0].name != BASE or len(found[0].levels) != 1:
        raise UserError(
            f"the first row of {path} must be called {BASE} and have one level: what every other row is laid over"
        )
    return found


def one_at_a_time(known: Sequence[Parameter]) -> list[Configuration]:
    """Every level of every parameter beside the base, without the levels that are the base itself."""
    return [
        Configuration(level.name, parameter.name, "", level.settings)
        for parameter in known[1:]
        for level in parameter.levels
        if level.settings
    ]


def factorial(known: Sequence[Parameter], names: Sequence[str]) -> list[Configuration]:
    """Every combination of the levels of the named parameters, but for the base itself."""
    if absent := [name for name in names if name not in [parameter.name for parameter in known if parameter.levels]]:
        raise UserError(f"there is no parameter {absent[0]!r} with levels in the list of parameters")
    chosen = [parameter for name in names for parameter in known if parameter.name == name]
    return [
        row
        for levels in product(*(parameter.levels for parameter in chosen))
        if (row := _joined("+".join(level.name for level in levels), levels)).settings
    ]


def hypercube(known: Sequence[Parameter], rows: int, seed: int) -> list[Configuration]:
    """Random configurations in which every level of every parameter comes up equally often, give or take one: McKay,
    Beckman, Conover 1979, for parameters with few positions."""
    rng = np.random.default_rng(seed)
    turned = [parameter for parameter in known[1:] if parameter.levels]
    drawn = [rng.permutation(np.arange(rows) % len(parameter.levels)) for parameter in turned]
    return [
        _joined(f"random-{row:02d}", [parameter.levels[column[row]] for parameter, column in zip(turned, drawn)])
        for row in range(rows)
    ]


def run(parameters_file: Path, design: str, table: Path, names: list[str], rows: int = 20, seed: int = 0) -> None:
    """Write a table; ``names`` are the parameters of a factorial, ``rows`` and ``seed`` are a Latin hypercube's."""
    known = parameters(parameters_file)
    designs = {
        "one_at_a_time": lambda: one_at_a_time(known),
        "factorial": lambda: factorial(known, names),
        "latin_hypercube": lambda: hypercube(known, rows, seed),
    }
    if design not in designs:
        raise UserError(f"there is no design {design!r}; it must be one of {', '.join(designs)}")
    made = [Configuration(BASE, "", "", known[0].levels[0].settings), *designs[design]()]
    write_table(table, COLUMNS, [(c.name, c.parameter, c.preset, format_settings(c.settings)) for c in made])
    say(f"{table}: {len(made)} configurations, the base included")


def _joined(name: str, levels: Sequence[Level]) -> Configuration:
    settings: dict[str, Any] = {}
    for level in levels:
        settings |= level.settings
    return Configuration(name, "", "", settings)
