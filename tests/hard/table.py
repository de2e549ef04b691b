# SPDX-License-Identifier: Apache-2.0
"""The hard cases of the arithmetic (``rows.tsv``) and the readings of the paper (``readings.tsv``).

A test holds a hard case when the case's id is part of its pytest id or name: ``pytest -m "" -k t13`` runs T13.
``python -m tests.hard.table`` writes docs/readings.md.
"""

from __future__ import annotations

import csv
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
READINGS = ROOT / "docs/readings.md"
PACKAGE = ROOT / "workflow" / "studiorecon"
# How many rows each letter of the design's table has.
ROW_COUNTS = {
    "C": 12,
    "R": 21,
    "T": 16,
    "S": 7,
    "D": 7,
    "A": 15,
    "M": 7,
    "F": 9,
    "L": 8,
    "G": 16,
    "I": 14,
    "O": 8,
    "E": 14,
    "V": 7,
}
READING_COUNT = 60

_ROW_ID = re.compile(r"(?<![A-Za-z0-9])([CRTSDAMFLGIOEVcrtsdamflgioev]\d\d)(?![0-9])")

MADE = "Written by `python -m tests.hard.table`; do not edit by hand."
READINGS_HEAD = f"""# Readings

{MADE}

Passages of the paper that allow several readings, each with the reading used here and its settings
([their values](paper.md)). `git grep -w U07` lists the code.
"""


@dataclass(frozen=True)
class Row:
    """One hard case: its id and a few words."""

    id: str
    what: str


@dataclass(frozen=True)
class Reading:
    """One reading of an ambiguous passage.

    Attributes:
        id: U01 to U60.
        settings: ``key=value`` of config.yaml, several with ``; ``; empty when nothing is to be switched.
        literal: ``key=value`` of the paper's letter, as far as it is one and can be run; empty where it cannot.
        reading: what is taken and, without a setting, why there is none.
        module: where in ``studiorecon`` it is.
    """

    id: str
    settings: str
    literal: str
    reading: str
    module: str


def rows() -> list[Row]:
    """The hard cases in the order of ``rows.tsv``."""
    return [Row(**line) for line in _lines("rows.tsv")]


def readings() -> list[Reading]:
    """The readings in the order of ``readings.tsv``."""
    return [Reading(**line) for line in _lines("readings.tsv")]


def _lines(name: str) -> list[dict[str, str]]:
    with (HERE / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE))


def pairs(text: str) -> list[str]:
    """The ``key=value`` of a cell."""
    return [part.strip() for part in text.split(";") if part.strip()]


def module_path(module: str) -> Path:
    """The file of ``geometry.camera_path`` under the package."""
    return PACKAGE.joinpath(*module.split(".")).with_suffix(".py")


def collected() -> list[str]:
    """The pytest ids of all tests, slow ones included; RuntimeError when a test file cannot be imported."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-m", "", "-p", "no:cacheprovider", "tests"]
    listing = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if listing.returncode != 0:
        raise RuntimeError(f"pytest cannot collect the tests:\n{listing.stdout[-2000:]}{listing.stderr[-2000:]}")
    return [line for line in listing.stdout.splitlines() if "::" in line]


def rows_of(test: str) -> set[str]:
    """The row ids in a pytest id: ``tests/hard/test_a.py::test_d01_x[E03-1]`` carries D01 and E03; the file's name does
    not count."""
    return {match.upper() for match in _ROW_ID.findall(test.partition("::")[2].replace("_", " "))}


def tests_by_row(tests: Sequence[str]) -> dict[str, Counter[str]]:
    """Row id → test function (``hard/test_a.py::test_x``) → number of its cases that carry the id."""
    found: dict[str, Counter[str]] = {}
    for test in tests:
        for row in rows_of(test):
            found.setdefault(row, Counter())[test.partition("[")[0].removeprefix("tests/")] += 1
    return found


def reading_table() -> str:
    """The text of docs/readings.md."""
    return "\n".join([READINGS_HEAD, *(f"- **{one.id}** {one.reading}{_settings(one)}" for one in readings()), ""])


def _settings(reading: Reading) -> str:
    """The names of a reading's settings in brackets."""
    names = dict.fromkeys(
        pair.partition("=")[0] for text in (reading.settings, reading.literal) for pair in pairs(text)
    )
    return f" ({', '.join(f'`{name}`' for name in names)})" if names else ""


if __name__ == "__main__":
    READINGS.write_text(reading_table(), encoding="utf-8")
