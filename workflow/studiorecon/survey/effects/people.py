# SPDX-License-Identifier: Apache-2.0
"""Decides whether there are people in the scene."""

from __future__ import annotations

from studiorecon.survey.effects.surveyed import Measurement, SurveyedEffect
from studiorecon.survey.evidence import Evidence


def measure(evidence: Evidence, threshold: float) -> Measurement:
    """The number of people that association found; none where the dataset says that the room is empty."""
    found = evidence.material.people
    count = len(found or ())
    if found is None:
        reason = "the dataset states that there are no people; the film shows the empty room"
    elif not found:
        reason = "no person was seen by enough cameras; the film shows the empty room"
    else:
        reason = f"{', '.join(found)} will be reconstructed, one at a time"
    return Measurement(float(count), (float(count),) * 2, reason)


EFFECT = SurveyedEffect(
    name="people",
    statistic="people tracked by several cameras",
    threshold=0.5,
    tunable=False,
    used_by="the plan: without people no masks, bodies and human training",
    measure=measure,
)
