# SPDX-License-Identifier: Apache-2.0
"""Measures whether people's shadows move over the floor."""

from __future__ import annotations

from studiorecon.geometry.statistics import NOTHING
from studiorecon.rig.body_points import triangulate_tracks
from studiorecon.survey.effects.surveyed import Measurement, SurveyedEffect
from studiorecon.survey.evidence import LIMITS, Evidence
from studiorecon.survey.scene_change import floor_near_feet, largest_estimate, shadow_share

_ANKLES = ("left_ankle", "right_ankle")


def measure(evidence: Evidence, threshold: float) -> Measurement:
    """The share of the floor near feet that darkens, in the camera that shows most of it."""
    material = evidence.material
    feet = triangulate_tracks(material.tracks, _ANKLES, material.cameras, LIMITS)[0]
    found = []
    for small in evidence.small_films:
        times = small.film.times
        theirs = feet[:, times].transpose(0, 2, 1, 3).reshape(-1, len(times), 3)
        ring = floor_near_feet(small.camera, small.depth_m, material.floor_m, theirs)
        found.append(shadow_share(small.ratio, small.free, ring, small.film.runs) if ring.any() else NOTHING)
    value, interval, name = largest_estimate(evidence.names, found)
    reason = (
        "no camera sees floor near feet"
        if value is None
        else (f"{value:.1%} of the floor near feet darkens in {name}; the clean plates have no shadows of people")
    )
    return Measurement(value, interval, reason)


EFFECT = SurveyedEffect(
    name="moving_shadows",
    statistic="share of the floor within 1 m of feet that darkens by 5 % for five frames without changing hue",
    threshold=0.02,
    hidden_by=("moving_cameras", "changing_light"),
    used_by="the plan: estimates the light (render.light), and people cast shadows in films",
    measure=measure,
)
