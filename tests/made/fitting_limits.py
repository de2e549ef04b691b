# SPDX-License-Identifier: Apache-2.0
"""What tests of fitting limits and their neighbours share."""

from __future__ import annotations

from studiorecon.body.fitting.fit import FitSettings

SETTINGS = FitSettings(
    iterations=30,
    tolerance=1e-6,
    point_sigma_m=0.005,
    correction_sigma_m=0.01,
    huber_units=3,
    pose_weight=1,
    limit_weight=1,
    beta_weight=1,
    vertex_weight=1,
    shape="shared",
    free_scale=False,
)
