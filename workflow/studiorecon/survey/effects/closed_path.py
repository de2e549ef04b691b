# SPDX-License-Identifier: Apache-2.0
"""Measures whether the cameras surround the stage: a ring has even gaps, an arc a wide one between its ends."""

from __future__ import annotations

import numpy as np

from studiorecon.geometry.camera_path import gaps_around
from studiorecon.scene.names import segment_name
from studiorecon.survey.coverage import mean_pair_deg
from studiorecon.survey.effects.surveyed import Measurement, SurveyedEffect
from studiorecon.survey.evidence import Evidence


def measure(evidence: Evidence, threshold: float) -> Measurement:
    """The widest gap between neighbours, as an angle about the centre that they look at.

    Views in the middle of a wide gap would show surfaces that no camera sees (U18).
    """
    cameras = evidence.material.cameras
    gaps = np.degrees([gap.rad for gap in gaps_around(cameras)])
    gap = float(gaps.max())
    around = "surround the stage" if gap <= threshold else "leave one side open"
    reason = (
        f"the cameras {around}: the widest gap is {gap:.0f} degrees, and any two are "
        f"{mean_pair_deg(cameras):.0f} degrees apart on average"
    )
    return Measurement(gap, (gap, gap), reason, {"widest": segment_name(int(gaps.argmax()))})


EFFECT = SurveyedEffect(
    name="closed_path",
    statistic="largest azimuth between neighbouring cameras",
    unit="degrees",
    threshold=150.0,
    paper="U18",
    on_above=False,
    used_by="the plan: views in the widest gap too",
    measure=measure,
)
