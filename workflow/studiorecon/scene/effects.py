# SPDX-License-Identifier: Apache-2.0
"""The type of an effect: its statistic, its threshold, the decision from a measurement, and the resulting settings.

It also holds the effects that show only in a trained scene; human training, films and the report measure those.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.scene.decisions import Decision, Verdict

COVERED_DEG = 30.0
"""Neighbouring cameras at most this far apart need no views in between; measured, not assumed (U55)."""


@dataclass(frozen=True, kw_only=True)
class Effect:
    """An effect of a scene: something to simulate, or a fault, and the rule that decides on it.

    Attributes:
        name: as in ``survey.force`` and the files of decisions.
        statistic: the measured quantity, in words.
        unit: of the statistic and its threshold; empty for a pure number.
        threshold: the value from which it is on, unless the settings give another.
        paper: the paper's fixed choice, or the reading (U18) that it follows.
        tunable: whether the settings may change the threshold: False where it is no matter of degree.
        on_above: on above the threshold; False: on below it.
        hidden_by: effects that are decided before, because they look like this one or spoil its measurement.
        void_reason: why effects that this one hides are undetermined while it is on; empty: they are measured anyway.
        used_by: the steps that act when the effect is on, and how; empty: it only informs, and cannot be forced.
    """

    name: str
    statistic: str
    unit: str = ""
    threshold: float
    paper: str = ""
    tunable: bool = True
    on_above: bool = True
    hidden_by: tuple[str, ...] = ()
    void_reason: str = ""
    used_by: str = ""

    @property
    def acts(self) -> bool:
        """Whether a step uses the verdict; otherwise it only informs."""
        return bool(self.used_by)

    def decide(
        self,
        value: float | None,
        interval: tuple[float, float] | None,
        reason: str,
        *,
        threshold: float | None = None,
        detail: Mapping[str, Any] | None = None,
    ) -> Decision:
        """On when the whole interval is beyond the threshold, off when none of it is, else undetermined.

        Without a finite value and interval it is undetermined, and ``reason`` says why. Raises ValueError when the
        value is outside its interval.
        """
        limit = self.threshold if threshold is None else threshold
        verdict: Verdict
        if value is None or interval is None or not np.isfinite([value, *interval]).all():
            value, interval, verdict = None, None, "undetermined"
        else:
            value, interval = float(value), (float(interval[0]), float(interval[1]))
            if not interval[0] <= value <= interval[1]:
                raise ValueError(f"{self.name}: the value {value} is outside its interval {interval}")
            nearest, furthest = interval if self.on_above else (-interval[1], -interval[0])
            line = limit if self.on_above else -limit
            verdict = "on" if nearest > line else "off" if furthest <= line else "undetermined"
            if verdict == "undetermined":
                reason += "; the interval includes the threshold, so the cheaper choice is made"
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
            used_by=self.used_by,
            detail=dict(detail or {}),
        )

    def undecided(self, report: str) -> Decision:
        """The effect as an entry without a verdict, with the name of the report that will decide it."""
        reason = f"measured after training; see {report}"
        return Decision(self.name, self.statistic, None, None, None, "undetermined", reason)


PAPER_CHOICES: Mapping[str, str] = {
    "view_synthesis": "on",
    "temporal_appearance": "on",
    "enhancement": "on",
    "injection": "on",
    "exposure": "off",
    "changing_light": "off",
    "closed_path": "on",
    "dynamic_objects": "off",
    "moving_shadows": "off",
}
"""The paper's fixed choices: "on" for effects that it always uses (481 views on every rig), "off" for others."""


def thresholds(effects: Iterable[Effect]) -> Any:
    """The dataclass field with thresholds that replace the effects' own, for those that can be tuned."""
    known = {
        effect.name: {"description": effect.statistic, "type": "number", "exclusiveMinimum": 0}
        for effect in effects
        if effect.tunable
    }
    return setting(
        {},
        "Thresholds that differ from the effects' own: {exposure: 0.02}.",
        shape={"type": "object", "additionalProperties": False, "properties": known},
    )


def force(effects: Iterable[Effect]) -> Any:
    """The dataclass field with verdicts given in advance, for those of these effects that a step uses."""
    names = [effect.name for effect in effects if effect.acts]
    return setting(
        {},
        'Verdicts set beforehand: {exposure: "on", view_synthesis: "off"}.',
        paper="views, temporal network, enhancement, injection always; no other effect",
        paper_value=PAPER_CHOICES,
        shape={
            "type": "object",
            "propertyNames": {"enum": names, "description": "only effects that a step uses can be forced"},
            "additionalProperties": {"enum": ["on", "off"]},
        },
    )


def certain_decision(effect: Effect, on: bool, reason: str) -> Decision:
    """A verdict that needs no measurement."""
    return replace(effect.decide(None, None, reason), verdict="on" if on else "off")


TEMPORAL_APPEARANCE = Effect(
    name="temporal_appearance",
    statistic="share of body points whose colour residual exceeds 3 times its noise with a constant sign over time",
    threshold=0.1,
    paper="always",
    used_by="humans.train: trains the temporal network; measured after pose refinement",
)
ENHANCEMENT = Effect(
    name="enhancement",
    statistic="gain at validation cameras from transferring detail that renders miss",
    unit="dB",
    threshold=0.1,
    paper="always",
    used_by="enhance.shot: measured before enhancement; a selected network always runs",
)
INJECTION = Effect(
    name="injection",
    statistic="change between enhanced pictures along the renders' flow, relative to the renders' own, minus 1",
    threshold=0.2,
    paper="always",
    used_by="enhance.shot: measured on pairs of the film's pictures before the film",
)
HANDS = Effect(
    name="hands",
    statistic="length of hands in the second best view, reached in a tenth of the moments",
    unit="px",
    threshold=40.0,
    paper="none: bodies have no fingers",
    tunable=False,
    used_by="people.second_look, people.fit: find the fingers of hands that are so large, and fit them",
)
# Measured while the scene is trained, and by every film.
TRAINED, FILMED = (TEMPORAL_APPEARANCE,), (ENHANCEMENT, INJECTION)
