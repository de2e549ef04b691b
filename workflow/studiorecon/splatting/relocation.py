# SPDX-License-Identifier: Apache-2.0
"""Density control with a fixed budget: dead Gaussians move onto live ones, and the picture stays what it was.

After "3D Gaussian Splatting as Markov Chain Monte Carlo" (Kheradmand et al., NeurIPS 2024), equations 8 to 10, written from the
formulas. A live Gaussian that ends up as M coincident copies gives each the opacity 1 − (1 − o)^(1/M), so that their blend in the
centre is the old one, and scales all by one factor, so that the blend's integral along any line is the old one too.
"""

from __future__ import annotations

from dataclasses import replace
from math import comb

import numpy as np

from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.blocks import BlockedGaussians
from studiorecon.splatting.conventions import LANES, MEAN, OPACITY, QUATERNION, ROWS, SCALE
from studiorecon.splatting.growth import Growth, rotations_of

COPIES_MAX = 50
"""Most copies of one Gaussian: the alternating sum of the scale factor loses all digits soon after."""
_OPACITY_RANGE = 1e-6, 1 - 1e-6
# Random walk: full strength for opacity 0, half at 0.005, nothing above 0.1 (the paper's k = 100 and t = 0.995).
NOISE_STEEPNESS, NOISE_OPACITY, NOISE_NONE = 100.0, 0.005, 0.1


def shared_opacity(opacity: np.ndarray, copies: np.ndarray) -> np.ndarray:
    """Opacity (N,) float64 of each of ``copies`` (N,) coincident Gaussians that together are as opaque as one of ``opacity``."""
    return -np.expm1(np.log1p(-opacity) / copies)


def scale_factor(opacity: np.ndarray, copies: np.ndarray) -> np.ndarray:
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


def relocate(gaussians: Gaussians, *, dead_opacity: float, growth: float, cap: int, rng: np.random.Generator) -> Growth:
    """Every Gaussian of at most ``dead_opacity`` becomes a copy of a live one drawn by opacity; ``growth`` (share) more are added.

    The order of the given ones stays, additions come last, their number never exceeds ``cap`` (unless there were more before).
    Both the moved and those they joined are ``fresh``; ``pruned`` counts the moved.
    """
    n = gaussians.count
    opacity = 1 / (1 + np.exp(-gaussians.logit_opacities.astype(np.float64)))
    alive = opacity > dead_opacity
    dead = np.flatnonzero(~alive)
    added = max(0, min(cap, int((1 + growth) * n)) - n)
    if not alive.any() or len(dead) + added == 0:
        return Growth(gaussians, np.arange(n), np.zeros(n, bool), 0)
    chance = np.where(alive, opacity, 0)
    onto = rng.choice(n, len(dead) + added, p=chance / chance.sum())
    copies = np.minimum(1 + np.bincount(onto, minlength=n), COPIES_MAX)
    joined = np.flatnonzero(copies > 1)
    before = np.clip(opacity[joined], *_OPACITY_RANGE)
    shared = shared_opacity(before, copies[joined])
    logits, log_scales = gaussians.logit_opacities.copy(), gaussians.log_scales.copy()
    logits[joined] = np.log(shared) - np.log1p(-shared)
    log_scales[joined] += np.log(scale_factor(before, copies[joined]))[:, None].astype(np.float32)
    parent = np.arange(n)
    parent[dead] = onto[: len(dead)]
    parent = np.concatenate([parent, onto[len(dead) :]])
    fresh = np.zeros(len(parent), bool)
    fresh[joined], fresh[dead], fresh[n:] = True, True, True
    return Growth(replace(gaussians, logit_opacities=logits, log_scales=log_scales).take(parent), parent, fresh, len(dead))


def wander(blocked: BlockedGaussians, strength: float, rng: np.random.Generator) -> None:
    """Moves the faint Gaussians in place by ``strength`` · σ(−100 (o − 0.005)) · Σ η, Σ the covariance, η normal (equation 9)."""
    blocks = blocked.parameters.reshape(-1, ROWS, LANES)
    block, lane = np.nonzero(blocks[:, OPACITY] < NOISE_NONE)
    inside = block * LANES + lane < blocked.count
    block, lane = block[inside], lane[inside]
    chosen = blocks[block, :, lane].astype(np.float64)
    rotations = rotations_of(chosen[:, QUATERNION:OPACITY])
    drawn = np.einsum("nji,nj->ni", rotations, rng.normal(size=(len(block), 3)))
    spread = np.einsum("nij,nj->ni", rotations, chosen[:, SCALE:QUATERNION] ** 2 * drawn)
    gate = 1 / (1 + np.exp(NOISE_STEEPNESS * (chosen[:, OPACITY] - NOISE_OPACITY)))
    for axis in range(MEAN, SCALE):
        blocks[block, axis, lane] += (strength * gate * spread[:, axis - MEAN]).astype(np.float32)
