# SPDX-License-Identifier: Apache-2.0
"""Measures whether a person's colour changes over time, apart from the pose, so that a temporal network pays.

Photo minus render is tracked at every Gaussian over the clip (evaluation §3, effect 2). Noise and a jittering pose
change its sign from frame to frame; folding cloth and changing light keep it. A Gaussian with a large and lasting
residual drifts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require, spread_indices
from studiorecon.body.avatar.posing import Posing
from studiorecon.geometry.statistics import NOTHING, Estimate, share_estimate
from studiorecon.humans.colours import nearest_surface, sample_colours, visible_gaussians
from studiorecon.humans.crops import OUTSIDE, PERSON, Crop, HeldCrop
from studiorecon.humans.refined_motion import RefinedMotion
from studiorecon.scene.decisions import Decision
from studiorecon.scene.effects import TEMPORAL_APPEARANCE

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

_NOISE_RATIO, _MEMORY = 3.0, 0.3
# Most frames that are tracked, and length of a run of successive ones: a longer clip would cost more without a clearer
# result.
_MOMENTS, _RUN = 240, 24
_MIN_FRAMES, _MIN_POINTS = 12, 50
# A change below this standard deviation (of 1) is invisible.
_VISIBLE = 2 / 255
# A fold covers about this many Gaussians, so their residuals are correlated.
_PATCH = 25
# Pixels this near to the person's outline show the misfit of the body rather than its colour.
_OUTLINE_PX = 3


def track_brightness(
    crops: Sequence[Crop],
    draw: Callable[[Crop], Float[np.ndarray, "h w 3"]],
    posing: Posing,
    motion: RefinedMotion,
    means_m: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    spacing_m: float,
) -> Float[np.ndarray, "N M"]:
    """Float64 brightness of photo minus render at every Gaussian, mean of the cameras that show it, NaN for none.

    Columns are the ``choose_frames``. ``draw`` renders a crop, in 0..1; positions and normals are canonical.
    """
    columns = {int(frame): column for column, frame in enumerate(choose_frames(len(motion.local))) if frame >= 0}
    sums = np.zeros((len(means_m), max(columns.values(), default=-1) + 1))
    weights = np.zeros_like(sums)
    still = np.tile(np.array([1, 0, 0, 0], np.float32), (len(means_m), 1))
    nothing = np.zeros((len(means_m), 1, 3), np.float32)
    kernel = np.ones((2 * _OUTLINE_PX + 1, 2 * _OUTLINE_PX + 1), np.uint8)
    for crop in (crop for crop in crops if crop.frame in columns):
        column = columns[crop.frame]
        missing = (crop.rgb.astype(np.float32) / 255 - draw(crop)).mean(axis=2, keepdims=True)
        inner = cv2.erode((crop.verdict == PERSON).astype(np.uint8), kernel, borderType=cv2.BORDER_REPLICATE) > 0
        means = posing.out(np.asarray(means_m, np.float32), still, nothing, motion.transforms(crop.frame))[0].astype(
            np.float64
        )
        pixels, depth_m = crop.camera.project(means)
        reach = int(np.ceil(spacing_m * np.mean(crop.camera.focal_px) / max(float(np.median(depth_m)), 0.1)))
        verdict = np.where(inner, PERSON, OUTSIDE).astype(np.uint8)
        trusted = HeldCrop(crop.frame, crop.view, crop.camera, crop.rgb, verdict)
        surface = nearest_surface(pixels, depth_m, crop.camera.hw, reach)
        index, at, weight = visible_gaussians(trusted, means, np.einsum("nab,nb->na", posing.turn, normals), surface)
        sums[index, column] += weight * sample_colours(missing, at)[:, 0]
        weights[index, column] += weight
    return np.where(weights > 0, sums / np.maximum(weights, 1e-12), np.nan)


def choose_frames(frames: int) -> Integer[np.ndarray, " M"]:
    """Tracked frames: all of a clip of up to 240, else ten runs of 24 with a -1 between them, which has no data."""
    if frames <= _MOMENTS:
        return np.arange(frames)
    starts = spread_indices(frames - _RUN + 1, _MOMENTS // _RUN)
    runs = [np.r_[np.arange(start, start + _RUN), -1] for start in starts]
    return np.concatenate(runs)[:-1]


def drifting_share(residual: Float[np.ndarray, "N T"]) -> Estimate:
    """Share of body points whose residual varies three times as much as its noise and keeps its sign over time.

    Noise is half the mean square of successive differences, which contains everything short-lived: the camera's noise
    and the jitter of the pose. Memory is the lag-1 autocorrelation, above 0.3. A variation of less than two grey levels
    of 255 counts as none. Points need twelve frames with a successor; NaN is not seen. Raises ValueError for another
    shape.
    """
    require("residual", residual, ("N", "T"))
    pairs = np.isfinite(residual[:, 1:]) & np.isfinite(residual[:, :-1])
    enough = pairs.sum(axis=1) >= _MIN_FRAMES
    if enough.sum() < _MIN_POINTS:
        return NOTHING
    values, pairs = residual[enough], pairs[enough]
    count, seen = pairs.sum(axis=1), np.isfinite(values)
    centred = np.where(seen, values - np.nanmean(values, axis=1, keepdims=True), 0)
    variance = (centred**2).sum(axis=1) / seen.sum(axis=1)
    noise = (np.where(pairs, np.diff(centred, axis=1), 0) ** 2).sum(axis=1) / (2 * count)
    memory = np.where(pairs, centred[:, 1:] * centred[:, :-1], 0).sum(axis=1) / count / np.maximum(variance, 1e-12)
    drifts = (variance > np.maximum(_NOISE_RATIO * noise, _VISIBLE**2)) & (memory > _MEMORY)
    return share_estimate(int(drifts.sum()), len(drifts), max(len(drifts) / _PATCH, 1))


def decide_appearance(person: str, estimate: Estimate, threshold: float) -> Decision:
    """The decision whether the temporal network is worth training for this person: from ``threshold`` on."""
    reason = f"too few points of {person}'s body are visible long enough"
    if estimate.value is not None:
        reason = f"the colour of {estimate.value:.0%} of {person}'s body drifts over time after posing"
    # report.audit combines the decisions of all people and names those on whom it acts.
    measured = TEMPORAL_APPEARANCE.decide(estimate.value, estimate.interval, reason, threshold=threshold)
    return replace(measured, used_by="")
