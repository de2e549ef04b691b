# SPDX-License-Identifier: Apache-2.0
"""Do rows look one after the other, slowly enough to bend who moves?"""

from __future__ import annotations

from studiorecon.geometry.statistics import largest
from studiorecon.survey.effects.surveyed import Measured, SurveyedEffect
from studiorecon.survey.evidence import Evidence
from studiorecon.survey.speed import AT_WIDTH, by_camera, too_slow


def measure(evidence: Evidence, threshold: float) -> Measured:
    """The readout of each camera that body points call for, as the shift of the fastest people over their height."""
    cameras, found = evidence.material.cameras, evidence.causes
    scale = found.speed_px[1] * found.rows * AT_WIDTH / max(max(c.wh) for c in cameras)
    estimate = largest(found.readout * scale, found.readout_sigma * scale)
    value, interval, reason = estimate.value, estimate.interval, found.reason
    if value is not None:
        at = estimate.which
        reason = (
            f"{cameras[at].name} reads its rows in {found.readout[at]:+.2f} ± "
            f"{found.readout_sigma[at]:.2f} frame intervals"
        )
        if slow := too_slow(cameras, found):
            value, interval, reason = None, None, slow
    return Measured(value, interval, reason, {"readout": by_camera(cameras, found.readout)})


EFFECT = SurveyedEffect(
    name="rolling_shutter",
    statistic="shift over the rows that people cover, at the 95 % speed",
    unit="px at 1280",
    threshold=1.0,
    obeyed_by="people.fit: keypoints are moved by what people.associate measured by itself and in both halves of the "
    "clip; forced on, by what only one of them says too",
    hidden_by=("moving_cameras", "lens_distortion", "sync_offset"),
    measure=measure,
)
