# SPDX-License-Identifier: Apache-2.0
"""Decides whether a film needs enhancement and injection, on a few pictures before the film is made.

``transfer_strength``: the gain of transferred residuals at training cameras that were left out; ``flicker_increase``:
how much more enhanced pictures change than their renders. Held-out cameras are not used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.enhance.photos import Training
from studiorecon.footage.video import read_frames_from, to_float
from studiorecon.geometry.statistics import NOTHING, Estimate, mean_estimate, median_estimate
from studiorecon.images.flow import one_thread
from studiorecon.images.transfer import Transfer, best_strength, transfer_residual
from studiorecon.images.warp import warp
from studiorecon.models.protocols import Enhancer, Flow, Moment
from studiorecon.recursive.alignment import backward_flow
from studiorecon.scene.decisions import Decision
from studiorecon.scene.effects import ENHANCEMENT, INJECTION
from studiorecon.scene.path import PathStep

if TYPE_CHECKING:
    from jaxtyping import Integer

# Below this share of pixels seen by two training cameras at once, the residual's gain cannot be measured.
_MIN_EVIDENCE = 0.01
# Number of compared pairs of neighbouring pictures, the fewest for an estimate, and the smallest change that counts:
# one level.
_PAIRS, _MIN_PAIRS, _LEVEL = 8, 3, 1 / 255


def transfer_strength(training: Training, frames: int, transfer: Transfer, threshold: float) -> tuple[float, Decision]:
    """Strength of the residual transfer: the factor that best predicts each training camera from the others.

    Also the decision on it. Every camera is predicted with the factor of the others, over ``frames`` moments. Its gain,
    in dB, counts only pixels that others see too, for films stay nearer to the cameras than those are to each other.
    Undetermined, with strength 0, when the training cameras see too little in common.
    """
    count = len(training.cameras)
    predicted: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in range(count)]
    smoothed: list[list[np.ndarray]] = [[] for _ in range(count)]
    before, with_photo, with_itself = np.zeros(count), np.zeros(count), np.zeros(count)
    for frame in spread_indices(training.frames, frames):
        sources = training.sources(int(frame), transfer)
        for index, own in enumerate(sources):
            others = sources[:index] + sources[index + 1 :]
            found, cover = transfer_residual(own.camera, own.depth_m, others, transfer)
            predicted[index].append((found, cover))
            smoothed[index].append(own.residual)
            whole, added = training.residual(index, int(frame)), cover[..., None] * found
            before[index] += float((whole * whole)[cover > 0].sum(dtype=np.float64))
            with_photo[index] += float((whole * added).sum(dtype=np.float64))
            with_itself[index] += float((added * added).sum(dtype=np.float64))
    everybody = range(count)
    strength, evidence = best_strength(*_select_cameras(everybody, predicted, smoothed))
    if evidence < _MIN_EVIDENCE:
        few = f"only {100 * evidence:.1f} % of the training pixels are seen by a second training camera"
        return 0.0, ENHANCEMENT.decide(None, None, few, threshold=threshold)
    gains = np.full(count, np.nan)
    for index in everybody:
        factor, shared = best_strength(*_select_cameras([k for k in everybody if k != index], predicted, smoothed))
        left = before[index] - 2 * factor * with_photo[index] + factor**2 * with_itself[index]
        if shared >= _MIN_EVIDENCE:
            # Renders equal to the photos leave nothing to gain.
            gains[index] = 10 * np.log10(before[index] / max(left, 1e-9 * before[index])) if before[index] > 0 else 0.0
    gain = mean_estimate(gains, 2)
    if gain.value is None:
        few = "fewer than two training cameras see what the others see"
        return strength, ENHANCEMENT.decide(None, None, few, threshold=threshold)
    reason = (
        f"detail that renders miss, added with strength {strength:.2f}, gains {gain.value:+.2f} dB at a left-out "
        f"training camera, on the {100 * evidence:.0f} % of its pixels that others see"
    )
    decision = ENHANCEMENT.decide(gain.value, gain.interval, reason, threshold=threshold)
    return strength, decision


def _select_cameras(
    cameras: Iterable[int], predicted: list[list[tuple[np.ndarray, np.ndarray]]], residuals: list[list[np.ndarray]]
) -> tuple[list[tuple[np.ndarray, np.ndarray]], list[np.ndarray]]:
    chosen = list(cameras)
    return [one for k in chosen for one in predicted[k]], [one for k in chosen for one in residuals[k]]


def flicker_increase(
    steps: Sequence[PathStep],
    render: Path,
    depth: Path,
    reference: Callable[[PathStep], Integer[np.ndarray, "h w 3"]],
    enhancer: Enhancer,
    search: Flow,
) -> Estimate:
    """Relative increase, by enhancement, of the change between neighbouring pictures along the renders' flow.

    No estimate for films of fewer than three pairs. ``depth``: in millimetres; ``reference``: the photo for a picture.
    """
    pairs = [i for i in range(1, len(steps)) if steps[i].segment == steps[i - 1].segment]
    grown = []
    for index in (pairs[i] for i in spread_indices(len(pairs), min(_PAIRS, len(pairs)))):
        drawn = list(read_frames_from(render, index - 1, index + 1))
        depths = list(read_frames_from(depth, index - 1, index + 1))
        better = [
            _enhance_picture(enhancer, picture, millimetres, steps[at], reference(steps[at]))
            for at, picture, millimetres in zip((index - 1, index), drawn, depths, strict=True)
        ]
        if drawn[0].shape != drawn[1].shape:
            continue
        with one_thread():
            back, valid = backward_flow(drawn[1], drawn[0], search, check=True)
        changes = []
        for earlier, later in ((to_float(drawn[0]), to_float(drawn[1])), (better[0], better[1])):
            warped, inside = warp(earlier, back)
            changes.append(np.abs(later - warped).mean(axis=-1)[inside & valid])
        if len(changes[0]):
            raw, enhanced = (float(change.mean(dtype=np.float64)) for change in changes)
            grown.append((enhanced - raw) / max(raw, _LEVEL))
    return median_estimate(np.array(grown), _MIN_PAIRS) if grown else NOTHING


def _enhance_picture(
    enhancer: Enhancer, picture: np.ndarray, millimetres: np.ndarray, step: PathStep, photo: np.ndarray
) -> np.ndarray:
    """A picture (h, w, 3) through the enhancer without earlier ones; non-finite values stay as rendered."""
    depth_m, image = millimetres.astype(np.float32) / 1000, to_float(picture)
    moment = Moment(step.camera, step.frame, depth_m, np.zeros(depth_m.shape, np.float32))
    output = enhancer.enhance(image, to_float(photo), moment)
    return np.where(np.isfinite(output), output, image).astype(np.float32)


def decide_injection(change: Estimate, threshold: float) -> Decision:
    """The decision whether enhanced pictures change so much more than the renders that earlier ones are injected."""
    if change.value is None:
        reason = "the film has too few pictures that follow one another"
        return INJECTION.decide(None, None, reason, threshold=threshold)
    reason = f"enhanced pictures change {change.value:+.0%} more from one to the next than the renders they are made of"
    return INJECTION.decide(change.value, change.interval, reason, threshold=threshold)
