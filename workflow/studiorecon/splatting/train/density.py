# SPDX-License-Identifier: Apache-2.0
"""Density control: when and where Gaussians are added, removed or moved.

``grow`` clones and splits where the screen gradient is large and prunes the transparent (3DGS). ``relocate`` keeps the
number: dead Gaussians move onto live ones, and the picture stays what it was. The latter is after "3D Gaussian
Splatting as Markov Chain Monte Carlo" (Kheradmand et al., NeurIPS 2024), equations 8 and 9, written from the formulas:
a live Gaussian that ends up as M coincident copies gives each the opacity 1 − (1 − o)^(1/M), so that their blend in the
centre is the old one, and scales all by one factor, so that the blend's integral along any line is the old one too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import comb
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.rotations import from_quaternion
from studiorecon.scene.gaussians import Gaussians, concatenate
from studiorecon.splatting.train.schedule import TrainingSettings

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

SPLIT_SHRINK = np.log(1.6)
"""A split Gaussian's halves are 1.6 times smaller (3DGS)."""
COPIES_MAX = 50
"""Most copies of one Gaussian: the alternating sum of the scale factor loses all digits soon after."""
_OPACITY_RANGE = 1e-6, 1 - 1e-6


@dataclass(frozen=True)
class Growth:
    """Gaussians after growth; ``parent`` (M,) is the old index, ``fresh`` (M,) marks new ones."""

    gaussians: Gaussians
    parent: Integer[np.ndarray, " M"]
    fresh: Bool[np.ndarray, " M"]
    pruned: int


def watched(settings: TrainingSettings, done: int) -> bool:
    """Whether density control goes on after ``done`` steps. What is added after the last step would be in the result
    untrained: 6 dB on the photos when seen."""
    return settings.densify != "none" and done <= settings.densify_until and done < settings.iterations


def due(settings: TrainingSettings, done: int) -> bool:
    """Whether this is a step after which Gaussians are added or moved."""
    return watched(settings, done) and done >= settings.densify_from and done % settings.densify_every == 0


def controlled(
    gaussians: Gaussians,
    mean_gradient: Float[np.ndarray, " N"],
    settings: TrainingSettings,
    extent_m: float,
    rng: np.random.Generator,
) -> Growth:
    """The Gaussians after density control as ``densify`` says; ``mean_gradient`` (N,) is for "gradient" alone."""
    if settings.densify == "relocate":
        return relocate(gaussians, dead_opacity=settings.prune_opacity, rng=rng)
    return grow(
        gaussians,
        mean_gradient,
        threshold=settings.densify_gradient,
        large_m=settings.densify_scale * extent_m,
        prune_opacity=settings.prune_opacity,
        cap=settings.cap,
        rng=rng,
    )


def grow(
    gaussians: Gaussians,
    mean_gradient: Float[np.ndarray, " N"],
    *,
    threshold: float,
    large_m: float,
    prune_opacity: float,
    cap: int,
    rng: np.random.Generator,
) -> Growth:
    """Prunes opacities below ``prune_opacity``, then clones (longest axis up to ``large_m``) or splits (longer) those
    whose mean screen gradient (N,) exceeds ``threshold``, the strongest first, while there are fewer than ``cap``. The
    order of the kept ones is kept. A ``cap`` of 0 is none.
    """
    kept = (
        gaussians.logit_opacities >= np.log(prune_opacity / (1 - prune_opacity))
        if prune_opacity > 0
        else np.ones(gaussians.count, bool)
    )
    strength = np.where(kept, mean_gradient, 0)
    chosen = np.flatnonzero(strength > threshold)
    room = max(0, cap - int(kept.sum())) if cap else len(chosen)
    chosen = np.sort(chosen[np.argsort(-strength[chosen], kind="stable")][:room])
    longest = np.exp(gaussians.log_scales[chosen].max(axis=1))
    split, cloned = chosen[longest > large_m], chosen[longest <= large_m]
    # Of a split pair one half takes the old one's place, so that its descendants stay traceable; both are new to Adam.
    halves = [_half(gaussians.take(split), rng) for _ in range(2)]
    index = np.concatenate([np.flatnonzero(kept), cloned, split])
    fresh = np.concatenate([np.isin(np.flatnonzero(kept), split), np.ones(len(cloned) + len(split), bool)])
    everyone = concatenate([gaussians, halves[0]])
    place = np.arange(gaussians.count)
    place[split] = gaussians.count + np.arange(len(split))
    result = concatenate([everyone.take(place[kept]), gaussians.take(cloned), halves[1]])
    return Growth(result, index, fresh, int((~kept).sum()))


