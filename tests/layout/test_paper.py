# SPDX-License-Identifier: Apache-2.0
"""The presets of the paper take it at its word, in every setting of which it speaks, and the page says so."""

from __future__ import annotations

import pytest
import yaml
from studiorecon.configuration import letter
from studiorecon.configuration.schema import mistakes
from studiorecon.home import SCHEMA

from tests.hard import table


def test_the_page_is_up_to_date() -> None:
    assert letter.PAGE.read_text(encoding="utf-8") == letter.page(), "run: python -m studiorecon.configuration.letter"


def test_every_setting_of_which_the_paper_speaks_has_its_word_or_a_reason() -> None:
    named = dict(letter.spoken_of())
    without = {name for name, setting in named.items() if setting.described.letter is None}
    assert without == set(letter.WITHOUT), "configuration.letter.WITHOUT says why a setting has no letter"


@pytest.mark.parametrize(("name", "setting"), list(letter.spoken_of()), ids=str)
def test_the_presets_take_every_word(name, setting) -> None:
    assert letter.state(name, setting, letter.merged()) != "not taken"


@pytest.mark.parametrize(("place", "name", "value"), [c[:3] for c in letter.CONSTANTS], ids=str)
def test_a_number_that_nobody_turns_is_the_papers(place: str, name: str, value: float) -> None:
    assert letter.constant(place, name) == value


@pytest.mark.parametrize("reading", [r for r in table.readings() if r.literal], ids=lambda r: r.id)
def test_the_presets_read_the_paper_literally(reading: table.Reading) -> None:
    config = letter.merged()
    for pair in table.pairs(reading.literal):
        name, _, value = pair.partition("=")
        assert letter.value_at(config, name) == yaml.safe_load(value), f"{reading.id}: {name}"


def test_the_whole_preset_is_a_configuration() -> None:
    assert mistakes(letter.merged(), yaml.safe_load(SCHEMA.read_text(encoding="utf-8"))) == []
