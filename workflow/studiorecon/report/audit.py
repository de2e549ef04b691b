# SPDX-License-Identifier: Apache-2.0
"""What only a trained scene shows: is the temporal network, enhancement or injection called for?

Writes ``report/audit.json`` beside ``decisions.json``. Human training and the films decided before the work that they
are about.
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
    """Of the effects that only a trained scene shows; ``survey.effects.Decided`` declares them for all."""

    thresholds: Mapping[Named, float] = thresholds(TRAINED)
    force: Mapping[Acting, str] = force(TRAINED)


def decisions_of(avatars: Sequence[Path]) -> dict[str, Decision | None]:
    """What human training measured of every person."""
    return {path.stem: read_decision(path) for path in avatars}


def of_films(files: Sequence[Path]) -> list[Decision]:
    """What the films measured, one decision per effect of ``FILMED``: of the film that calls for it most."""
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
    """Decide from what was trained; ``films`` are the decisions of every film."""
    limit = {e.name: e.threshold for e in TRAINED} | dict(settings.thresholds)
    measured = appearance(decisions_of(avatars), limit["temporal_appearance"])
    made = [*forced([measured], settings.force), *of_films(films)]
    for decision in made:
        say(f"{decision.effect}: {decision.verdict}; {decision.reason}")
    write_decisions(decisions, made)
