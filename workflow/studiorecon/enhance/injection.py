# SPDX-License-Identifier: Apache-2.0
"""Motion-adaptive consistency injection: earlier outputs, warped onto the current render, enter the enhancer's input.

Paper, section Recursive Enhancement Module and its appendix; readings U01–U06 of its ambiguous passages:

    Ĩ_t = (1 - w Σ w̄_i c_i) Î_t + w Σ w̄_i c_i warp(O_{t-1-i}, F_{t→t-1-i}),    c_i = max(0, 1 - e_i / τ_e)

The paper prints 1 - w in front of Î_t, which darkens every pixel whose confidence is below one, by up to 46 of 255 levels
(numerics E01); it is available as ``form="literal"``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from studiorecon.arrays import require
from studiorecon.enhance.mixing import MEAN, NORM, SUM, add_share, difference_levels
from studiorecon.images.blur import gaussian_blur

_ERRORS = {"mean": MEAN, "norm": NORM, "sum": SUM}


@dataclass(frozen=True)
class Injection:
    """Settings of the injection.

    Attributes:
        history: K, the number of earlier outputs.
        strength: w, the overall share of history at full confidence.
        moving_strength: w for films whose camera moves: every pixel of every picture is then read between pixels, which blurs all of it.
        decay: weight of each frame relative to the one after it.
        error: how the RGB difference of a pixel becomes one number: ``mean`` over channels, ``norm`` or ``sum`` (U04).
        error_threshold: τ_e, that number in levels of 255 at which confidence reaches zero.
        blurred: what the blur smooths: the ``confidence``, or the ``error`` before it becomes confidence (U05).
        blur_px, blur_sigma_px: kernel of that blur.
        form: ``residual`` keeps constants constant; ``literal`` is the printed formula (U01).
        settle: what is mixed in moves no value by a part of a level. Outputs are fed back in eight bits, and rounding would otherwise hold
            a difference below 0.5 / (1 - w) levels for ever, a faint ghost of what has long moved on.
        flow: ``direct`` from the current render to each earlier one, or ``chained`` over the renders between them (U06).
        check: no confidence where the flow does not lead back (U06, numerics E10).
        cut_share: with less of a picture than this found again in the one before it, injection starts anew; 0 = never. Needs ``check``.
    """

    history: int
    strength: float
    moving_strength: float
    decay: float
    error: Literal["mean", "norm", "sum"]
    error_threshold: float
    blurred: Literal["confidence", "error"]
    blur_px: int
    blur_sigma_px: float
    form: Literal["residual", "literal"]
    settle: bool
    flow: Literal["direct", "chained"]
    check: bool
    cut_share: float


def history_weights(existing: int, decay: float) -> np.ndarray:
    """(existing,) weights of the earlier frames, latest first, summing to 1 over those that exist (U03; numerics E03)."""
    weights = decay ** np.arange(existing, dtype=np.float64)
    return weights / weights.sum() if existing else weights


def confidence(render: np.ndarray, warped: np.ndarray, valid: np.ndarray, injection: Injection) -> np.ndarray:
    """(H, W) float32 confidence of one warped earlier output against the current render, both (H, W, 3) in [0, 1].

    Order: error → confidence → blur → zero where ``valid`` (H, W) is False or the error is not finite, so that the blur cannot carry
    confidence back into uncovered or undefined pixels (U05, numerics E04, E10). Raises ValueError for pictures of two sizes.
    """
    sizes = require("render", render, ("H", "W", 3))
    require("warped", warped, ("H", "W", 3), sizes)
    require("valid", valid, ("H", "W"), sizes)
    error_levels = difference_levels(np.ascontiguousarray(warped), np.ascontiguousarray(render), _ERRORS[injection.error])
    usable = np.isfinite(error_levels) & valid
    # What is not finite counts as certainly wrong: just past the threshold, so that a blurred error stays in proportion.
    error_levels = np.where(usable, np.where(usable, error_levels, 0.0), injection.error_threshold)
    if injection.blurred == "error":
        error_levels = gaussian_blur(error_levels, injection.blur_px, injection.blur_sigma_px)
        return (np.maximum(0.0, 1 - error_levels / injection.error_threshold) * usable).astype(np.float32)
    trust = np.maximum(0.0, 1 - error_levels / injection.error_threshold)
    return gaussian_blur(trust, injection.blur_px, injection.blur_sigma_px) * usable


def inject(
    render: np.ndarray, warped: Sequence[np.ndarray], confidences: Sequence[np.ndarray], injection: Injection
) -> tuple[np.ndarray, np.ndarray]:
    """The blended input (H, W, 3) float32 and the share of it (H, W) that comes from earlier outputs; latest frame first.

    Without earlier frames the render itself and zeros. Constants stay constant in the residual form whatever the confidences. Raises
    ValueError for pictures of two sizes, or a confidence missing.
    """
    sizes = require("render", render, ("H", "W", 3))
    for picture, trust in zip(warped, confidences, strict=True):
        require("warped", picture, ("H", "W", 3), sizes)
        require("confidences", trust, ("H", "W"), sizes)
    shares = np.zeros(render.shape[:2], np.float32)
    added = np.zeros_like(render, dtype=np.float32)
    for weight, picture, trust in zip(history_weights(len(warped), injection.decay), warped, confidences, strict=True):
        add_share(added, shares, picture, trust, injection.strength * weight)
    kept = 1 - (shares if injection.form == "residual" else np.float32(injection.strength if len(warped) else 0))
    blended = render * (kept[..., None] if injection.form == "residual" else kept) + added
    if injection.settle:
        blended = render + whole_levels(blended - render)
    return blended.astype(np.float32), shares


def whole_levels(change: np.ndarray) -> np.ndarray:
    """float32 ``change`` of values in [0, 1], cut towards 0 to whole levels of 255."""
    # A change of a whole level stays one, although its float32 may lie just below.
    levels = 255 * change
    return np.trunc(levels + np.copysign(np.float32(1e-3), levels)).astype(np.float32) * np.float32(1 / 255)
