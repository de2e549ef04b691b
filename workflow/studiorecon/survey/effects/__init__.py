# SPDX-License-Identifier: Apache-2.0
"""Effects that a scene may call for: one file each, ending with its ``EFFECT``, and listed only here.

In: ``survey.evidence``; out: a measurement for each, which ``survey.effect_decisions`` turns into a decision. Settings,
schema, ``survey.force`` and the table of ``config/README.md`` are generated from the list. Start with ``surveyed`` (the
type of an effect) and ``people`` (the simplest). ``docs/contributing.md`` says how to add one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from studiorecon.scene.effects import (
    ENHANCEMENT,
    INJECTION,
    TEMPORAL_APPEARANCE,
    Effect,
    force,
    thresholds,
)
from studiorecon.survey.effects.changing_light import EFFECT as CHANGING_LIGHT
from studiorecon.survey.effects.closed_path import EFFECT as CLOSED_PATH
from studiorecon.survey.effects.defocus import EFFECT as DEFOCUS
from studiorecon.survey.effects.dynamic_objects import EFFECT as DYNAMIC_OBJECTS
from studiorecon.survey.effects.exposure import EFFECT as EXPOSURE
from studiorecon.survey.effects.hands import EFFECT as HANDS
from studiorecon.survey.effects.moving_cameras import EFFECT as MOVING_CAMERAS
from studiorecon.survey.effects.moving_shadows import EFFECT as MOVING_SHADOWS
from studiorecon.survey.effects.people import EFFECT as PEOPLE
from studiorecon.survey.effects.surveyed import SurveyedEffect
from studiorecon.survey.effects.view_dependent_colour import EFFECT as VIEW_DEPENDENT_COLOUR
from studiorecon.survey.effects.view_synthesis import EFFECT as VIEW_SYNTHESIS

# In the order of the decisions: each effect after those that hide it. Three of them show only in a trained scene.
EFFECTS: tuple[Effect, ...] = (
    MOVING_CAMERAS,
    PEOPLE,
    HANDS,
    EXPOSURE,
    CHANGING_LIGHT,
    DEFOCUS,
    CLOSED_PATH,
    VIEW_SYNTHESIS,
    VIEW_DEPENDENT_COLOUR,
    TEMPORAL_APPEARANCE,
    MOVING_SHADOWS,
    DYNAMIC_OBJECTS,
    ENHANCEMENT,
    INJECTION,
)
# Those that show before training.
EARLY = tuple(effect for effect in EFFECTS if isinstance(effect, SurveyedEffect))


@dataclass(frozen=True)
class EffectSettings:
    """The configuration of all effects; a step gets the settings of those that it decides."""

    thresholds: Mapping[str, float] = thresholds(EFFECTS)
    force: Mapping[str, str] = force(EFFECTS)


def effects_table() -> str:
    """The effects as a table in Markdown."""
    rows = ["| effect | statistic | on | when on |", "|---|---|---|---|"]
    for effect in EFFECTS:
        limit = f"{'above' if effect.on_above else 'below'} {effect.threshold:g} {effect.unit}".strip()
        rows.append(f"| `{effect.name}` | {effect.statistic} | {limit} | {effect.used_by or 'only reported'} |")
    return "\n".join(rows)
