# SPDX-License-Identifier: Apache-2.0
"""Measures whether anything moves other than people and shadows."""

from __future__ import annotations

from studiorecon.survey.effects.surveyed import Measurement, SurveyedEffect
from studiorecon.survey.evidence import Evidence
from studiorecon.survey.scene_change import largest_estimate, moving_share


def measure(evidence: Evidence, threshold: float) -> Measurement:
    """The area of the largest object that travels through the room, in the camera that shows most of it."""
    found = [
        moving_share(small.ratio, small.free, small.plate.mean(axis=-1) * 255, small.noise, small.film.runs)
        for small in evidence.small_films
    ]
    value, interval, name = largest_estimate(evidence.names, found)
    if value is None:
        reason = "too little of the room is visible without people to detect objects that move"
    elif value:
        reason = (
            f"a thing of {value:.2%} of the picture moves in {name}; followed as a rigid thing where two cameras see it"
        )
    else:
        reason = "only people and shadows move"
    return Measurement(value, interval, reason)


EFFECT = SurveyedEffect(
    name="dynamic_objects",
    statistic="area of the largest moving object, share of the picture",
    threshold=0.0005,
    hidden_by=("moving_cameras", "changing_light", "moving_shadows"),
    used_by="the plan: objects are tracked (objects.find), shown in films and excluded from people's masks",
    measure=measure,
)
