# SPDX-License-Identifier: Apache-2.0
"""Which effects a scene calls for, and why: ``survey/decisions.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

from studiorecon.errors import Refusal
from studiorecon.scene.files import read_json, write_json

Verdict = Literal["on", "off", "undetermined"]


@dataclass(frozen=True)
class Decision:
    """One effect and whether this scene calls for it.

    Attributes:
        effect: its name.
        statistic: what was measured, in words with its unit.
        value: the measurement; None when there was nothing to measure.
        interval: where the measurement lies with its uncertainty (low, high); None when unknown.
        threshold: the value from which the verdict turns; None when it is not a matter of degree.
        verdict: ``undetermined`` takes the cheaper branch.
        reason: one sentence.
    """

    effect: str
    statistic: str
    value: float | None
    interval: tuple[float, float] | None
    threshold: float | None
    verdict: Verdict
    reason: str


def forced(decisions: Sequence[Decision], verdicts: Mapping[str, str]) -> list[Decision]:
    """The decisions with the verdicts that the user wants (effect → ``on`` or ``off``); raises Refusal for an unknown effect."""
    known = {d.effect for d in decisions}
    for effect, verdict in verdicts.items():
        if effect not in known or verdict not in ("on", "off"):
            raise Refusal(f"survey.force has {effect}: {verdict}; effects are {', '.join(sorted(known))}, and each is forced on or off")
    return [
        replace(d, verdict=verdicts[d.effect], reason=f"{d.reason} (measured {d.verdict}; forced by survey.force)")
        if d.effect in verdicts
        else d
        for d in decisions
    ]


def write_decisions(path: Path, decisions: Sequence[Decision]) -> None:
    write_json(path, {"decisions": [asdict(d) for d in decisions]})


def read_decisions(path: Path) -> dict[str, Decision]:
    """Decisions by effect."""
    entries = read_json(path)["decisions"]
    return {e["effect"]: Decision(**{**e, "interval": tuple(e["interval"]) if e["interval"] is not None else None}) for e in entries}
