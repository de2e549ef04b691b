# SPDX-License-Identifier: Apache-2.0
"""Does the light change while filming?"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon.geometry.statistics import Estimate, largest
from studiorecon.progress import say
from studiorecon.scene.decisions import Decision
from studiorecon.scene.factors import write_factors
from studiorecon.survey.brightness import cost_s, course_of
from studiorecon.survey.effects.surveyed import Artefact, Measured, SurveyedEffect
from studiorecon.survey.evidence import Evidence, Recordings


def measure(evidence: Evidence, threshold: float) -> Measured:
    """The largest change in any camera; light changes in all of them at once, which the reason says."""
    names, worst = evidence.names, [largest(value[1:], error[1:]) for value, error in evidence.light]
    estimate = largest([w.value if w.value is not None else np.nan for w in worst], [_error(w) for w in worst])
    reason = "too little of the room is seen without people to compare its brightness over time"
    if estimate.value is not None:
        every = sum(1 for w in worst if w.interval is not None and w.interval[0] > threshold)
        whose = (
            "all cameras see it: the light" if every == len(names) > 1 else f"{every} of {len(names)} cameras see it"
        )
        reason = f"brightness changes by up to {estimate.value:.1%} in {names[estimate.which]}" + (
            f"; {whose}" if every else ""
        )
    return Measured(estimate.value, estimate.interval, reason)


def _error(estimate: Estimate) -> float:
    if estimate.value is None or estimate.interval is None:
        return np.nan
    return (estimate.interval[1] - estimate.value) / 3


def write(path: Path, decision: Decision, evidence: Evidence, recordings: Recordings) -> None:
    """Every frame's brightness against its plate, for the cameras that can tell."""
    changes: dict[str, np.ndarray] = {}
    if decision.called_for:
        longest_px = evidence.sampling.longest_px
        for video, view, own in zip(recordings.videos, evidence.material.views, recordings.found):
            course = course_of(video, view.camera, recordings.frames, own, view, longest_px)
            if course is None:
                say(
                    f"{view.camera.name}: too little of the room is seen without people to follow "
                    "its light; its frames stay as they are"
                )
            else:
                changes[view.camera.name] = course
    write_factors(path, changes)


EFFECT = SurveyedEffect(
    name="changing_light",
    statistic="largest change of the room's brightness against the first picture, log",
    threshold=0.02,
    hidden_by=("moving_cameras",),
    obeyed_by="masks.segment, humans.train and enhance.shot: when on they divide every frame by its brightness against "
    "the plate; films are in the plates' constant light",
    measure=measure,
    artefact=Artefact("brightness.json", write, cost_s),
)
