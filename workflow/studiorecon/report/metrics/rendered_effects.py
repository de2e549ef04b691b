# SPDX-License-Identifier: Apache-2.0
"""Effects that only a trained scene can show: statistics on what was rendered, and their decisions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require
from studiorecon.geometry.statistics import NOTHING, Estimate, share
from studiorecon.scene.decisions import Decision
from studiorecon.scene.effects import REFINEMENT, TEMPORAL_APPEARANCE

if TYPE_CHECKING:
    from jaxtyping import Float

# A pixel is thin below this alpha, or where fewer Gaussians lie than this share of the usual number.
_ALPHA, _DENSITY, _CELL_PX = 0.95, 0.25, 8
_LEAST_POINTS, _PATCH_PX = 50, 64


def density_px(pixels: Float[np.ndarray, "N 2"], hw: tuple[int, int]) -> Float[np.ndarray, "H W"]:
    """(H, W) Gaussians per pixel whose centres project to ``pixels`` (N, 2; NaN behind the camera), counted in cells of
    8×8 pixels."""
    inside = np.isfinite(pixels).all(-1)
    edges = [np.arange(0, n + _CELL_PX, _CELL_PX) for n in hw]
    counted, _, _ = np.histogram2d(pixels[inside, 1], pixels[inside, 0], bins=edges)
    return np.kron(counted / _CELL_PX**2, np.ones((_CELL_PX, _CELL_PX)))[: hw[0], : hw[1]]


def thin_share(alpha: Float[np.ndarray, "K H W"], density: Float[np.ndarray, "K H W"]) -> Estimate:
    """Share of pixels of views from other heights that are not covered: alpha below 0.95, or a quarter of the median
    density.

    ``alpha`` and ``density`` (projected Gaussians per pixel) are (K, H, W); NaN pixels do not count.
    """
    require("density", density, alpha.shape)
    known = np.isfinite(alpha) & np.isfinite(density)
    if known.sum() < _LEAST_POINTS * _PATCH_PX:
        return NOTHING
    thin = known & ((alpha < _ALPHA) | (density < _DENSITY * np.median(density[known])))
    return share(int(thin.sum()), int(known.sum()), known.sum() / _PATCH_PX)


def decide_refinement(estimate: Estimate, threshold: float) -> Decision:
    """Do views from other heights show holes, so that a round of refinement may be worth its views?"""
    reason = "no views from other heights were rendered"
    if estimate.value is not None:
        reason = (
            f"{estimate.value:.1%} of views from 15 % higher and lower are thin or empty; "
            "background.refinement.views adds such views"
        )
    return REFINEMENT.decide(estimate.value, estimate.interval, reason, threshold=threshold)


def appearance(found: Mapping[str, Decision | None], threshold: float) -> Decision:
    """The people's own decisions (name → what human training decided and did, None when it was not asked) as one: of
    whom it calls for most. ``threshold`` is said where nobody was asked."""
    asked = {name: (d.value, d) for name, d in found.items() if d is not None and d.value is not None}
    if not asked:
        why = (
            "nobody was trained"
            if not found
            else f"human training did not ask, or followed too little of {', '.join(found)}"
        )
        return TEMPORAL_APPEARANCE.decide(None, None, f"not measured here: {why}", threshold=threshold)
    _, most = max(asked.values(), key=lambda pair: (pair[1].called_for, pair[0]))
    detail = {name: {"value": value, "verdict": d.verdict} for name, (value, d) in asked.items()}
    return replace(most, obeyed_by=TEMPORAL_APPEARANCE.obeyed_by, detail=detail)
