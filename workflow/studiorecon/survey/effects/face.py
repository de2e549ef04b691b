# SPDX-License-Identifier: Apache-2.0
"""Is a face large and certain enough in the pictures to be worth a model of its own?"""

from __future__ import annotations

from studiorecon.survey.effects.surveyed import Measured, SurveyedEffect
from studiorecon.survey.evidence import LIMITS, Evidence
from studiorecon.survey.resolution import HEAD_M, part_height


def measure(evidence: Evidence, threshold: float) -> Measured:
    """Height of a face in its best view, or how rarely two views are sure of it, on the same scale."""
    material = evidence.material
    seen = part_height(material.tracks, ("nose",), material.cameras, HEAD_M, "a face", LIMITS, threshold)
    return Measured(*seen)


EFFECT = SurveyedEffect(
    name="face",
    statistic="height of a face in the best view",
    unit="px",
    threshold=40.0,
    measure=measure,
)
