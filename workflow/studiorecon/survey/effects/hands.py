# SPDX-License-Identifier: Apache-2.0
"""Are hands large and certain enough in the pictures to be worth a model of their own?"""

from __future__ import annotations

from studiorecon.survey.effects.surveyed import Measured, SurveyedEffect
from studiorecon.survey.evidence import LIMITS, Evidence
from studiorecon.survey.resolution import HAND_M, part_height


def measure(evidence: Evidence, threshold: float) -> Measured:
    """Height of a hand in its best view, or how rarely two views are sure of it, on the same scale."""
    material = evidence.material
    seen = part_height(
        material.tracks, ("left_wrist", "right_wrist"), material.cameras, HAND_M, "a hand", LIMITS, threshold
    )
    return Measured(*seen)


EFFECT = SurveyedEffect(
    name="hands",
    statistic="height of a hand in the best view",
    unit="px",
    threshold=24.0,
    measure=measure,
)
