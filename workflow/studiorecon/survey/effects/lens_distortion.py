# SPDX-License-Identifier: Apache-2.0
"""Is there radial distortion left in the frames, after the calibration's was removed?"""

from __future__ import annotations

import numpy as np

from studiorecon.geometry.statistics import largest
from studiorecon.scene.camera import Camera
from studiorecon.survey.effects.surveyed import Measured, SurveyedEffect
from studiorecon.survey.evidence import Evidence
from studiorecon.survey.speed import AT_WIDTH, by_camera


def measure(evidence: Evidence, threshold: float) -> Measured:
    """The radial shift of a corner that body points call for."""
    cameras, found = evidence.material.cameras, evidence.causes
    corners = np.array([_corner_shift(c) for c in cameras])
    estimate = largest(found.radial * corners, found.radial_sigma * corners)
    name = cameras[estimate.which].name if estimate.value is not None else ""
    reason = found.reason or (
        f"{name}: k1 = {found.radial[estimate.which]:+.4f} ± "
        f"{found.radial_sigma[estimate.which]:.4f} remains in its frames; "
        "a lens is corrected by the calibration: give one with distortion if this is on"
    )
    return Measured(estimate.value, estimate.interval, reason, {"radial": by_camera(cameras, found.radial)})


def _corner_shift(camera: Camera) -> float:
    """Shift of the furthest corner for k1 = 1, in pixels at 1280 wide."""
    corners = np.array([[0, 0], [camera.wh[0], 0], [0, camera.wh[1]], camera.wh], dtype=np.float64)
    radius = np.linalg.norm((corners - camera.principal_px) / camera.focal_px, axis=1).max()
    return float(radius**3 * np.mean(camera.focal_px) * AT_WIDTH / max(camera.wh))


EFFECT = SurveyedEffect(
    name="lens_distortion",
    statistic="largest radial shift in a corner, fitted jointly with body points",
    unit="px at 1280",
    threshold=1.0,
    hidden_by=("moving_cameras",),
    measure=measure,
)
