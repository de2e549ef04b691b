# SPDX-License-Identifier: Apache-2.0
"""An effect that shows before training: how it is measured, and the file it writes for who acts on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from studiorecon.scene.camera import Camera
from studiorecon.scene.decisions import Decision
from studiorecon.scene.effects import Effect
from studiorecon.survey.evidence import Evidence, Recordings


@dataclass(frozen=True)
class Measured:
    """What a statistic came to, before anything is decided.

    Attributes:
        value, interval: the measurement; None when there was nothing to measure.
        reason: one sentence, which says why where there is no value.
        detail: numbers for who acts on the decision.
        parts: where parts of the scene are decided one by one: name → value and interval of its own.
    """

    value: float | None
    interval: tuple[float, float] | None
    reason: str
    detail: Mapping[str, Any] = field(default_factory=dict)
    parts: Mapping[str, tuple[float, tuple[float, float]]] = field(default_factory=dict)


@dataclass(frozen=True)
class Artefact:
    """A file that is written with the decision, for who acts on it.

    Attributes:
        file: its name in the results of the survey.
        write: writes it: path, decision, evidence, recordings; something empty unless the effect is called for.
        cost_s: seconds of one core that writing it takes when the effect is on: cameras, frames. None: next to nothing.
    """

    file: str
    write: Callable[[Path, Decision, Evidence, Recordings], None]
    cost_s: Callable[[Sequence[Camera], int], float] | None = None


@dataclass(frozen=True, kw_only=True)
class SurveyedEffect(Effect):
    """An effect with its measurement.

    Attributes:
        measure: the statistic of a scene; told the threshold too, for reasons that count what lies beyond it.
        artefact: what is written for who acts on the effect.
    """

    measure: Callable[[Evidence, float], Measured]
    artefact: Artefact | None = None
