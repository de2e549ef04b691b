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

from studiorecon.images.blur import gaussian_blur


@dataclass(frozen=True)
class Injection:
    """Settings of the injection.

    Attributes:
        history: K, the number of earlier outputs.
        strength: w, the overall share of history at full confidence.
        decay: weight of each frame relative to the one after it.
        error_threshold: τ_e, mean absolute RGB difference in levels of 255 at which confidence reaches zero.
        blur_px, blur_sigma_px: kernel that smooths the confidence.
        form: ``residual`` keeps constants constant; ``literal`` is the printed formula.
    """

    history: int
    strength: float
    decay: float
    error_threshold: float
    blur_px: int
    blur_sigma_px: float
    form: Literal["residual", "literal"]


def history_weights(existing: int, decay: float) -> np.ndarray:
    """(existing,) weights of the earlier frames, latest first, summing to 1 over those that exist (U03; numerics E03)."""
    weights = decay ** np.arange(existing, dtype=np.float64)
    return weights / weights.sum() if existing else weights


def confidence(render: np.ndarray, warped: np.ndarray, valid: np.ndarray, injection: Injection) -> np.ndarray:
    """(H, W) float32 confidence of one warped earlier output against the current render, both (H, W, 3) in [0, 1].

    Order: error → confidence → blur → zero where ``valid`` (H, W) is False, so that the blur cannot carry confidence back into
    uncovered pixels (U05, numerics E10). A non-finite error is no confidence (E04).
    """
    error_levels = np.abs(warped - render).mean(axis=-1) * 255
    trust = np.maximum(0.0, 1 - error_levels / injection.error_threshold)
    trust = np.where(np.isfinite(error_levels) & valid, np.nan_to_num(trust), 0.0)
    return gaussian_blur(trust, injection.blur_px, injection.blur_sigma_px) * valid


def inject(
    render: np.ndarray, warped: Sequence[np.ndarray], confidences: Sequence[np.ndarray], injection: Injection
) -> tuple[np.ndarray, np.ndarray]:
    """The blended input (H, W, 3) float32 and the share of it (H, W) that comes from earlier outputs; latest frame first.

    Without earlier frames the render itself and zeros. Constants stay constant in the residual form whatever the confidences.
    """
    shares = np.zeros(render.shape[:2], np.float32)
    added = np.zeros_like(render, dtype=np.float32)
    for weight, picture, trust in zip(history_weights(len(warped), injection.decay), warped, confidences, strict=True):
        share = (np.float32(injection.strength * weight) * trust).astype(np.float32)
        shares += share
        # Where confidence is zero the warped picture may be anything, NaN included.
        added += share[..., None] * np.where(trust[..., None] > 0, picture, 0)
    kept = 1 - (shares if injection.form == "residual" else np.float32(injection.strength if len(warped) else 0))
    blended = render * (kept[..., None] if injection.form == "residual" else kept) + added
    return blended.astype(np.float32), shares
