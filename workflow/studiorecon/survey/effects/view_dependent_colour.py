# SPDX-License-Identifier: Apache-2.0
"""Measures whether colours depend on the direction of view, and how many directions there are to learn that from."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon.images.plate import noise_levels
from studiorecon.scene.decisions import Decision
from studiorecon.scene.files import write_json
from studiorecon.splatting.cpu.harmonics import degree_supported
from studiorecon.survey.coverage import stage_disc
from studiorecon.survey.effects.surveyed import Artefact, Measurement, SurveyedEffect
from studiorecon.survey.evidence import Evidence, Recordings
from studiorecon.survey.specularity import covisible_colours, specular_share

# Plates are medians of many pictures: their noise is a picture's over the root of about this many.
_PLATE_PICTURES = 16


def measure(evidence: Evidence, threshold: float) -> Measurement:
    """The share of surface points whose colour, divided by the cameras' gains, differs between directions of view.

    ``detail`` has the highest degree of harmonics that the real views can determine (G15).
    """
    material, sampling = evidence.material, evidence.sampling
    noise = float(np.median([noise_levels(f.pictures) for f in material.films])) / 255 / np.sqrt(_PLATE_PICTURES)
    colours, errors = covisible_colours(material.views, evidence.gains[2], noise, sampling.depth_tolerance)
    centre = np.array([*stage_disc(material.cameras)[0], material.floor_m + sampling.height_m / 2])
    degree = degree_supported(np.array([c.centre_m - centre for c in material.cameras]))
    estimate = specular_share(colours, errors)
    reason = "too few surface points are seen by two cameras to compare their colours"
    if estimate.value is not None:
        reason = (
            f"{estimate.value:.1%} of the surface that cameras share changes colour with direction; the real views "
            f"support harmonics of degree {degree} at most"
        )
    return Measurement(estimate.value, estimate.interval, reason, {"degree": degree})


def write(path: Path, decision: Decision, evidence: Evidence, recordings: Recordings) -> None:
    """Write the verdict to a file of its own, so that steps that use it rerun only when it changes."""
    write_json(path, {"degree": decision.detail["degree"]})


EFFECT = SurveyedEffect(
    name="view_dependent_colour",
    statistic="share of covisible static points whose colour varies beyond the 99 % limit of noise",
    threshold=0.05,
    hidden_by=("moving_cameras", "exposure"),
    used_by="background.train: harmonics for the room, if limit_sh_to_views",
    measure=measure,
    artefact=Artefact("specularity.json", write),
)
