# SPDX-License-Identifier: Apache-2.0
"""Measures whether the light changes while filming, and the brightness of every frame against the clean plate."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.footage.stills import shrink_plate
from studiorecon.geometry.statistics import Estimate, largest_estimate
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.decisions import Decision
from studiorecon.scene.factors import write_factors
from studiorecon.scene.people import Detections
from studiorecon.survey.clips import read_clip_pictures
from studiorecon.survey.effects.surveyed import Artefact, Measurement, SurveyedEffect
from studiorecon.survey.evidence import Evidence, Recordings
from studiorecon.survey.exposures import ExposureView
from studiorecon.survey.stillness import room_brightness

if TYPE_CHECKING:
    from jaxtyping import Float

# Frames in memory at a time.
_TOGETHER = 64


def measure(evidence: Evidence, threshold: float) -> Measurement:
    """The largest change in any camera; the reason says that light changes in all cameras at once."""
    names, worst = evidence.names, [largest_estimate(value[1:], error[1:]) for value, error in evidence.light]
    estimate = largest_estimate([w.value if w.value is not None else np.nan for w in worst], [_error(w) for w in worst])
    reason = "too little of the room is seen without people to compare its brightness over time"
    if estimate.value is not None:
        every = sum(1 for w in worst if w.interval is not None and w.interval[0] > threshold)
        whose = (
            "all cameras see it: the light" if every == len(names) > 1 else f"{every} of {len(names)} cameras see it"
        )
        reason = f"brightness changes by up to {estimate.value:.1%} in {names[estimate.which]}" + (
            f"; {whose}" if every else ""
        )
    return Measurement(estimate.value, estimate.interval, reason)


def _error(estimate: Estimate) -> float:
    if estimate.value is None or estimate.interval is None:
        return np.nan
    return (estimate.interval[1] - estimate.value) / 3


def write(path: Path, decision: Decision, evidence: Evidence, recordings: Recordings) -> None:
    """Write every frame's brightness against its plate, for the cameras where it can be measured."""
    changes: dict[str, np.ndarray] = {}
    if decision.is_on:
        longest_px = evidence.sampling.longest_px
        for video, view, own in zip(recordings.videos, evidence.material.views, recordings.found):
            course = brightness_over_time(video, view.camera, recordings.frames, own, view, longest_px)
            if course is None:
                say(
                    f"{view.camera.name}: too little of the room is visible without people to measure its light; its "
                    "frames are unchanged"
                )
            else:
                changes[view.camera.name] = course
    write_factors(path, changes)


def brightness_over_time(
    path: Path, camera: Camera, frames: int, found: Detections | None, view: ExposureView, longest_px: int
) -> Float[np.ndarray, "frames 3"] | None:
    """Factors of a film's brightness against its plate, equal in all channels; None when no frame can be measured.

    Frames that show too little of the room are interpolated. A change of the lamp's colour is not corrected.
    """
    level = np.concatenate(list(_levels(path, camera, frames, found, view, longest_px)))
    known = np.flatnonzero(np.isfinite(level))
    if not len(known):
        return None
    return np.exp(np.interp(np.arange(frames), known, level[known]))[:, None].repeat(3, axis=1)


def _levels(
    path: Path, camera: Camera, frames: int, found: Detections | None, view: ExposureView, longest_px: int
) -> Iterator[np.ndarray]:
    for first in range(0, frames, _TOGETHER):
        wanted = np.arange(first, min(first + _TOGETHER, frames))
        # Light varies over more than a few pixels: half of the survey's size suffices.
        pictures, free, _ = read_clip_pictures(path, camera, wanted, found, longest_px // 2)
        wh = (pictures.shape[2], pictures.shape[1])
        rgb, measured = shrink_plate(view.rgb, view.measured, wh)
        plate = np.rint(np.clip(rgb, 0, 1) * 255).astype(np.uint8)
        yield room_brightness(np.concatenate([plate[None], pictures]), np.concatenate([measured[None], free]))[0][1:]


EFFECT = SurveyedEffect(
    name="changing_light",
    statistic="largest log change of the room's brightness from the first picture",
    threshold=0.02,
    hidden_by=("moving_cameras",),
    used_by="masks.segment, humans.train, enhance.shot: frames are divided by their brightness; films have "
    "constant light",
    measure=measure,
    artefact=Artefact("brightness.json", write),
)