def _half(gaussians: Gaussians, rng: np.random.Generator) -> Gaussians:
    """Smaller Gaussians drawn from inside the given ones."""
    offsets = rng.normal(size=gaussians.means_m.shape) * np.exp(gaussians.log_scales.astype(np.float64))
    means = gaussians.means_m + np.einsum("nij,nj->ni", from_quaternion(gaussians.quaternions), offsets)
    return Gaussians(
        means, gaussians.quaternions, gaussians.log_scales - SPLIT_SHRINK, gaussians.logit_opacities, gaussians.sh
    )


def shared_opacity(opacity: Float[np.ndarray, " N"], copies: Integer[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """Opacity (N,) float64 of each of ``copies`` (N,) coincident Gaussians that together are as opaque as one of
    ``opacity``."""
    return -np.expm1(np.log1p(-opacity) / copies)


def scale_factor(opacity: Float[np.ndarray, " N"], copies: Integer[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """(N,) float64 factor of the copies' standard deviations: o / Σ_i Σ_k C(i−1, k) (−1)^k o'^(k+1) / √(k+1), i = 1…M.

    Swapping the sums leaves Σ_k (−1)^k C(M, k+1) o'^(k+1) / √(k+1): M terms instead of M²/2.
    """
    shared, factor = shared_opacity(opacity, copies), np.ones(len(opacity))
    for count in np.unique(copies):
        of_count = copies == count
        o = shared[of_count]
        total = sum((-1) ** (k - 1) * comb(int(count), k) * o**k / np.sqrt(k) for k in range(1, int(count) + 1))
        factor[of_count] = opacity[of_count] / total
    return factor


def relocate(gaussians: Gaussians, *, dead_opacity: float, rng: np.random.Generator) -> Growth:
    """Every Gaussian of at most ``dead_opacity`` becomes a copy of a live one drawn by opacity.

    Number and order stay. Both the moved and those they joined are ``fresh``; ``pruned`` counts the moved.
    """
    n = gaussians.count
    opacity = 1 / (1 + np.exp(-gaussians.logit_opacities.astype(np.float64)))
    alive = opacity > dead_opacity
    dead = np.flatnonzero(~alive)
    if not alive.any() or len(dead) == 0:
        return Growth(gaussians, np.arange(n), np.zeros(n, bool), 0)
    chance = np.where(alive, opacity, 0)
    onto = rng.choice(n, len(dead), p=chance / chance.sum())
    copies = np.minimum(1 + np.bincount(onto, minlength=n), COPIES_MAX)
    joined = np.flatnonzero(copies > 1)
    before = np.clip(opacity[joined], *_OPACITY_RANGE)
    shared = shared_opacity(before, copies[joined])
    logits, log_scales = gaussians.logit_opacities.copy(), gaussians.log_scales.copy()
    logits[joined] = np.log(shared) - np.log1p(-shared)
    log_scales[joined] += np.log(scale_factor(before, copies[joined]))[:, None].astype(np.float32)
    parent = np.arange(n)
    parent[dead] = onto
    fresh = np.zeros(n, bool)
    fresh[joined], fresh[dead] = True, True
    return Growth(
        replace(gaussians, logit_opacities=logits, log_scales=log_scales).take(parent), parent, fresh, len(dead)
    )
