# SPDX-License-Identifier: Apache-2.0
"""Motion-adaptive consistency injection: earlier outputs, warped onto the current render, enter the enhancer's input.

Paper, section Recursive Enhancement Module and its appendix; readings U01–U06 of its ambiguous passages:

    Ĩ_t = (1 - w Σ w̄_i c_i) Î_t + w Σ w̄_i c_i warp(O_{t-1-i}, F_{t→t-1-i}),    c_i = max(0, 1 - e_i / τ_e)

The paper prints 1 - w in front of Î_t, which darkens every pixel whose confidence is below one, by up to 46 of 255
levels (E01); it is available as ``form="literal"``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numba
import numpy as np

from studiorecon.arrays import require
from studiorecon.configuration.setting import setting
from studiorecon.images.blur import gaussian_blur

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


@dataclass(frozen=True)
class Injection:
    """Settings of the injection.

    Attributes:
        decay: weight of each earlier frame relative to the one after it (U03).
        blur_px, blur_sigma_px: the kernel that blurs the confidence (U05).
        cut_share: if a smaller share than this of a picture matches the one before it, injection restarts; 0 = never.
            Needs ``check``.
    """

    history: int = setting(
        3,
        "Earlier outputs in the enhancer's input; 0 = none.",
        minimum=0,
        maximum=30,
        paper="3; U03",
        paper_value=3,
    )
    strength: float = setting(
        0.9, "Share of history at full confidence.", minimum=0, below=1, paper="0.3; U02", paper_value=0.3
    )
    moving_strength: float = setting(
        0.6, "The same for films with a moving camera.", minimum=0, below=1, paper="0.3", paper_value=0.3
    )
    decay: float = 0.5
    error_threshold: float = setting(
        60.0,
        "Difference at which confidence reaches zero, levels of 255.",
        above=0,
        maximum=765,
        paper="30; U04",
        paper_value=30.0,
    )
    blur_px: int = 11
    blur_sigma_px: float = 2.0
    form: Literal["residual", "literal"] = setting(
        "residual",
        "residual keeps constants constant; literal is the printed formula, which darkens.",
        paper="literal; U01",
        paper_value="literal",
    )
    whole_levels: bool = setting(
        True,
        "Inject whole levels only, so that 8-bit feedback forgets moved content.",
        paper="false",
        paper_value=False,
    )
    check: bool = setting(
        True, "Use only flow that passes the forward-backward check.", paper="false; U06", paper_value=False
    )
    cut_share: float = 0.1


def history_weights(existing: int, decay: float) -> Float[np.ndarray, " K"]:
    """Weights of the earlier frames, latest first, summing to 1 over those that exist (U03; E03)."""
    weights = decay ** np.arange(existing, dtype=np.float64)
    return weights / weights.sum() if existing else weights


def confidence(
    render: Float[np.ndarray, "H W 3"],
    warped: Float[np.ndarray, "H W 3"],
    valid: Bool[np.ndarray, "H W"],
    injection: Injection,
) -> Float[np.ndarray, "H W"]:
    """Float32 confidence of one warped earlier output against the current render, both in [0, 1].

    Order: error → confidence → blur → zero where ``valid`` is False or the error is not finite, so that the blur cannot
    spread confidence into such pixels (U05, E04, E10). Raises ValueError for pictures of two sizes.
    """
    sizes = require("render", render, ("H", "W", 3))
    require("warped", warped, ("H", "W", 3), sizes)
    require("valid", valid, ("H", "W"), sizes)
    error_levels = difference_levels(np.ascontiguousarray(warped), np.ascontiguousarray(render))
    usable = np.isfinite(error_levels) & valid
    error_levels = np.where(usable, np.where(usable, error_levels, 0.0), injection.error_threshold)
    trust = np.maximum(0.0, 1 - error_levels / injection.error_threshold)
    return gaussian_blur(trust, injection.blur_px, injection.blur_sigma_px) * usable


def inject(
    render: Float[np.ndarray, "H W 3"],
    warped: Sequence[Float[np.ndarray, "H W 3"]],
    confidences: Sequence[Float[np.ndarray, "H W"]],
    injection: Injection,
) -> tuple[Float[np.ndarray, "H W 3"], Float[np.ndarray, "H W"]]:
    """The blended float32 input and the share of it that comes from earlier outputs; latest frame first.

    Without earlier frames it is the render itself and zeros. Constants stay constant in the residual form whatever the
    confidences. Raises ValueError for pictures of two sizes, or a confidence missing.
    """
    sizes = require("render", render, ("H", "W", 3))
    for picture, trust in zip(warped, confidences, strict=True):
        require("warped", picture, ("H", "W", 3), sizes)
        require("confidences", trust, ("H", "W"), sizes)
    shares = np.zeros(render.shape[:2], np.float32)
    added = np.zeros_like(render, dtype=np.float32)
    for weight, picture, trust in zip(history_weights(len(warped), injection.decay), warped, confidences, strict=True):
        add_share(added, shares, picture, trust, injection.strength * weight)
    if injection.form == "residual":
        blended = render * (1 - shares)[..., None] + added
    else:
        blended = render * (1 - np.float32(injection.strength if len(warped) else 0)) + added
    if injection.whole_levels:
        blended = render + whole_levels(blended - render)
    return blended.astype(np.float32), shares


def whole_levels(change: Float[np.ndarray, " ..."]) -> Float[np.ndarray, " ..."]:
    """float32 ``change`` of values in [0, 1], rounded towards 0 to whole levels of 255."""
    # A change of a whole level stays one, although its float32 may be just below.
    levels = 255 * change
    return np.trunc(levels + np.copysign(np.float32(1e-3), levels)).astype(np.float32) * np.float32(1 / 255)


@numba.njit(cache=True, nogil=True)
def difference_levels(
    first: Float[np.ndarray, "H W 3"], second: Float[np.ndarray, "H W 3"]
) -> Float[np.ndarray, "H W"]:
    """Float32 difference of two pictures in [0, 1], mean over channels in levels of 255 (U04, E11); NaN for NaN."""
    height, width = first.shape[:2]
    levels = np.empty((height, width), np.float32)
    for i in range(height):
        for j in range(width):
            a = np.float32(255) * abs(first[i, j, 0] - second[i, j, 0])
            b = np.float32(255) * abs(first[i, j, 1] - second[i, j, 1])
            c = np.float32(255) * abs(first[i, j, 2] - second[i, j, 2])
            levels[i, j] = (a + b + c) / np.float32(3)
    return levels


@numba.njit(cache=True, nogil=True)
def add_share(
    added: Float[np.ndarray, "H W 3"],
    shares: Float[np.ndarray, "H W"],
    picture: Float[np.ndarray, "H W 3"],
    trust: Float[np.ndarray, "H W"],
    weight: float,
) -> None:
    """Adds weight × trust to ``shares`` and that times ``picture``, which may be NaN at trust 0, to ``added``."""
    for i in range(shares.shape[0]):
        for j in range(shares.shape[1]):
            share = np.float32(weight) * trust[i, j]
            if share > 0:
                shares[i, j] += share
                for c in range(3):
                    added[i, j, c] += share * picture[i, j, c]
