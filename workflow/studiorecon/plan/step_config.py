# SPDX-License-Identifier: Apache-2.0
"""The settings of each step: only those that it reads, so that changes of other settings do not rerun it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from studiorecon.configuration.step_settings import find_section, select_settings


def step_section(step: str, config: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a step's section, with the decisions of ``survey.force`` over them."""
    stage, values, forced = step.partition(".")[0], find_section(step, config), config["survey"]["force"]
    if stage == "people" and "hands" in forced:
        values["hands"] = forced["hands"]
    if stage == "humans" and "temporal_appearance" in forced:
        use = "always" if forced["temporal_appearance"] == "on" else "never"
        values["temporal"] = values["temporal"] | {"use": use}
    if stage == "enhance" and forced.get("enhancement") == "off":
        values["enhancer"] = "none"
    if stage == "enhance" and forced.get("injection") == "off":
        values["injection"] = values["injection"] | {"history": 0}
    return values


def step_settings(step: str, config: Mapping[str, Any]) -> str:
    """The settings that one step reads, as JSON."""
    return json.dumps(select_settings(step, step_section(step, config)), sort_keys=True)


def recursion_settings(config: Mapping[str, Any]) -> str:
    """The settings of the recursive module for the training of the room, as JSON."""
    return json.dumps(step_section("enhance", config)["injection"], sort_keys=True)


def shot_settings(step: str, config: Mapping[str, Any], keys: tuple[str, ...] = ()) -> Callable[[Any], str]:
    """Function from wildcards to a step's settings for one shot, as JSON: of it ``keys``, or all that the film
    needs."""

    def of_shot(wildcards: Any) -> str:
        given = config["render"]["shots"].get(wildcards.shot, {})
        own = {key: value for key, value in given.items() if (key in keys if keys else key != "reference")}
        shots = {wildcards.shot: own} if own else {}
        return json.dumps(select_settings(step, step_section("render", config) | {"shots": shots}), sort_keys=True)

    return of_shot


def report_settings(config: Mapping[str, Any]) -> str:
    """The settings that the page shows, as JSON: all except those that do not affect the result."""
    shown = {key: value for key, value in config.items() if key not in ("strict", "sweep", "sweep_minutes", "images")}
    return json.dumps(shown, sort_keys=True)
