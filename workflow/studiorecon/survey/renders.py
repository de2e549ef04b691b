# SPDX-License-Identifier: Apache-2.0
"""Effects that only a trained scene can show: statistics on what was rendered, and their decisions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from studiorecon.arrays import require
from studiorecon.scene.decisions import Decision, decide, not_measured
from studiorecon.scene.intervals import NOTHING, Estimate, median, share

# A pixel is thin below this alpha, or where fewer Gaussians lie than this share of the usual number.
_ALPHA, _DENSITY, _CELL_PX = 0.95, 0.25, 8
_LPIPS, _UNSEEN = 0.15, 0.1
_LEAST_POINTS, _PATCH_PX, _LEAST_FRAMES = 50, 64, 3
# A change of less than one grey level (of 1) between frames is none: static renders do not change at all.
_LEVEL = 1 / 255

REFINEMENT = "share of pixels from ±15 % height with alpha below 0.95 or a quarter of the median density of Gaussians"
APPEARANCE = "share of body points whose colour residual exceeds 3 times its noise and keeps its sign over time"
ENHANCEMENT = "LPIPS at training views over 0.15, or unseen share of the films over 10 %, whichever is larger"
INJECTION = "change between frames of the enhanced film over the raw one's, static pixels, less 1"


def later() -> list[Decision]:
    """What is not decided before training, with where it will be."""
    why = "only a trained scene shows it; survey/trained.json decides"
    statistics = {"refinement": REFINEMENT, "temporal_appearance": APPEARANCE, "enhancement": ENHANCEMENT, "injection": INJECTION}
    return [not_measured(effect, statistic, None, why) for effect, statistic in statistics.items()]


def density_px(pixels: np.ndarray, hw: tuple[int, int]) -> np.ndarray:
    """(H, W) Gaussians per pixel whose centres project to ``pixels`` (N, 2; NaN behind the camera), counted in cells of 8×8 pixels."""
    inside = np.isfinite(pixels).all(-1)
    edges = [np.arange(0, n + _CELL_PX, _CELL_PX) for n in hw]
    counted, _, _ = np.histogram2d(pixels[inside, 1], pixels[inside, 0], bins=edges)
    return np.kron(counted / _CELL_PX**2, np.ones((_CELL_PX, _CELL_PX)))[: hw[0], : hw[1]]


def thin_share(alpha: np.ndarray, density: np.ndarray) -> Estimate:
    """Share of pixels of views from other heights that are not covered: alpha below 0.95, or a quarter of the median density.

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

    ``raw``, ``enhanced`` (T, H, W) brightness in 0..1. A raw film that does not change counts as one that changes by one grey level.
    Nothing for fewer than four pictures or no static pixels.
    """
    require("enhanced", enhanced, raw.shape)
    if len(raw) <= _LEAST_FRAMES or not static.any():
        return NOTHING
    before, after = (np.abs(np.diff(film[:, static].astype(np.float64), axis=0)).mean(axis=1) for film in (raw, enhanced))
    return median((after - before) / np.maximum(before, _LEVEL), _LEAST_FRAMES)


def decide_refinement(estimate: Estimate, threshold: float, was_on: bool = False) -> Decision:
    """Do views from other heights show holes, so that a round of refinement may be worth its views?"""
    reason = "no views from other heights were rendered"
    if estimate.value is not None:
        reason = f"{estimate.value:.1%} of views from 15 % higher and lower are thin or empty; background.refinement.views adds such views"
    return decide("refinement", REFINEMENT, estimate.value, estimate.interval, threshold, reason, was_on=was_on)


def appearance(found: Mapping[str, Decision | None], threshold: float, obeyed_by: str) -> Decision:
    """The people's own decisions (name → what human training measured, None when it was not asked) as one: the one who drifts most."""
    asked = {name: d for name, d in found.items() if d is not None and d.value is not None}
    if not asked:
        why = "nobody was trained" if not found else f"human training did not ask, or followed too little of {', '.join(found)}"
        return not_measured("temporal_appearance", APPEARANCE, threshold, why, obeyed_by=obeyed_by)
    most = max(asked.values(), key=lambda d: d.value)
    return decide(
        "temporal_appearance", APPEARANCE, most.value, most.interval, threshold, most.reason, obeyed_by=obeyed_by,
        detail={name: {"value": d.value, "verdict": d.verdict} for name, d in asked.items()},
    )  # fmt: skip


def decide_enhancement(lpips: Estimate, unseen: Estimate, threshold: float, was_on: bool = False) -> Decision:
    """Is the render bad enough, or so much of the films unseen, that enhancement gains more than the fidelity it costs?

    Either is enough; both are on one scale, as multiples of 0.15 LPIPS at training views and of 10 % unseen.
    """
    scaled = [
        (e.value / limit, e.interval[0] / limit, e.interval[1] / limit, name)
        for e, limit, name in ((lpips, _LPIPS, "LPIPS at training views"), (unseen, _UNSEEN, "what the films show and no camera saw"))
        if e.value is not None and e.interval is not None
    ]
    if not scaled:
        return decide("enhancement", ENHANCEMENT, None, None, threshold, "neither LPIPS nor the unseen share was measured")
    value, low, high, name = max(scaled, key=lambda s: s[1])
    high = max(s[2] for s in scaled)
    reason = f"{name} is {value:.1f} times what is bearable"
    # With one of the two unmeasured, a small other one does not mean that enhancement is not needed.
    if len(scaled) < 2 and high <= threshold:
        return decide("enhancement", ENHANCEMENT, None, None, threshold, f"{reason}, but the other half was not measured")
    return decide("enhancement", ENHANCEMENT, value, (low, high), threshold, reason, was_on=was_on)


def decide_injection(estimates: Sequence[Estimate], history: int, threshold: float, was_on: bool = False) -> Decision:
    """Does enhancement flicker, so that earlier pictures should be injected? The worst of the films; ``history`` pictures were.

    What does not flicker with injection may do so without: only a film made without any can say that none is needed.
    """
    known = [e for e in estimates if e.value is not None and e.interval is not None]
    if not known:
        reason = "no film has a camera that stands still, so change over time says nothing"
        return decide("injection", INJECTION, None, None, threshold, reason, was_on=was_on)
    worst = max(known, key=lambda e: e.value)
    reason = f"static pixels of enhanced films change {worst.value:+.0%} more from frame to frame than the raw ones"
    if history and worst.interval[0] <= threshold:
        reason += f", with {history} earlier pictures injected; without them is not known (enhance.injection.history: 0 tells)"
        return decide("injection", INJECTION, None, None, threshold, reason)
    return decide("injection", INJECTION, worst.value, worst.interval, threshold, reason, was_on=was_on)
