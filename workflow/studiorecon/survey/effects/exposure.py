# SPDX-License-Identifier: Apache-2.0
"""Measures whether the cameras agree on the colour of shared surfaces: 2 % caps PSNR at 40 dB, 10 % at 26 dB."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.progress import say
from studiorecon.scene.decisions import Decision
from studiorecon.scene.factors import write_factors
from studiorecon.survey.effects.surveyed import Artefact, Measurement, SurveyedEffect
from studiorecon.survey.evidence import Evidence, Recordings
from studiorecon.survey.exposures import CERTAIN, INTERVAL

if TYPE_CHECKING:
    from jaxtyping import Float


def measure(evidence: Evidence, threshold: float) -> Measurement:
    """The gains of all cameras; ``detail`` names those that share too little with the others to be compared."""
    views, (found, _) = evidence.material.views, evidence.overlaps
    if not found:
        return Measurement(None, None, "no two cameras share enough surface to compare their colours")
    value, error, gains = evidence.gains
    worst = int(np.abs(gains - 1).max(axis=1).argmax())
    factors = " ".join(f"{g:.3f}" for g in gains[worst])
    reason = f"{views[worst].camera.name} differs most (red, green, blue × {factors})"
    low = value - INTERVAL * error if value > CERTAIN * error else min(value - INTERVAL * error, 0.0)
    joined = {index for overlap in found for index in (overlap.first, overlap.second)}
    alone = [v.camera.name for k, v in enumerate(views) if k not in joined]
    if alone:
        reason += f"; {', '.join(alone)} shares too little with the others to be compared and keeps its own exposure"
    detail = {
        "gains": {v.camera.name: [round(float(g), 4) for g in own] for v, own in zip(views, gains)},
        "alone": alone,
    }
    return Measurement(value, (low, value + INTERVAL * error), reason, detail)


def write(path: Path, decision: Decision, evidence: Evidence, recordings: Recordings) -> None:
    """Write the factors that pictures are divided by."""
    write_factors(path, active_gains(decision))


def active_gains(exposure: Decision) -> Mapping[str, Float[np.ndarray, "1 3"]]:
    """Camera → gains to divide pictures by; none unless the verdict is on, nor for cameras that cannot be compared."""
    if not exposure.is_on:
        return {}
    found = {
        name: own for name, own in exposure.detail.get("gains", {}).items() if name not in exposure.detail["alone"]
    }
    if not found:
        say(
            "exposure is forced on, but no two cameras share enough surface to compare their colours: every camera "
            "keeps its exposure"
        )
    return {name: np.array([own]) for name, own in found.items()}


EFFECT = SurveyedEffect(
    name="exposure",
    statistic="largest relative difference of a camera's gain from the mean",
    threshold=0.01,
    hidden_by=("moving_cameras",),
    used_by="views, background.train, humans.train, enhance.shot: photos are divided by their camera's gain",
    measure=measure,
    artefact=Artefact("gains.json", write),
)
