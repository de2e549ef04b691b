# SPDX-License-Identifier: Apache-2.0
"""Measures whether a camera moves: every later measurement assumes static cameras."""

from __future__ import annotations

import numpy as np

from studiorecon.geometry.statistics import largest_estimate
from studiorecon.survey.effects.surveyed import Measurement, SurveyedEffect
from studiorecon.survey.evidence import Evidence
from studiorecon.survey.stillness import block_shifts, worst_shift


def measure(evidence: Evidence, threshold: float) -> Measurement:
    """The shift of the room between the first picture of each run and the last of all, camera by camera."""
    films = evidence.material.films
    values, errors = [], []
    for film in films:
        # The first picture of every run is enough: a camera that was moved stays moved, and shaking shows in some runs.
        later = [*(run.start for run in film.runs[1:]), len(film.times) - 1]
        free = [film.free[0] & film.free[t] for t in later]
        shifts = [block_shifts(film.pictures[0], film.pictures[t], f) for t, f in zip(later, free)]
        value, error = worst_shift(np.stack(shifts))
        values.append(value * film.scale)
        errors.append(error * film.scale)
    estimate = largest_estimate(values, errors)
    reason = "the room has too little texture to see whether cameras move"
    if estimate.value is not None:
        reason = (
            f"{films[estimate.which].camera.name}'s background shifts by up to {estimate.value:.2f} px from its "
            "first picture; all later steps assume static cameras"
        )
    return Measurement(estimate.value, estimate.interval, reason)


EFFECT = SurveyedEffect(
    name="moving_cameras",
    statistic="largest median shift of a camera's background from the first picture",
    unit="px",
    threshold=0.3,
    void_reason="the cameras move, which voids this measurement: steady the footage, or leave the moving camera out "
    "with train: [...]",
    used_by="survey.decide: effects that need static cameras become undetermined",
    measure=measure,
)
