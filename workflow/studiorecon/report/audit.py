# SPDX-License-Identifier: Apache-2.0
"""Decides the effects that only a trained scene shows: temporal network, enhancement, injection.

Writes ``report/audit.json`` next to ``decisions.json``. Human training and the films have already made their decisions;
this step collects them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from studiorecon.body.avatar.avatar_files import read_decision
from studiorecon.progress import say
from studiorecon.report.metrics.rendered_effects import (
    appearance,
)
from studiorecon.scene.decisions import Decision, forced, read_decisions, write_decisions
from studiorecon.scene.effects import FILMED, TRAINED, force, thresholds
from studiorecon.signature import Written

if TYPE_CHECKING:
    Named = str
    Acting = str
else:
    Named = Literal[tuple(effect.name for effect in TRAINED)]
    Acting = Literal[tuple(effect.name for effect in TRAINED if effect.acts)]


@dataclass(frozen=True)
class Settings:
    """Settings of the effects that only a trained scene shows; ``survey.effects.Decided`` declares them for all."""

    thresholds: Mapping[Named, float] = thresholds(TRAINED)
    force: Mapping[Acting, str] = force(TRAINED)


def decisions_of(avatars: Sequence[Path]) -> dict[str, Decision | None]:
    """The decision that human training made for every person."""
    return {path.stem: read_decision(path) for path in avatars}


def of_films(files: Sequence[Path]) -> list[Decision]:
    """The films' decisions, one per effect of ``FILMED``: from the film with the strongest case for it."""
    found = [read_decisions(path) for path in files]
    made = []
    for effect in FILMED:
        measured = [decisions[effect.name] for decisions in found if effect.name in decisions]
        if measured:
            made.append(max(measured, key=lambda one: (one.called_for, one.value is not None, one.value or 0.0)))
        else:
            made.append(effect.decide(None, None, "no film was made here that it could be measured on"))
    return made


def run(
    settings: Settings,
    avatars: list[Path],
    films: list[Path],
    decisions: Written,
) -> None:
    """Write the decisions of human training and of all ``films``."""
    limit = {e.name: e.threshold for e in TRAINED} | dict(settings.thresholds)
    measured = appearance(decisions_of(avatars), limit["temporal_appearance"])
    made = [*forced([measured], settings.force), *of_films(films)]
    for decision in made:
        say(f"{decision.effect}: {decision.verdict}; {decision.reason}")
    write_decisions(decisions, made)
