# SPDX-License-Identifier: Apache-2.0
"""The effects that a scene calls for, with reasons: ``survey/decisions.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

from studiorecon.errors import UserError
from studiorecon.scene.files import write_json
from studiorecon.scene.schema import ASCENDING, Anything, ListOf, OptionalField, check, flag, real, record, text
from studiorecon.scene.step_files import expect, read

Verdict = Literal["on", "off", "undetermined"]

# Basis of the thresholds: planted effects. No real capture has been measured yet.
UNCALIBRATED = "uncalibrated"
_DECISION = {
    "effect": text(),
    "statistic": text(),
    "value": OptionalField(real()),
    "interval": OptionalField(real("2", such=ASCENDING, gaps=True)),
    "threshold": OptionalField(real()),
    "verdict": text(*get_args(Verdict)),
    "reason": text(),
    "unit": text(),
    "on_above": flag(),
    "calibration": text(),
    "forced": flag(),
    "used_by": text(),
    "detail": Anything(),
}
_DECISIONS = {"order": ListOf(text()), "decisions": ListOf(_DECISION)}


@dataclass(frozen=True)
class Decision:
    """One effect, and whether this scene calls for it.

    Attributes:
        statistic, unit: the measured quantity, in words; unit of value, interval and threshold, "" for a pure number.
        value, interval: the measurement and its uncertainty (low, high); None when there was nothing to measure.
        threshold: the value at which the verdict changes; None when it is not a matter of degree.
        verdict: ``undetermined`` takes the cheaper branch.
        reason: one sentence.
        on_above: the effect is on above the threshold; False when it is on below.
        calibration: the basis of the threshold.
        forced: the verdict comes from the user and not from the measurement.
        used_by: the step or plan that acts on the verdict; empty when the verdict only informs.
        detail: numbers for the steps that act on the decision.
    """

    effect: str
    statistic: str
    value: float | None
    interval: tuple[float, float] | None
    threshold: float | None
    verdict: Verdict
    reason: str
    unit: str = ""
    on_above: bool = True
    calibration: str = UNCALIBRATED
    forced: bool = False
    used_by: str = ""
    detail: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_on(self) -> bool:
        """Whether the effect is simulated: undetermined takes the cheaper branch, which leaves it out."""
        return self.verdict == "on"


def apply_forced(decisions: Sequence[Decision], verdicts: Mapping[str, str]) -> list[Decision]:
    """The decisions with the user's verdicts (effect → ``on`` or ``off``); raises UserError for an unknown effect."""
    known = {d.effect for d in decisions}
    for effect, verdict in verdicts.items():
        if effect not in known or verdict not in ("on", "off"):
            raise UserError(
                f"survey.force has {effect}: {verdict}; effects decided here are "
                f"{', '.join(sorted(known))}, and each is forced on or off"
            )
    return [
        replace(
            d,
            verdict="on" if verdicts[d.effect] == "on" else "off",
            reason=f"{d.reason} (measured {d.verdict}; forced by survey.force)",
            forced=True,
        )
        if d.effect in verdicts
        else d
        for d in decisions
    ]


def write_decisions(path: Path, decisions: Sequence[Decision]) -> None:
    """Write the decisions in the order in which they were made."""
    write_json(path, {"order": [d.effect for d in decisions], "decisions": [asdict(d) for d in decisions]})


def read_decisions(path: Path) -> dict[str, Decision]:
    """Decisions by effect; raises UserError as ``step_files.read`` does."""
    return read(path, _DECISIONS, _decisions)


def _decisions(value: Mapping[str, Any]) -> dict[str, Decision]:
    made = {entry["effect"]: from_entry(entry) for entry in value["decisions"]}
    expect(list(made) == value["order"], "its decisions are not those of its order")
    return made


def from_entry(entry: Mapping[str, Any]) -> Decision:
    """A decision from its fields by name, as in JSON; raises ValueError with the name of a wrong field."""
    check(entry, _DECISION)
    return record(Decision, entry)
