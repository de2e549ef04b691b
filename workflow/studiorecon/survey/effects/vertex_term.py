# SPDX-License-Identifier: Apache-2.0
"""Are surface points of bodies as sure as their joints, so that the fit should count them? Only networks bring any."""

from __future__ import annotations

from studiorecon.survey.effects.surveyed import Measured, SurveyedEffect
from studiorecon.survey.evidence import Evidence


def measure(evidence: Evidence, threshold: float) -> Measured:
    """Nothing: keypoints have no surface points."""
    reason = (
        "not measured here: only a network's bodies bring surface points; what they count for is "
        "people.fit.vertex_weight"
    )
    return Measured(None, None, reason)


EFFECT = SurveyedEffect(
    name="vertex_term",
    statistic="median triangulation residual of surface points over that of joints",
    threshold=2.0,
    on_above=False,
    measure=measure,
)
