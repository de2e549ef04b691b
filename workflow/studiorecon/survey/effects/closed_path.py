# SPDX-License-Identifier: Apache-2.0
"""Do the cameras surround the stage? A ring has its gap between every two neighbours, an arc a wide one beyond its
ends."""

from __future__ import annotations

from studiorecon.survey.coverage import largest_gap_deg, mean_pair_deg
from studiorecon.survey.effects.surveyed import Measured, SurveyedEffect
from studiorecon.survey.evidence import Evidence


def measure(evidence: Evidence, threshold: float) -> Measured:
    """The widest gap between neighbours, seen from what they look at."""
    cameras = evidence.material.cameras
    gap = largest_gap_deg(cameras)
    around = "surround the stage" if gap <= threshold else "leave one side open"
    reason = (
        f"the cameras {around}: the widest gap is {gap:.0f} degrees, and any two are "
        f"{mean_pair_deg(cameras):.0f} degrees apart on average"
    )
    return Measured(gap, (gap, gap), reason)


EFFECT = SurveyedEffect(
    name="closed_path",
    statistic="largest azimuth between neighbouring cameras",
    unit="degrees",
    threshold=150.0,
    paper="U18",
    on_above=False,
    measure=measure,
)
