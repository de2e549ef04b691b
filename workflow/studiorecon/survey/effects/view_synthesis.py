# SPDX-License-Identifier: Apache-2.0
"""Measures how much of the stage the photos of two neighbours leave open, for views synthesised between them."""

from __future__ import annotations

import numpy as np

from studiorecon.geometry.camera_path import gaps_around
from studiorecon.scene.effects import COVERED_DEG
from studiorecon.scene.names import segment_name
from studiorecon.survey.coverage import PARALLAX_DEG, has_parallax, stage_points, visible_points
from studiorecon.survey.effects.surveyed import Measurement, SurveyedEffect
from studiorecon.survey.evidence import Evidence


def measure(evidence: Evidence, threshold: float) -> Measurement:
    """The uncovered share of the part of the stage that either of two neighbours sees; the largest of all pairs.

    Where neighbours are further apart than ``COVERED_DEG``, surfaces that both see still change between them: the share
    that counts as covered is lowered by the ratio of the two.
    """
    cameras, sampling = evidence.material.cameras, evidence.sampling
    points = stage_points(cameras, sampling.grid_m, sampling.height_m)
    if not len(points):
        reason = "the cameras are at the point they face, so there is no space between them"
        return Measurement(None, None, reason)
    depths_m = [view.depth_m for view in evidence.material.views]
    seen = visible_points(points, cameras, depths_m, sampling.depth_tolerance)
    sides = has_parallax(points, cameras, seen, PARALLAX_DEG)
    gaps = gaps_around(cameras)
    parts = {}
    for number, gap in enumerate(gaps):
        theirs = sides[seen[gap.first] | seen[gap.second]]
        twice = float(theirs.mean()) if len(theirs) else 0.0
        near = min(np.radians(COVERED_DEG) / gap.rad, 1.0)
        error = float(np.sqrt(max(twice * (1 - twice), 1e-6) / max(len(theirs), 1)))
        value = 1 - near * twice
        parts[segment_name(number)] = (
            float(value),
            (float(max(value - 2 * near * error, 0.0)), float(min(value + 2 * near * error, 1.0))),
        )
    reason = (
        f"{seen.any(axis=0).mean():.0%} of the stage is seen by one camera or more and {sides.mean():.0%} from two "
        f"sides, with up to {np.degrees(max(gap.rad for gap in gaps)):.0f} degrees between neighbours"
    )
    counts = seen.sum(axis=0)
    shares = [float((counts >= least).mean()) for least in range(1, len(cameras) + 1)]
    return Measurement(*max(parts.values()), reason, {"seen_by": shares}, parts)


EFFECT = SurveyedEffect(
    name="view_synthesis",
    statistic=f"share of two neighbours' stage seen neither from two sides nor from within {COVERED_DEG:.0f} degrees",
    threshold=0.1,
    paper="always",
    used_by="the plan: views between these neighbours",
    measure=measure,
)
