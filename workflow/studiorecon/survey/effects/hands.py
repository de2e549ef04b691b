# SPDX-License-Identifier: Apache-2.0
"""Measures whether hands are large enough in the films to see their fingers.

``people.second_look`` decides by the same statistic, because bodies are fitted before the survey.
"""

from __future__ import annotations

from dataclasses import fields

from studiorecon.rig.hand_sizes import hand_sizes_px, usual_size
from studiorecon.scene.effects import HANDS
from studiorecon.survey.effects.surveyed import Measurement, SurveyedEffect
from studiorecon.survey.evidence import Evidence


def measure(evidence: Evidence, threshold: float) -> Measurement:
    """The size of hands in their second best view."""
    about = evidence.material
    usual = usual_size(hand_sizes_px(about.tracks, about.cameras, about.film_px or [1.0] * len(about.cameras)))
    if usual is None:
        return Measurement(None, None, "no two cameras see an arm")
    reason = f"hands are {usual[0]:.0f} pixels long in the second best view"
    costs = (
        "a tenth of the time of detecting people" if usual[1][0] > threshold else "nothing: they are not searched for"
    )
    return Measurement(*usual, f"{reason}; fingers cost {costs}")


EFFECT = SurveyedEffect(**{f.name: getattr(HANDS, f.name) for f in fields(HANDS)}, measure=measure)
