# SPDX-License-Identifier: Apache-2.0
"""Decides the effects that only a trained scene shows: temporal network, enhancement, injection.

Writes ``report/audit.json`` next to ``decisions.json``. Human training and the films have already made their decisions;
this step collects them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from studiorecon.body.avatar.avatar_files import read_decision
from studiorecon.progress import say
from studiorecon.scene.decisions import Decision, apply_forced, read_decisions, write_decisions
from studiorecon.scene.effects import FILMED, TEMPORAL_APPEARANCE, TRAINED, force, thresholds
from studiorecon.signature import Written

if TYPE_CHECKING:
    Named = str
    Acting = str
else:
    Named = Literal[tuple(effect.name for effect in TRAINED)]
    Acting = Literal[tuple(effect.name for effect in TRAINED if effect.acts)]


@dataclass(frozen=True)
class Settings:
    """Settings of the effects that only a trained scene shows; ``survey.effects.EffectSettings`` has all."""

    thresholds: Mapping[Named, float] = thresholds(TRAINED)
    force: Mapping[Acting, str] = force(TRAINED)


def appearance_decisions(avatars: Sequence[Path]) -> dict[str, Decision | None]:
    """The decision that human training made for every person."""
    return {path.stem: read_decision(path) for path in avatars}


def decide_appearance_network(found: Mapping[str, Decision | None], threshold: float) -> Decision:
    """One decision from the people's own: that of the strongest case; without any it reports ``threshold``."""
    measured = {name: (d.value, d) for name, d in found.items() if d is not None and d.value is not None}
    if not measured:
        why = (
            "no person was trained"
            if not found
            else f"human training did not measure it, or saw too little of {', '.join(found)}"
        )
        return TEMPORAL_APPEARANCE.decide(None, None, f"not measured here: {why}", threshold=threshold)
    _, most = max(measured.values(), key=lambda pair: (pair[1].is_on, pair[0]))
    detail = {name: {"value": value, "verdict": d.verdict} for name, (value, d) in measured.items()}
    return replace(most, used_by=TEMPORAL_APPEARANCE.used_by, detail=detail)


def film_decisions(files: Sequence[Path]) -> list[Decision]:
    """The films' decisions, one per effect of ``FILMED``: from the film with the strongest case for it."""
    found = [read_decisions(path) for path in files]
    made = []
    for effect in FILMED:
        measured = [decisions[effect.name] for decisions in found if effect.name in decisions]
        if measured:
            made.append(max(measured, key=lambda one: (one.is_on, one.value is not None, one.value or 0.0)))
        else:
            made.append(effect.decide(None, None, "no film was made to measure it on"))
    return made


def run(
    settings: Settings,
    avatars: list[Path],
    films: list[Path],
    decisions: Written,
) -> None:
    """Write the decisions of human training and of all ``films``."""
    limit = {e.name: e.threshold for e in TRAINED} | dict(settings.thresholds)
    measured = decide_appearance_network(appearance_decisions(avatars), limit["temporal_appearance"])
    made = [*apply_forced([measured], settings.force), *film_decisions(films)]
    for decision in made:
        say(f"{decision.effect}: {decision.verdict}; {decision.reason}")
    write_decisions(decisions, made)
