# SPDX-License-Identifier: Apache-2.0
"""What an effect is: its statistic, its threshold and how a measurement becomes a decision; the settings that follow
from it; and the effects that only a trained scene shows, which human training, films and the report measure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.scene.decisions import Decision, Verdict

COVERED_DEG = 30.0
"""Neighbouring cameras that are at most this far apart need no views in between; measured, not assumed (U55)."""


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One thing that a scene may call for, or suffer from, and how that is told.

    Attributes:
        name: as in ``survey.force`` and the files of decisions.
        statistic: what is measured, in words.
        unit: of the statistic and its threshold; empty for a pure number.
        threshold: the value from which it is on, unless the settings say otherwise.
        paper: what the paper does instead of asking, or the reading (U18) that it follows.
        tunable: whether the settings may: False where it is no matter of degree.
        on_above: on above the threshold; False: on below it.
        hidden_by: effects that are decided before, because they would pass for it or spoil its measurement.
        voids: what is said of an effect that this one hides while it is on; empty: that one is measured all the same.
        obeyed_by: which step or plan acts on the verdict, and how; empty: it is a finding, which nobody can force.
    """

    name: str
    statistic: str
    unit: str = ""
    threshold: float
    paper: str = ""
    tunable: bool = True
    on_above: bool = True
    hidden_by: tuple[str, ...] = ()
    voids: str = ""
    obeyed_by: str = ""

    @property
    def acts(self) -> bool:
        """Whether anything is done or left out by this verdict; else it is a finding."""
        return bool(self.obeyed_by)

    def decide(
        self,
        value: float | None,
        interval: tuple[float, float] | None,
        reason: str,
        *,
        threshold: float | None = None,
        detail: Mapping[str, Any] | None = None,
    ) -> Decision:
        """On when the whole interval lies beyond the threshold, off when none of it does, else undetermined.

        Without a finite value and interval there is nothing to tell, and ``reason`` must say why. Raises ValueError
        when the value lies outside of its interval.
        """
        limit = self.threshold if threshold is None else threshold
        verdict: Verdict
        if value is None or interval is None or not np.isfinite([value, *interval]).all():
            value, interval, verdict = None, None, "undetermined"
        else:
            value, interval = float(value), (float(interval[0]), float(interval[1]))
            if not interval[0] <= value <= interval[1]:
                raise ValueError(f"{self.name}: the value {value} lies outside of its interval {interval}")
            nearest, furthest = interval if self.on_above else (-interval[1], -interval[0])
            line = limit if self.on_above else -limit
            verdict = "on" if nearest > line else "off" if furthest <= line else "undetermined"
            if verdict == "undetermined":
                reason += "; the threshold lies within what the measurement leaves open, so the cheaper branch is taken"
        return Decision(
            self.name,
            self.statistic,
            value,
            interval,
            limit,
            verdict,
            reason,
            unit=self.unit,
            on_above=self.on_above,
            obeyed_by=self.obeyed_by,
            detail=dict(detail or {}),
        )

    def left_to(self, report: str) -> Decision:
        """The effect is listed, and where it will be decided."""
        reason = f"not measured here: only a trained scene shows it; {report} decides"
        return Decision(self.name, self.statistic, None, None, None, "undetermined", reason)


PAPERS: Mapping[str, str] = {
    "view_synthesis": "on",
    "temporal_appearance": "on",
    "enhancement": "on",
    "injection": "on",
    "exposure": "off",
    "changing_light": "off",
    "dynamic_objects": "off",
    "moving_shadows": "off",
}
"""What the paper always does, and what it has not."""


def thresholds(effects: Iterable[Effect]) -> Any:
    """The setting of a dataclass that holds other thresholds than the effects' own, of those that have one to set."""
    known = {
        effect.name: {"description": effect.statistic, "type": "number", "exclusiveMinimum": 0}
        for effect in effects
        if effect.tunable
    }
    return setting(
        {},
        "From where an effect is called for, where that is not the effect's own threshold: {exposure: 0.02}.",
        shape={"type": "object", "additionalProperties": False, "properties": known},
    )


def force(effects: Iterable[Effect]) -> Any:
    """The setting of a dataclass that decides beforehand on those of these effects that something acts on."""
    names = [effect.name for effect in effects if effect.acts]
    return setting(
        {},
        'Decisions made beforehand, e.g. {exposure: "on", view_synthesis: "off"}.',
        paper="views, temporal network, enhancement and injection always; nothing else that a scene may call for",
        letter=PAPERS,
        shape={
            "type": "object",
            "propertyNames": {
                "enum": names,
                "description": "only verdicts that something acts on can be forced, the others are findings",
            },
            "additionalProperties": {"enum": ["on", "off"]},
        },
    )


def settled(effect: Effect, on: bool, reason: str) -> Decision:
    """A verdict that nothing had to be measured for."""
    return replace(effect.decide(None, None, reason), verdict="on" if on else "off")


TEMPORAL_APPEARANCE = Effect(
    name="temporal_appearance",
    statistic="share of body points whose colour residual exceeds 3 times its noise and keeps its sign over time",
    threshold=0.1,
    paper="always",
    obeyed_by="humans.train, which measures it once poses are refined, and then trains the network or leaves it out",
)
ENHANCEMENT = Effect(
    name="enhancement",
    statistic="gain at training cameras that took no part, of carrying over what photos show and renders miss",
    unit="dB",
    threshold=0.1,
    paper="always",
    obeyed_by="enhance.shot, which measures it before it enhances; a network that a setting names is always used",
)
INJECTION = Effect(
    name="injection",
    statistic="change between enhanced pictures along the flow of the renders, over that of the renders, less 1",
    threshold=0.2,
    paper="always",
    obeyed_by="enhance.shot, which measures it on pairs of pictures of the film before it makes the film",
)
# Measured when the scene is trained, and by every film of its own.
TRAINED, FILMED = (TEMPORAL_APPEARANCE,), (ENHANCEMENT, INJECTION)
