# SPDX-License-Identifier: Apache-2.0
"""Does a camera's clock still run beside the others'? Nobody who stands still can tell (V07).

A finding: ``clocks.offsets`` has put clocks right before; what is left shows how well."""

from __future__ import annotations

from studiorecon.geometry.statistics import largest
from studiorecon.survey.effects.surveyed import Measured, SurveyedEffect
from studiorecon.survey.evidence import Evidence
from studiorecon.survey.speed import by_camera, too_slow


def measure(evidence: Evidence, threshold: float) -> Measured:
    """The lag of each camera that body points call for."""
    cameras, found = evidence.material.cameras, evidence.causes
    estimate = largest(found.lag_frames, found.lag_sigma)
    value, interval, reason = estimate.value, estimate.interval, found.reason
    if value is not None:
        name, at = cameras[estimate.which].name, estimate.which
        reason = (
            f"{name} looks {found.lag_frames[at]:+.2f} ± {found.lag_sigma[at]:.2f} "
            "frames later than the others; lags lower "
            f"the squared residual by {max(found.fall, 0):.0%}"
        )
        if slow := too_slow(cameras, found):
            value, interval, reason = None, None, slow
    return Measured(value, interval, reason, {"lag_frames": by_camera(cameras, found.lag_frames)})


EFFECT = SurveyedEffect(
    name="sync_offset",
    statistic="largest lag of a camera behind the mean of the others",
    unit="frames",
    threshold=0.1,
    hidden_by=("moving_cameras", "lens_distortion"),
    measure=measure,
)
