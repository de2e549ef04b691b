# SPDX-License-Identifier: Apache-2.0
"""Which effects a scene calls for, and why: ``survey/decisions.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.scene.files import read_json, write_json

# What is decided before training, in the order in which one effect hides another, and what only a trained scene shows.
Early = Literal[
    "moving_cameras", "people", "exposure", "changing_light", "lens_distortion", "sync_offset", "rolling_shutter", "depth_shift",
    "closed_path", "view_synthesis", "view_dependent_colour", "hands", "face", "vertex_term", "moving_shadows", "dynamic_objects",
]  # fmt: skip
Late = Literal["refinement", "temporal_appearance", "enhancement", "injection"]
Verdict = Literal["on", "off", "undetermined"]

# An effect that was on stays on until its statistic is this far inside the threshold.
HYSTERESIS = 0.2
# What supports the thresholds of evaluation §3: planted effects. No real capture has been measured yet.
UNCALIBRATED = "uncalibrated"

# The order in which effects are decided: a moving camera voids the rest, exposure goes before gloss, distortion before lag, lag before
# rolling shutter; the last ones can only be measured on a trained scene.
ORDER = (
    "moving_cameras", "people", "exposure", "changing_light", "lens_distortion", "sync_offset", "rolling_shutter", "depth_shift",
    "closed_path", "view_synthesis", "view_dependent_colour", "hands", "face", "vertex_term", "refinement", "temporal_appearance",
    "moving_shadows", "dynamic_objects", "enhancement", "injection",
)  # fmt: skip


@dataclass(frozen=True)
class Decision:
    """One effect and whether this scene calls for it.

    Attributes:
        effect: its name.
        statistic: what was measured, in words with its unit.
        value: the measurement; None when there was nothing to measure.
        interval: where the measurement lies with its uncertainty (low, high); None when unknown.
        threshold: the value from which the verdict turns, in the statistic's unit; None when it is not a matter of degree.
        verdict: ``undetermined`` takes the cheaper branch.
        reason: one sentence.
        unit: of value, interval and threshold; empty for a pure number.
        on_above: the effect is on above the threshold; False when it is on below.
        hysteresis: share of the threshold by which an effect that was on must fall before it is off.
        cost_saved_estimate_s: seconds that leaving the effect out saves; None when nothing is left out or nobody measured it.
        calibration: what the threshold rests on.
        forced: the user's word, not the measurement's.
        obeyed_by: which step or plan acts on the verdict; empty while none does, and the verdict only informs.
        detail: numbers for who acts on the decision.
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
    hysteresis: float = HYSTERESIS
    cost_saved_estimate_s: float | None = None
    calibration: str = UNCALIBRATED
    forced: bool = False
    obeyed_by: str = ""
    detail: Mapping[str, Any] = field(default_factory=dict)

    @property
    def called_for(self) -> bool:
        """Whether the effect is simulated: undetermined takes the cheaper branch, which leaves it out."""
        return self.verdict == "on"


def decide(
    effect: str,
    statistic: str,
    value: float | None,
    interval: tuple[float, float] | None,
    threshold: float,
    reason: str,
    *,
    unit: str = "",
    on_above: bool = True,
    was_on: bool = False,
    obeyed_by: str = "",
    detail: Mapping[str, Any] | None = None,
) -> Decision:
    """On when the whole interval lies beyond ``threshold``, off when none of it does, else undetermined.

    Without a finite value and interval there is nothing to tell, and ``reason`` must say why. An effect that ``was_on`` in an earlier
    survey is measured against a threshold that lies ``HYSTERESIS`` inside, so that noise does not switch it back and forth; for it, an
    interval that straddles the line leaves it on.

    Raises:
        ValueError: the effect is not in ``ORDER``, or the value lies outside of its interval.
    """
    if effect not in ORDER:
        raise ValueError(f"effect {effect} has no place in the order of decisions")
    unknown = value is None or interval is None or not np.isfinite([value, *interval]).all()
    if unknown:
        value, interval, verdict = None, None, "undetermined"
    else:
        value, interval = float(value), (float(interval[0]), float(interval[1]))
        if not interval[0] <= value <= interval[1]:
            raise ValueError(f"{effect}: the value {value} lies outside of its interval {interval}")
        line = threshold * (1 - HYSTERESIS if on_above else 1 + HYSTERESIS) if was_on else threshold
        nearest, furthest = interval if on_above else (-interval[1], -interval[0])
        line = line if on_above else -line
        verdict = "on" if nearest > line else "off" if furthest <= line else "on" if was_on else "undetermined"
        if verdict == "undetermined":
            reason = f"{reason}; the threshold lies within what the measurement leaves open, so the cheaper branch is taken"
    return Decision(
        effect, statistic, value, interval, threshold, verdict, reason, unit=unit, on_above=on_above, obeyed_by=obeyed_by,
        detail=dict(detail or {}),
    )  # fmt: skip


def not_measured(
    effect: str, statistic: str, threshold: float | None, why: str, unit: str = "", on_above: bool = True, obeyed_by: str = ""
) -> Decision:
    """The effect is listed, and why nothing here can tell."""
    reason = f"not measured here: {why}"
    return Decision(effect, statistic, None, None, threshold, "undetermined", reason, unit=unit, on_above=on_above, obeyed_by=obeyed_by)


def forced(decisions: Sequence[Decision], verdicts: Mapping[str, str]) -> list[Decision]:
    """The decisions with the verdicts that the user wants (effect → ``on`` or ``off``); raises Refusal for an unknown effect.

    Each step of the survey is told all of them and forces those it decides.
    """
    for effect, verdict in verdicts.items():
        if effect not in ORDER or verdict not in ("on", "off"):
            raise Refusal(f"survey.force has {effect}: {verdict}; effects are {', '.join(sorted(ORDER))}, and each is forced on or off")
    return [
        replace(d, verdict=verdicts[d.effect], reason=f"{d.reason} (measured {d.verdict}; forced by survey.force)", forced=True)
        if d.effect in verdicts
        else d
        for d in decisions
    ]


def in_order(decisions: Sequence[Decision]) -> list[Decision]:
    """Sorted by ``ORDER``."""
    return sorted(decisions, key=lambda d: ORDER.index(d.effect))


def write_decisions(path: Path, decisions: Sequence[Decision]) -> None:
    """Write the decisions, and the order in which they were made."""
    write_json(path, {"order": [d.effect for d in decisions], "decisions": [asdict(d) for d in decisions]})


def switched_on(path: Path) -> frozenset[str]:
    """Effects that an earlier survey measured to be on, for the hysteresis; none when there was no earlier one.

    A forced verdict does not count: lifting the force must give what was measured.
    """
    if not path.is_file():
        return frozenset()
    return frozenset(effect for effect, d in read_decisions(path).items() if d.called_for and not d.forced)


def read_decisions(path: Path) -> dict[str, Decision]:
    """Decisions by effect."""
    return {entry["effect"]: from_entry(entry) for entry in read_json(path)["decisions"]}


def from_entry(entry: Mapping[str, Any]) -> Decision:
    """A decision from its fields by name, as JSON holds them."""
    return Decision(**{**entry, "interval": tuple(entry["interval"]) if entry["interval"] is not None else None})
