# SPDX-License-Identifier: Apache-2.0
"""Do the photos leave so much of the stage open that views between them have to be synthesised?"""

from __future__ import annotations

import numpy as np

from studiorecon.survey.coverage import PARALLAX_DEG, from_two_sides, largest_gap_deg, seen_by, stage_points
from studiorecon.survey.effects.surveyed import Measured, SurveyedEffect
from studiorecon.survey.evidence import Evidence


def measure(evidence: Evidence, threshold: float) -> Measured:
    """The share of the stage that is not covered.

    Where neighbours stand further apart than ``gap_deg``, what both see still looks different from between them: the
    share that counts as covered is lowered by the ratio of the two.
    """
    cameras, sampling = evidence.material.cameras, evidence.sampling
    points = stage_points(cameras, sampling.grid_m, sampling.height_m)
    if not len(points):
        reason = "the cameras stand on the spot they look at, so there is no stage between them"
        return Measured(None, None, reason)
    depths_m = [view.depth_m for view in evidence.material.views]
    seen = seen_by(points, cameras, depths_m, sampling.depth_tolerance)
    once, twice = float(seen.any(axis=0).mean()), float(from_two_sides(points, cameras, seen, PARALLAX_DEG).mean())
    gap = largest_gap_deg(cameras)
    near = min(sampling.gap_deg / gap, 1.0)
    error = float(np.sqrt(max(twice * (1 - twice), 1e-6) / len(points)))
    reason = (
        f"{once:.0%} of the stage is seen by one camera or more and {twice:.0%} from two "
        f"sides, with up to {gap:.0f} degrees between "
        "neighbours"
    )
    value = 1 - near * twice
    interval = max(value - 2 * near * error, 0.0), min(value + 2 * near * error, 1.0)
    counts = seen.sum(axis=0)
    shares = [float((counts >= least).mean()) for least in range(1, len(cameras) + 1)]
    return Measured(value, interval, reason, {"seen_by": shares})


EFFECT = SurveyedEffect(
    name="view_synthesis",
    statistic="share of the stage not seen from two sides, nor from within {gap_deg:.0f} degrees",
    threshold=0.1,
    paper="always",
    obeyed_by="the plan: views between the cameras are made only when on",
    measure=measure,
)
