# SPDX-License-Identifier: Apache-2.0
"""All decisions that are possible before training, in the order in which one effect hides another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from studiorecon.scene.decisions import Decision
from studiorecon.scene.effects import force, thresholds
from studiorecon.survey.effects import EARLY
from studiorecon.survey.effects.surveyed import SurveyedEffect
from studiorecon.survey.evidence import Evidence, Sampling

if TYPE_CHECKING:
    Named = str
    Tunable = str
else:
    Named = Literal[tuple(effect.name for effect in EARLY if effect.acts)]
    Tunable = Literal[tuple(effect.name for effect in EARLY if effect.tunable)]


@dataclass(frozen=True)
class Settings(Sampling):
    """Settings of the effects that show before training (``effects.EffectSettings``), and the sampling."""

    thresholds: Mapping[Tunable, float] = thresholds(EARLY)
    force: Mapping[Named, str] = force(EARLY)


def decide_effects(
    evidence: Evidence,
    thresholds: Mapping[str, float],
    force: Mapping[str, str] | None = None,
) -> list[Decision]:
    """One decision for every effect that shows before training, by its threshold in ``thresholds`` or its own.

    An effect that is on voids others, but not if ``force`` turned it off.
    """
    verdicts = force or {}
    made: dict[str, Decision] = {}
    for effect in EARLY:
        made[effect.name] = decide_effect(effect, evidence, thresholds.get(effect.name, effect.threshold))
    by_name = {effect.name: effect for effect in EARLY}
    for effect in EARLY:
        for hiding in effect.hidden_by:
            on = made[hiding].is_on if hiding not in verdicts else verdicts[hiding] == "on"
            if by_name[hiding].void_reason and on:
                made[effect.name] = replace(
                    made[effect.name],
                    value=None,
                    interval=None,
                    verdict="undetermined",
                    reason=by_name[hiding].void_reason,
                )
    return list(made.values())


def decide_effect(effect: SurveyedEffect, evidence: Evidence, threshold: float) -> Decision:
    """The decision on one effect; its detail holds the decisions on parts of the scene, if it has any."""
    found = effect.measure(evidence, threshold)
    parts = {}
    for name, own in found.parts.items():
        part = effect.decide(*own, "", threshold=threshold)
        parts[name] = {"value": part.value, "verdict": part.verdict}
    detail = {**found.detail, **({"parts": parts} if parts else {})}
    return effect.decide(found.value, found.interval, found.reason, threshold=threshold, detail=detail)
