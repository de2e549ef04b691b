# SPDX-License-Identifier: Apache-2.0
"""May relative depth be aligned with scale and shift, or is the room so flat that only a scale can be told (
D02)?"""

from __future__ import annotations

from studiorecon.survey.effects.surveyed import Measured, SurveyedEffect
from studiorecon.survey.evidence import Evidence
from studiorecon.survey.resolution import depth_spread


def measure(evidence: Evidence, threshold: float) -> Measured:
    """How widely static depths spread, in the camera where they do least."""
    found = [depth_spread(view.depth_m) for view in evidence.material.views]
    known = [(e.value, e.interval, n) for n, e in zip(evidence.names, found) if e.value is not None]
    if not known:
        return Measured(None, None, "no camera knows enough depth")
    value, interval, name = min(known)
    reason = (
        f"{name}'s depths spread by {value:.0%} of their median, the least of all; a "
        "network's depth is aligned by a test of its own, "
        "camera by camera, and the planes' depth is metric and aligns nothing"
    )
    return Measured(value, interval, reason)


EFFECT = SurveyedEffect(
    name="depth_shift",
    statistic="least robust spread of a camera's static depth over its median",
    threshold=0.1,
    measure=measure,
)
