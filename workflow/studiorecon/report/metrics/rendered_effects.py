# SPDX-License-Identifier: Apache-2.0
"""Effects that only a trained scene can show: statistics on what was rendered, and their decisions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from studiorecon.arrays import require
from studiorecon.geometry.statistics import NOTHING, Estimate, median, share
from studiorecon.scene.decisions import Decision
from studiorecon.scene.effects import ENHANCEMENT, INJECTION, REFINEMENT, TEMPORAL_APPEARANCE

# A pixel is thin below this alpha, or where fewer Gaussians lie than this share of the usual number.
_ALPHA, _DENSITY, _CELL_PX = 0.95, 0.25, 8
_LPIPS, _UNSEEN = 0.15, 0.1
_LEAST_POINTS, _PATCH_PX, _LEAST_FRAMES = 50, 64, 3
# A change of less than one grey level (of 1) between frames is none: static renders do not change at all.
_LEVEL = 1 / 255


def density_px(pixels: np.ndarray, hw: tuple[int, int]) -> np.ndarray:
    """(H, W) Gaussians per pixel whose centres project to ``pixels`` (N, 2; NaN behind the camera), counted in cells of
    8×8 pixels."""
    inside = np.isfinite(pixels).all(-1)
    edges = [np.arange(0, n + _CELL_PX, _CELL_PX) for n in hw]
    counted, _, _ = np.histogram2d(pixels[inside, 1], pixels[inside, 0], bins=edges)
    return np.kron(counted / _CELL_PX**2, np.ones((_CELL_PX, _CELL_PX)))[: hw[0], : hw[1]]


def thin_share(alpha: np.ndarray, density: np.ndarray) -> Estimate:
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


def excess_flicker(raw: np.ndarray, enhanced: np.ndarray, static: np.ndarray) -> Estimate:
    """By which share the change between successive frames grows through enhancement, on ``static`` pixels (H, W).

    ``raw``, ``enhanced`` (T, H, W) brightness in 0..1. A raw film that does not change counts as one that changes by
    one grey level. Nothing for fewer than four pictures or no static pixels.
    """
    require("enhanced", enhanced, raw.shape)
    if len(raw) <= _LEAST_FRAMES or not static.any():
        return NOTHING
    before, after = (
        np.abs(np.diff(film[:, static].astype(np.float64), axis=0)).mean(axis=1) for film in (raw, enhanced)
    )
    return median((after - before) / np.maximum(before, _LEVEL), _LEAST_FRAMES)


def decide_refinement(estimate: Estimate, threshold: float, was_on: bool = False) -> Decision:
    """Do views from other heights show holes, so that a round of refinement may be worth its views?"""
    reason = "no views from other heights were rendered"
    if estimate.value is not None:
        reason = (
            f"{estimate.value:.1%} of views from 15 % higher and lower are thin or empty; "
            "background.refinement.views adds such views"
        )
    return REFINEMENT.decide(estimate.value, estimate.interval, reason, threshold=threshold, was_on=was_on)


def appearance(found: Mapping[str, Decision | None], threshold: float) -> Decision:
    """The people's own decisions (name → what human training measured, None when it was not asked) as one: the one who
    drifts most."""
    asked = {name: (d.value, d) for name, d in found.items() if d is not None and d.value is not None}
    if not asked:
        why = (
            "nobody was trained"
            if not found
            else f"human training did not ask, or followed too little of {', '.join(found)}"
        )
        return TEMPORAL_APPEARANCE.decide(None, None, f"not measured here: {why}", threshold=threshold)
    _, most = max(asked.values(), key=lambda pair: pair[0])
    detail = {name: {"value": value, "verdict": d.verdict} for name, (value, d) in asked.items()}
    return TEMPORAL_APPEARANCE.decide(most.value, most.interval, most.reason, threshold=threshold, detail=detail)


def decide_enhancement(lpips: Estimate, unseen: Estimate, threshold: float, was_on: bool = False) -> Decision:
    """Is the render bad enough, or so much of the films unseen, that enhancement gains more than the fidelity it costs?

    Either is enough; both are on one scale, as multiples of 0.15 LPIPS at training views and of 10 % unseen.
    """
    scaled = [
        (e.value / limit, e.interval[0] / limit, e.interval[1] / limit, name)
        for e, limit, name in (
            (lpips, _LPIPS, "LPIPS at training views"),
            (unseen, _UNSEEN, "what the films show and no camera saw"),
        )
        if e.value is not None and e.interval is not None
    ]
    if not scaled:
        reason = "neither LPIPS nor the unseen share was measured"
        return ENHANCEMENT.decide(None, None, reason, threshold=threshold)
    value, low, high, name = max(scaled, key=lambda s: s[1])
    high = max(s[2] for s in scaled)
    reason = f"{name} is {value:.1f} times what is bearable"
    # With one of the two unmeasured, a small other one does not mean that enhancement is not needed.
    if len(scaled) < 2 and high <= threshold:
        return ENHANCEMENT.decide(None, None, f"{reason}, but the other half was not measured", threshold=threshold)
    return ENHANCEMENT.decide(value, (low, high), reason, threshold=threshold, was_on=was_on)


def decide_injection(estimates: Sequence[Estimate], history: int, threshold: float, was_on: bool = False) -> Decision:
    """Does enhancement flicker, so that earlier pictures should be injected? The worst of the films; ``history``
    pictures were.

    What does not flicker with injection may do so without: only a film made without any can say that none is needed.
    """
    known = [(e.value, e.interval) for e in estimates if e.value is not None and e.interval is not None]
    if not known:
        reason = "no film has a camera that stands still, so change over time says nothing"
        return INJECTION.decide(None, None, reason, threshold=threshold, was_on=was_on)
    value, interval = max(known, key=lambda pair: pair[0])
    reason = f"static pixels of enhanced films change {value:+.0%} more from frame to frame than the raw ones"
    if history and interval[0] <= threshold:
        reason += (
            f", with {history} earlier pictures injected; without them is not known "
            "(enhance.injection.history: 0 tells)"
        )
        return INJECTION.decide(None, None, reason, threshold=threshold)
    return INJECTION.decide(value, interval, reason, threshold=threshold, was_on=was_on)
