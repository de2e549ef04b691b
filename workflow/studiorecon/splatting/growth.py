# SPDX-License-Identifier: Apache-2.0
"""Where Gaussians are added and removed: clone and split where the screen gradient is large, prune the transparent (3DGS).

Pure functions on arrays: the training loop decides when, this module decides which.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from studiorecon.scene.gaussians import Gaussians, concatenate

SPLIT_SHRINK = np.log(1.6)
"""A split Gaussian's halves are 1.6 times smaller (3DGS)."""


@dataclass(frozen=True)
class Growth:
    """Gaussians after growth; ``parent`` (M,) is the old index, ``fresh`` (M,) marks new ones."""

    gaussians: Gaussians
    parent: np.ndarray
    fresh: np.ndarray
    pruned: int


def grow(
    gaussians: Gaussians,
    mean_gradient: np.ndarray,
    *,
    threshold: float,
    large_m: float,
    prune_opacity: float,
    cap: int,
    rng: np.random.Generator,
) -> Growth:
    """Prunes opacities below ``prune_opacity``, then clones (longest axis up to ``large_m``) or splits (longer) those whose mean screen
    gradient (N,) exceeds ``threshold``, the strongest first, while there are fewer than ``cap``. The order of the kept ones is kept.
    """
    kept = gaussians.logit_opacities >= np.log(prune_opacity / (1 - prune_opacity)) if prune_opacity > 0 else np.ones(gaussians.count, bool)
    strength = np.where(kept, mean_gradient, 0)
    chosen = np.flatnonzero(strength > threshold)
    room = max(0, cap - int(kept.sum()))
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
    means = gaussians.means_m + np.einsum("nij,nj->ni", rotations_of(gaussians.quaternions.astype(np.float64)), offsets)
    return Gaussians(means, gaussians.quaternions, gaussians.log_scales - SPLIT_SHRINK, gaussians.logit_opacities, gaussians.sh)


def rotations_of(quaternions: np.ndarray) -> np.ndarray:
    """(N, 3, 3) from (w, x, y, z) of any norm."""
    w, x, y, z = (quaternions / np.maximum(np.linalg.norm(quaternions, axis=1, keepdims=True), 1e-12)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
