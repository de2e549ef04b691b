# SPDX-License-Identifier: Apache-2.0
"""The presets of the paper take it at its word, in every setting of which it speaks, and the page says so."""

from __future__ import annotations

import pytest
import yaml
from studiorecon.configuration import paper_settings
from studiorecon.configuration.schema import mistakes
from studiorecon.home import SCHEMA

from tests.hard import table


def test_the_page_is_up_to_date() -> None:
    assert paper_settings.PAGE.read_text(encoding="utf-8") == paper_settings.page_text(), (
        "run: python -m studiorecon.configuration.paper_settings"
    )


def test_every_setting_of_which_the_paper_speaks_has_its_word_or_a_reason() -> None:
    named = dict(paper_settings.paper_values())
    without = {name for name, setting in named.items() if setting.description.paper_value is None}
    assert without == set(paper_settings.REASONS), (
        "configuration.paper_settings.WITHOUT says why a setting has no letter"
    )


@pytest.mark.parametrize(("name", "setting"), list(paper_settings.paper_values()), ids=str)
def test_the_presets_take_every_word(name, setting) -> None:
    assert paper_settings.presets_state(name, setting, paper_settings.merge_presets()) != "not taken"


@pytest.mark.parametrize(("place", "name", "value"), [c[:3] for c in paper_settings.CONSTANTS], ids=str)
def test_a_number_that_nobody_turns_is_the_papers(place: str, name: str, value: float) -> None:
    assert paper_settings.stage_constant(place, name) == value


@pytest.mark.parametrize("reading", [r for r in table.readings() if r.literal], ids=lambda r: r.id)
def test_the_presets_read_the_paper_literally(reading: table.Reading) -> None:
    config = paper_settings.merge_presets()
    for pair in table.pairs(reading.literal):
        name, _, value = pair.partition("=")
        assert paper_settings.value_at(config, name) == yaml.safe_load(value), f"{reading.id}: {name}"


def test_the_whole_preset_is_a_configuration() -> None:
    assert mistakes(paper_settings.merge_presets(), yaml.safe_load(SCHEMA.read_text(encoding="utf-8"))) == []
