# SPDX-License-Identifier: Apache-2.0
"""Which settings a step is told: those that it reads, so that a change of another one does not run it again."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from studiorecon.configuration.step_settings import section_of, told


def section(step: str, config: Mapping[str, Any]) -> dict[str, Any]:
    """What a step may be told. Where ``survey.force`` decides on what it has a setting for, the setting follows."""
    stage, values, forced = step.partition(".")[0], section_of(step, config), config["survey"]["force"]
    if stage == "humans" and "temporal_appearance" in forced:
        use = "always" if forced["temporal_appearance"] == "on" else "never"
        values["temporal"] = values["temporal"] | {"use": use}
    if stage == "enhance" and forced.get("enhancement") == "off":
        values["enhancer"] = "none"
    if stage == "enhance" and forced.get("injection") == "off":
        values["injection"] = values["injection"] | {"history": 0}
    return values


def settings(step: str, config: Mapping[str, Any]) -> str:
    """The settings that one step reads, as JSON."""
    return json.dumps(told(step, section(step, config)), sort_keys=True)


def recursion(config: Mapping[str, Any]) -> str:
    """How the recursive module works where the training of the room uses it, as JSON."""
    return json.dumps(section("enhance", config)["injection"], sort_keys=True)


def shot_settings(step: str, config: Mapping[str, Any], keys: tuple[str, ...] = ()) -> Callable[[Any], str]:
    """Function that tells a step of one shot the same, with of ``render.shots`` this shot alone; of that, ``keys``, or
    all that makes the film."""

    def of_shot(wildcards: Any) -> str:
        given = config["render"]["shots"].get(wildcards.shot, {})
        own = {key: value for key, value in given.items() if (key in keys if keys else key != "reference")}
        shots = {wildcards.shot: own} if own else {}
        return json.dumps(told(step, section("render", config) | {"shots": shots}), sort_keys=True)

    return of_shot


def shown_settings(config: Mapping[str, Any]) -> str:
    """What the page shows, as JSON: all settings but those that say how to run, not what comes out."""
    shown = {key: value for key, value in config.items() if key not in ("strict", "sweep", "sweep_minutes", "images")}
    return json.dumps(shown, sort_keys=True)
