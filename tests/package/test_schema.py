# SPDX-License-Identifier: Apache-2.0
"""Settings are read as what the schema says they are, however they were written; mistakes name what was meant."""

from __future__ import annotations

import copy
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml
from snakemake.cli import parse_config
from snakemake.utils import update_config
from studiorecon.configuration.schema import coerce_types, mistakes, walk_settings
from studiorecon.survey.effects import EFFECTS

ROOT = Path(__file__).resolve().parents[2]


@cache
def schema() -> dict[str, Any]:
    return yaml.safe_load((ROOT / "workflow/schemas/config.schema.yaml").read_text())


@cache
def _defaults() -> dict[str, Any]:
    return yaml.safe_load((ROOT / "config/config.yaml").read_text())


def over(above: dict[str, Any]) -> dict[str, Any]:
    """The configuration with something laid over it, as the workflow takes it."""
    config = copy.deepcopy(_defaults())
    update_config(config, above)
    return coerce_types(config, schema())


def messages(*entries: str) -> dict[str, Any]:
    """The configuration with what ``snakemake --config`` makes of these."""
    return over(parse_config(entries))


def test_the_configuration_is_read_as_it_stands() -> None:
    assert over({}) == _defaults()
    assert mistakes(over({}), schema()) == []


@pytest.mark.parametrize(
    ("entry", "path", "value"),
    [
        ("people={fit: {iterations: 20}}", "people.fit.iterations", 20),
        ("people={association: {gate_m: 0.2}}", "people.association.gate_m", 0.2),
        ("people={smooth: {sigma_s: 1e-3}}", "people.smooth.sigma_s", 1e-3),
        ("render={background_rgb: [0.3, 1, 0]}", "render.background_rgb", [0.3, 1, 0]),
        ("cameras={refine: false}", "cameras.refine", False),
        ("cameras={refine: off}", "cameras.refine", False),
        ("calibration={radial: {left: -0.02}}", "calibration.radial.left", -0.02),
        ("enhance={strength: 0.4}", "enhance.strength", 0.4),
        ("enhance={strength: auto}", "enhance.strength", "auto"),
        ("survey={force: {exposure: off, people: on}}", "survey.force", {"exposure": "off", "people": "on"}),
        ("weights=7", "weights", "7"),
        ("scene=12", "scene", 12),
        ("scene=", "scene", ""),
        ("render={shots: {a: {kind: orbit, target: [1, 0, 0.5]}}}", "render.shots.a.target", [1, 0, 0.5]),
        ("render={shots: {a: {kind: follow, time: 4}}}", "render.shots.a.time", 4),
        (
            "render={shots: {a: {kind: spline, keys: [{picture: 0, camera: 1}, {picture: 9, camera: 2}]}}}",
            "render.shots.a.keys",
            [{"picture": 0, "camera": "1"}, {"picture": 9, "camera": "2"}],
        ),
    ],
)
def test_the_command_line_is_read_as_what_the_setting_is(entry: str, path: str, value: Any) -> None:
    config = messages(entry)
    assert mistakes(config, schema()) == []
    found: Any = config
    for name in path.split("."):
        found = found[name]
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize("effect", [effect.name for effect in EFFECTS if effect.acts])
def test_every_effect_that_acts_may_be_forced_by_an_unquoted_word_in_a_file(effect: str) -> None:
    config = over(yaml.safe_load(f"survey: {{force: {{{effect}: off}}}}"))
    assert config["survey"]["force"] == {effect: "off"}, "YAML reads off as false"
    assert mistakes(config, schema()) == []


def test_whole_numbers_may_be_written_with_a_point_and_small_ones_without() -> None:
    config = over(yaml.safe_load("capture: {width: 640.0}\nhumans: {rates: {position_end_m: 1e-6}}"))
    assert config["capture"]["width"] == 640
    assert isinstance(config["capture"]["width"], int)
    assert config["humans"]["rates"]["position_end_m"] == 1e-6


@pytest.mark.parametrize(
    ("entry", "sentence"),
    [
        (
            "people={fit: {iteratons: 20}}",
            "there is no setting people.fit.iteratons; did you mean people.fit.iterations?",
        ),
        ("people={beta_weight: 3}", "there is no setting people.beta_weight; did you mean people.fit.beta_weight?"),
        ("people={gate_m: 1}", "there is no setting people.gate_m; did you mean people.association.gate_m?"),
        ("datset=x", "there is no setting datset; did you mean dataset?"),
        (
            "survey={force: {exposre: off}}",
            "setting survey.force has exposre, but only effects that a step uses can be forced; did you mean exposure?",
        ),
        (
            "survey={force: {defocus: on}}",
            "setting survey.force has defocus, but only effects that a step uses can be forced: moving_cameras, "
            "people, hands, exposure, ",
        ),
        (
            "render={shots: {a: {kind: orbit, targt: p0}}}",
            "there is no setting render.shots.a.targt; did you mean render.shots.a.target?",
        ),
        ("calibration={source: file}", "setting calibration.source is 'file'; it must be one of auto, files, "),
        ("people={fit: {iterations: few}}", "setting people.fit.iterations is 'few'; it must be a whole number"),
        ("capture={width: -1}", "setting capture.width is -1; it must be at least 0"),
        ("render={shots: {a: {frames: 3}}}", "setting render.shots.a lacks kind, which is one of orbit, heldout, "),
        ("render={shots: {a: {kind: path}}}", "setting render.shots.a lacks file"),
        (
            "render={shots: {a: {kind: orbit, target: nobody}}}",
            "setting render.shots.a.target is 'nobody', but it must fit: people, scene, ",
        ),
        ("render={shots: {train: {kind: orbit}}}", "train is reserved"),
        ("render=", "setting render is empty"),
        ("depth=3", "setting depth is 3; it must be a section"),
    ],
)
def test_a_mistake_is_one_sentence_that_says_what_was_meant(entry: str, sentence: str) -> None:
    (found,) = mistakes(messages(entry), schema())
    assert sentence in found


def test_several_mistakes_are_all_told_and_misspelt_names_first() -> None:
    found = mistakes(messages("capture={width: -1}", "people={fit: {iteratons: 20, vertics: 2}}"), schema())
    assert len(found) == 3
    assert "iteratons" in found[0]
    assert "vertics" in found[1]
    assert "capture.width" in found[2]


def test_every_setting_is_named_once() -> None:
    names = [name for name, _ in walk_settings(schema())]
    assert len(names) == len(set(names)) > 150
    assert "people.fit.iterations" in names
