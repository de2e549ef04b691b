# SPDX-License-Identifier: Apache-2.0
"""The tables of hard cases and readings say what is there: complete, in the configuration, up to date."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest
import yaml

from tests.conftest import EVERY_TEST
from tests.hard import table

AGAIN = "run: python -m tests.hard.table"


@pytest.fixture(scope="module")
def found(request: pytest.FixtureRequest) -> dict[str, Counter[str]]:
    return table.tests_by_row(request.config.stash.get(EVERY_TEST, None) or table.collected())


def test_every_row_of_the_design_is_listed_once() -> None:
    ids = [row.id for row in table.rows()]
    assert ids == [f"{letter}{n:02d}" for letter, count in table.ROW_COUNTS.items() for n in range(1, count + 1)]
    assert len(ids) == 161
    assert all(row.what for row in table.rows())


def test_the_page_is_up_to_date() -> None:
    assert table.READINGS.read_text(encoding="utf-8") == table.reading_table(), AGAIN


def test_every_row_is_held_by_a_test(found: dict[str, Counter[str]]) -> None:
    assert {row.id for row in table.rows()} == set(found)


def test_every_reading_is_listed_once() -> None:
    assert [reading.id for reading in table.readings()] == [f"U{n:02d}" for n in range(1, table.READING_COUNT + 1)]


@pytest.mark.parametrize("reading", table.readings(), ids=lambda r: r.id)
def test_a_reading_names_its_setting_with_the_default_and_its_place(reading: table.Reading) -> None:
    config = yaml.safe_load((table.ROOT / "config/config.yaml").read_text(encoding="utf-8"))
    assert reading.reading
    assert table.module_path(reading.module).is_file(), (
        f"{reading.id} names studiorecon.{reading.module}, which is not there"
    )
    for setting in table.pairs(reading.settings):
        key, _, value = setting.partition("=")
        assert default_of(config, key) == yaml.safe_load(value), f"{reading.id}: {key} is not {value} in config.yaml"


@pytest.mark.parametrize("reading", [r for r in table.readings() if r.literal], ids=lambda r: r.id)
def test_the_paper_s_letter_can_be_chosen(reading: table.Reading) -> None:
    """Every setting of the letter is one that the configuration has, and together they are a configuration that is
    accepted."""
    config = yaml.safe_load((table.ROOT / "config/config.yaml").read_text(encoding="utf-8"))
    for setting in table.pairs(reading.literal):
        key, _, value = setting.partition("=")
        default_of(config, key)
        *sections, last = key.split(".")
        section = config
        for name in sections:
            section = section[name]
        section[last] = yaml.safe_load(value)
    from snakemake.utils import validate

    validate(config, str(table.ROOT / "workflow/schemas/config.schema.yaml"))
    assert {s.partition("=")[0] for s in table.pairs(reading.literal)} & {
        s.partition("=")[0] for s in table.pairs(reading.settings)
    }


def default_of(config: dict[str, Any], key: str) -> Any:
    value: Any = config
    for part in key.split("."):
        assert part in value, f"config.yaml has no {key}"
        value = value[part]
    return value
