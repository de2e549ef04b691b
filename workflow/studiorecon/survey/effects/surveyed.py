# SPDX-License-Identifier: Apache-2.0
"""An effect that shows before training: its measurement, and the file that it writes for the steps that use it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from studiorecon.scene.decisions import Decision
from studiorecon.scene.effects import Effect
from studiorecon.survey.evidence import Evidence, Recordings


@dataclass(frozen=True)
class Measurement:
    """The value of a statistic before the decision.

    Attributes:
        value, interval: the measurement; None when there was nothing to measure.
        reason: one sentence; without a value it says why.
        detail: numbers for the steps that use the decision.
        parts: name → value and interval, for parts of the scene that are decided one by one.
    """

    value: float | None
    interval: tuple[float, float] | None
    reason: str
    detail: Mapping[str, Any] = field(default_factory=dict)
    parts: Mapping[str, tuple[float, tuple[float, float]]] = field(default_factory=dict)


@dataclass(frozen=True)
class Artefact:
    """A file ``file`` that is written with the decision, for the steps that use it.

    ``write`` makes it from path, decision, evidence, recordings; it stays empty unless the effect is on.
    """

    file: str
    write: Callable[[Path, Decision, Evidence, Recordings], None]


@dataclass(frozen=True, kw_only=True)
class SurveyedEffect(Effect):
    """An effect with its measurement, and the artefact for the steps that use it.

    ``measure`` also gets the threshold, for reasons that count the values beyond it.
    """

    measure: Callable[[Evidence, float], Measurement]
    artefact: Artefact | None = None
