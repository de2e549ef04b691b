# SPDX-License-Identifier: Apache-2.0
"""Density control: when and where Gaussians are added or removed, as 3DGS does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.rotations import from_quaternion
from studiorecon.scene.gaussians import Gaussians, concatenate
from studiorecon.splatting.train.schedule import TrainingSettings

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

SPLIT_SHRINK = np.log(1.6)
"""A split Gaussian's halves are 1.6 times smaller (3DGS)."""


@dataclass(frozen=True)
class Growth:
    """Gaussians after growth; ``parent`` (M,) is the old index, ``fresh`` (M,) marks new ones."""

    gaussians: Gaussians
    parent: Integer[np.ndarray, " M"]
    fresh: Bool[np.ndarray, " M"]
    pruned: int


def is_density_control_on(settings: TrainingSettings, done: int) -> bool:
    """Whether density control continues: Gaussians added after the last step stay untrained (6 dB on the photos)."""
    return settings.densify != "none" and done <= settings.densify_until and done < settings.iterations


def is_growth_step(settings: TrainingSettings, done: int) -> bool:
    """Whether this is a step after which Gaussians are added."""
    return (
        is_density_control_on(settings, done) and done >= settings.densify_from and done % settings.densify_every == 0
    )


def grow_scene(
    gaussians: Gaussians,
    mean_gradient: Float[np.ndarray, " N"],
    settings: TrainingSettings,
    extent_m: float,
    rng: np.random.Generator,
) -> Growth:
    """``grow`` with the thresholds of a scene's training."""
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
    """Gaussians after pruning, then cloning or splitting those whose mean screen gradient exceeds ``threshold``.

    Opacities below ``prune_opacity`` are pruned. Those with a longest axis up to ``large_m`` are cloned, longer ones
    split, the strongest first, while there are fewer than ``cap`` (0 for no cap). The others stay in order.
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
    # One half of a split pair takes the old one's index, so that its descendants stay traceable; both are new to Adam.
    halves = [_split_halves(gaussians.take(split), rng) for _ in range(2)]
    index = np.concatenate([np.flatnonzero(kept), cloned, split])
    fresh = np.concatenate([np.isin(np.flatnonzero(kept), split), np.ones(len(cloned) + len(split), bool)])
    everyone = concatenate([gaussians, halves[0]])
    place = np.arange(gaussians.count)
    place[split] = gaussians.count + np.arange(len(split))
    result = concatenate([everyone.take(place[kept]), gaussians.take(cloned), halves[1]])
    return Growth(result, index, fresh, int((~kept).sum()))


def _split_halves(gaussians: Gaussians, rng: np.random.Generator) -> Gaussians:
    """Smaller Gaussians drawn from inside the given ones."""
    offsets = rng.normal(size=gaussians.means_m.shape) * np.exp(gaussians.log_scales.astype(np.float64))
    means = gaussians.means_m + np.einsum("nij,nj->ni", from_quaternion(gaussians.quaternions), offsets)
    return Gaussians(
        means, gaussians.quaternions, gaussians.log_scales - SPLIT_SHRINK, gaussians.logit_opacities, gaussians.sh
    )
