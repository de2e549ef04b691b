# SPDX-License-Identifier: Apache-2.0
"""Does a person's colour change over time beside the pose, so that a temporal network is worth its time? (evaluation
§3, effect 2)

Photo minus render is followed at every Gaussian over the clip. Noise and a pose that jitters change their sign from
frame to frame; cloth that folds and light that one walks through keep it. What shows both a large and a lasting
residual drifts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from studiorecon.arrays import require
from studiorecon.body.avatar.posing import Posing
from studiorecon.geometry.statistics import NOTHING, Estimate, share
from studiorecon.humans.colours import in_view, nearest_surface, sampled
from studiorecon.humans.crops import OUTSIDE, PERSON, Crop
from studiorecon.humans.refined_motion import RefinedMotion
from studiorecon.scene.decisions import Decision, read_decisions
from studiorecon.scene.effects import TEMPORAL_APPEARANCE

_NOISE_RATIO, _MEMORY = 3.0, 0.3
_LEAST_FRAMES, _LEAST_POINTS = 12, 50
# Nobody sees a shade that wanders by less than this (standard deviation, of 1).
_VISIBLE = 2 / 255
# A fold covers about this many Gaussians: that many fewer are independent.
_PATCH = 25
# Pixels this near to the person's outline show the misfit of the body rather than its colour.
_OUTLINE_PX = 3


def followed(
    crops: Sequence[Crop],
    draw: Callable[[Crop], np.ndarray],
    posing: Posing,
    motion: RefinedMotion,
    means_m: np.ndarray,
    normals: np.ndarray,
    spacing_m: float,
) -> np.ndarray:
    """(N, T) float64: brightness of photo minus render at every Gaussian, mean of the cameras that show it, NaN where
    none does.

    ``draw`` renders a crop, (h, w, 3) in 0..1; ``means_m`` and ``normals`` (N, 3) are canonical.
    """
    sums, weights = np.zeros((len(means_m), len(motion.local))), np.zeros((len(means_m), len(motion.local)))
    still = np.tile(np.array([1, 0, 0, 0], np.float32), (len(means_m), 1))
    nothing = np.zeros((len(means_m), 1, 3), np.float32)
    kernel = np.ones((2 * _OUTLINE_PX + 1, 2 * _OUTLINE_PX + 1), np.uint8)
    for crop in crops:
        missing = (crop.rgb.astype(np.float32) / 255 - draw(crop)).mean(axis=2, keepdims=True)
        inner = cv2.erode((crop.verdict == PERSON).astype(np.uint8), kernel, borderType=cv2.BORDER_REPLICATE) > 0
        means = posing.out(np.asarray(means_m, np.float32), still, nothing, motion.transforms(crop.frame))[0].astype(
            np.float64
        )
        pixels, depth_m = crop.camera.project(means)
        reach = int(np.ceil(spacing_m * np.mean(crop.camera.focal_px) / max(float(np.median(depth_m)), 0.1)))
        trusted = Crop(crop.frame, crop.view, crop.camera, crop.rgb, np.where(inner, PERSON, OUTSIDE).astype(np.uint8))
        surface = nearest_surface(pixels, depth_m, crop.camera.hw, reach)
        index, at, weight = in_view(trusted, means, np.einsum("nab,nb->na", posing.turn, normals), surface)
        sums[index, crop.frame] += weight * sampled(missing, at)[:, 0]
        weights[index, crop.frame] += weight
    return np.where(weights > 0, sums / np.maximum(weights, 1e-12), np.nan)


def drifting_share(residual: np.ndarray) -> Estimate:
    """Share of body points whose residual (N, T) varies three times as much as its noise and keeps its sign over time.

    Noise is half the mean square of successive differences, which holds whatever does not last: the camera's noise and
    the jitter of the pose. Memory is the lag-1 autocorrelation, above 0.3. A shade of less than two grey levels of 255
    counts as none. Points need twelve frames with a successor; NaN is not seen.

    Raises:
        ValueError: ``residual`` is not (N, T).
    """
    require("residual", residual, ("N", "T"))
    pairs = np.isfinite(residual[:, 1:]) & np.isfinite(residual[:, :-1])
    enough = pairs.sum(axis=1) >= _LEAST_FRAMES
    if enough.sum() < _LEAST_POINTS:
        return NOTHING
    values, pairs = residual[enough], pairs[enough]
    count, seen = pairs.sum(axis=1), np.isfinite(values)
    centred = np.where(seen, values - np.nanmean(values, axis=1, keepdims=True), 0)
    variance = (centred**2).sum(axis=1) / seen.sum(axis=1)
    noise = (np.where(pairs, np.diff(centred, axis=1), 0) ** 2).sum(axis=1) / (2 * count)
    memory = np.where(pairs, centred[:, 1:] * centred[:, :-1], 0).sum(axis=1) / count / np.maximum(variance, 1e-12)
    drifts = (variance > np.maximum(_NOISE_RATIO * noise, _VISIBLE**2)) & (memory > _MEMORY)
    return share(int(drifts.sum()), len(drifts), max(len(drifts) / _PATCH, 1))


def was_drifting(person: str, earlier: Sequence[Path]) -> bool:
    """Whether an earlier run's audit measured that this person's colours drift; anybody's, where it knows no such
    person."""
    for decisions in map(read_decisions, earlier):
        found = decisions.get(TEMPORAL_APPEARANCE.name)
        if found is not None and not found.forced:
            own = found.detail.get(person)
            return own["verdict"] == "on" if own else found.called_for
    return False


def decide_appearance(person: str, estimate: Estimate, threshold: float, was_on: bool = False) -> Decision:
    """Is the temporal network worth training for this person, from ``threshold`` on? ``was_on``: an earlier run said
    so."""
    reason = f"too few points of {person}'s body are followed long enough"
    if estimate.value is not None:
        reason = f"the colour of {estimate.value:.0%} of {person}'s body drifts over time after posing"
    # Who acts on it is said where all people's decisions become one (report.audit).
    measured = TEMPORAL_APPEARANCE.decide(estimate.value, estimate.interval, reason, threshold=threshold, was_on=was_on)
    return replace(measured, obeyed_by="")
