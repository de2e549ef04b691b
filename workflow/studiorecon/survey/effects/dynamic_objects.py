# SPDX-License-Identifier: Apache-2.0
"""Measures whether anything moves other than people and shadows."""

from __future__ import annotations

from studiorecon.survey.effects.surveyed import Measurement, SurveyedEffect
from studiorecon.survey.evidence import Evidence
from studiorecon.survey.scene_change import largest_moving, moving_regions


def measure(evidence: Evidence, threshold: float) -> Measurement:
    """The area of the largest object that travels through the room, in the camera that shows most of it."""
    found = [
        moving_regions(small.ratio, small.free, small.plate.mean(axis=-1) * 255, small.noise, small.film.runs)
        for small in evidence.small_films
    ]
    largest = largest_moving(found)
    if largest.value is None:
        reason = "too little of the room is visible to two cameras without people to detect objects that move"
    elif largest.value:
        reason = (
            f"a thing of {largest.value:.2%} of the picture moves in {evidence.names[largest.which]}, and in others"
        )
    else:
        reason = "only people and shadows move for two cameras at once"
    return Measurement(largest.value, largest.interval, reason)


EFFECT = SurveyedEffect(
    name="dynamic_objects",
    statistic="area of the largest moving object, share of the picture",
    threshold=0.0005,
    hidden_by=("moving_cameras", "changing_light", "moving_shadows"),
    used_by="the plan: objects are tracked (objects.find), shown in films and excluded from people's masks",
    measure=measure,
)
