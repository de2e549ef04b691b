# SPDX-License-Identifier: Apache-2.0
"""Training one person's canonical Gaussians on crops of all training cameras and frames.

Every iteration draws one crop, poses the Gaussians, renders them over a random colour, and carries the gradients back through
the skinning (paper, section 3.3 and appendix D). The random colour stands for the background the mask has cut away: what is
opaque there, or transparent on the person, is wrong whatever the colour (numerics U52).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from studiorecon.body.posing import Posing
from studiorecon.humans.footage import IGNORED, PERSON, Crop
from studiorecon.humans.motion import Motion
from studiorecon.progress import progress
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.adam import Adam
from studiorecon.splatting.losses import coverage, photometric
from studiorecon.splatting.rasterise import Rasteriser

_BETAS, _EPSILON = (0.9, 0.999), 1e-15


@dataclass(frozen=True)
class Losses:
    """Weights of the terms of a person's loss; see config.yaml."""

    l1: float
    ssim: float
    mask: float
    density: float
    surface: float
    pose: float


@dataclass(frozen=True)
class Rates:
    """Learning rates; see config.yaml."""

    position_m: float
    position_end_m: float
    rotation: float
    scale: float
    opacity: float
    colour: float
    harmonics: float
    pose_rad: float


@dataclass(frozen=True)
class Limits:
    """How far a Gaussian may stray: standard deviations as shares of the spacing, distance from the surface in metres."""

    smallest: float
    largest: float
    surface_m: float


def pixel_losses(
    rgb: np.ndarray, alpha: np.ndarray, crop: Crop, behind_rgb: np.ndarray, losses: Losses
) -> tuple[float, np.ndarray, np.ndarray]:
    """Loss of one rendered crop and its gradients by rgb (h, w, 3) and alpha (h, w)."""
    person = crop.verdict == PERSON
    weight = (crop.verdict != IGNORED).astype(np.float32)
    target = np.where(person[..., None], crop.rgb.astype(np.float32) / np.float32(255), behind_rgb.astype(np.float32))
    value, grad_rgb = photometric(rgb, target, weight, losses.l1, losses.ssim)
    counted = max(float(weight.sum()), 1.0)
    miss = (alpha - person) * weight
    value += losses.mask * float(np.abs(miss).sum()) / counted
    grad_alpha = np.sign(miss) * np.float32(losses.mask / counted)
    if losses.density > 0:
        extra, grad_density = coverage(alpha, None, weight, 0.0, losses.density)
        value += extra
        grad_alpha += grad_density
    return value, grad_rgb, grad_alpha


def held_near_surface(means_m: np.ndarray, start_m: np.ndarray, reach_m: float) -> np.ndarray:
    """(N, 3) gradient of mean(|Δ|²) / reach² for the way Δ from the surface each Gaussian started on: a person is where the body is."""
    return (2 / (reach_m**2 * len(means_m)) * (means_m - start_m)).astype(np.float32)


def train_gaussians(
    start: Gaussians, spacing_m: float, posing: Posing, motion: Motion, crops: Sequence[Crop], iterations: int, pose_from: int,
    losses: Losses, rates: Rates, limits: Limits, near_m: float, threads: int, rng: np.random.Generator,
) -> Gaussians:  # fmt: skip
    """The trained canonical Gaussians; ``motion`` is refined in place from iteration ``pose_from`` on when its rate is above 0.

    The number of Gaussians stays the same: they start on the surface, where a person's pixels come from.
    """
    own = {
        "means": start.means_m.copy(), "quaternions": start.quaternions.copy(), "scales": start.log_scales.copy(),
        "opacities": start.logit_opacities.copy(), "colour": start.sh[:, :1].copy(), "harmonics": start.sh[:, 1:].copy(),
    }  # fmt: skip
    adam = Adam(own, _BETAS, _EPSILON)
    fixed = {
        "quaternions": rates.rotation,
        "scales": rates.scale,
        "opacities": rates.opacity,
        "colour": rates.colour,
        "harmonics": rates.harmonics,
    }
    scale_range = np.log(spacing_m * limits.smallest), np.log(spacing_m * limits.largest)
    rasteriser = Rasteriser(near_m=near_m, threads=threads)
    with rasteriser.own_threads():
        for iteration in progress(range(iterations), "training", iterations):
            crop = crops[rng.integers(len(crops))]
            transforms = motion.transforms(crop.frame)
            means, quaternions, sh = posing.out(
                own["means"], own["quaternions"], np.concatenate([own["colour"], own["harmonics"]], axis=1), transforms
            )
            behind = rng.random(3)
            picture = rasteriser.forward(Gaussians(means, quaternions, own["scales"], own["opacities"], sh), crop.camera, behind)
            _, grad_rgb, grad_alpha = pixel_losses(picture.rgb, picture.alpha, crop, behind, losses)
            back = rasteriser.backward(grad_rgb, grad_alpha)
            grad_means, grad_quaternions, grad_sh = posing.back(back.means_m, back.quaternions, back.sh)
            grad_means += losses.surface * held_near_surface(own["means"], start.means_m, limits.surface_m)
            if rates.pose_rad > 0 and iteration >= pose_from:
                turn = motion.gradient(crop.frame, *posing.wrenches(own["means"], back.means_m, transforms))
                motion.step(crop.frame, turn + motion.smoothness_gradient(crop.frame, losses.pose), rates.pose_rad)
            gradients = {
                "means": grad_means, "quaternions": grad_quaternions, "scales": back.log_scales, "opacities": back.logit_opacities,
                "colour": grad_sh[:, :1], "harmonics": grad_sh[:, 1:],
            }  # fmt: skip
            position_m = float(np.exp(np.interp(iteration / iterations, [0, 1], np.log([rates.position_m, rates.position_end_m]))))
            adam.step(gradients, fixed | {"means": position_m}, back.screen > 0)
            # A needle at a joint or a blanket over the chest fits four views and spoils the fifth.
            np.clip(own["scales"], *scale_range, out=own["scales"])
    sh = np.concatenate([own["colour"], own["harmonics"]], axis=1)
    return Gaussians(own["means"], own["quaternions"], own["scales"], own["opacities"], sh)
