# SPDX-License-Identifier: Apache-2.0
"""Training one person's canonical Gaussians on crops of all training cameras and frames.

Every iteration draws one crop, poses the Gaussians, renders them over a random colour, and carries the gradients back through
the skinning (paper, section 3.3 and appendix D). The random colour stands for the background the mask has cut away: what is
opaque there, or transparent on the person, is wrong whatever the colour (numerics U52).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from studiorecon.body.posing import Posing
from studiorecon.humans.appearance import Appearance
from studiorecon.humans.footage import IGNORED, PERSON, Crop
from studiorecon.humans.motion import Motion
from studiorecon.progress import progress, say, warn
from studiorecon.scene.decisions import from_entry
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.adam import Adam
from studiorecon.splatting.checkpoint import Checkpoint
from studiorecon.splatting.device import rasteriser as rasteriser_on
from studiorecon.splatting.feedback import Feedback
from studiorecon.splatting.losses import coverage, photometric
from studiorecon.splatting.perceptual import Perceptual, PerceptualSettings, perceptual
from studiorecon.splatting.rendering import Rendering

_BETAS, _EPSILON = (0.9, 0.999), 1e-15


@dataclass(frozen=True)
class Losses:
    """Weights of the terms of a person's loss; see config.yaml."""

    l1: float
    ssim: float
    lpips: PerceptualSettings
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


@dataclass(frozen=True)
class Support:
    """What a training run is given beside its subject: networks, where it keeps its state, where pictures of it go."""

    network: Perceptual | None = None
    appearance: Appearance | None = None
    checkpoint: Checkpoint | None = None
    previews: Path | None = None


def wanted_picture(crop: Crop, behind_rgb: np.ndarray) -> np.ndarray:
    """(h, w, 3) float32: the person as filmed, ``behind_rgb`` everywhere else."""
    person = (crop.verdict == PERSON)[..., None]
    return np.where(person, crop.rgb.astype(np.float32) / np.float32(255), behind_rgb.astype(np.float32))


def pixel_losses(
    rgb: np.ndarray, alpha: np.ndarray, crop: Crop, behind_rgb: np.ndarray, losses: Losses
) -> tuple[float, np.ndarray, np.ndarray]:
    """Loss of one rendered crop and its gradients by rgb (h, w, 3) and alpha (h, w); without the perceptual term."""
    weight = (crop.verdict != IGNORED).astype(np.float32)
    value, grad_rgb = photometric(rgb, wanted_picture(crop, behind_rgb), weight, losses.l1, losses.ssim)
    counted = max(float(weight.sum()), 1.0)
    miss = (alpha - (crop.verdict == PERSON)) * weight
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
    losses: Losses, rates: Rates, limits: Limits, near_m: float, threads: int, rng: np.random.Generator, support: Support,
    device: str = "cpu",
) -> Gaussians:  # fmt: skip
    """The trained canonical Gaussians; ``motion`` is refined in place from iteration ``pose_from`` on when its rate is above 0.

    The number of Gaussians stays the same: they start on the surface, where a person's pixels come from. A killed run taken up at
    its checkpoint ends with the same bytes.
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
    rasteriser = rasteriser_on(device, near_m=near_m, threads=threads)
    feedback, checkpoint = Feedback("person", 0, iterations, support.previews), support.checkpoint
    appearance, grey = support.appearance, np.full(3, 0.5)

    def draw(crop: Crop, behind: np.ndarray) -> tuple[Rendering, np.ndarray]:
        transforms = motion.transforms(crop.frame)
        colour, logits = own["colour"], own["opacities"]
        if appearance is not None:
            colour, logits = appearance.added(own["means"], colour, logits, crop.frame)
        sh = np.concatenate([colour, own["harmonics"]], axis=1)
        means, quaternions, sh = posing.out(own["means"], own["quaternions"], sh, transforms)
        posed = Gaussians(means, quaternions, own["scales"], logits, sh)
        return rasteriser.forward(posed, crop.camera, behind), transforms

    begin = 0
    if checkpoint is not None and (stored := checkpoint.load()) is not None:
        arrays, facts = stored
        adam.resume(arrays)
        motion.resume(arrays)
        feedback.resume(arrays)
        if appearance is not None:
            appearance.resume(arrays, from_entry(facts["decision"]) if facts["decision"] else None)
        begin, rng.bit_generator.state = facts["iteration"], facts["generator"]
        say(f"training goes on at iteration {begin}, where it was interrupted")
    with rasteriser.own_threads():
        for iteration in progress(range(begin, iterations), "training", iterations - begin):
            if appearance is not None and iteration == appearance.settings.start:
                appearance.begin(lambda crop: draw(crop, grey)[0].rgb)
            crop = crops[rng.integers(len(crops))]
            behind = rng.random(3)
            picture, transforms = draw(crop, behind)
            loss, grad_rgb, grad_alpha = pixel_losses(picture.rgb, picture.alpha, crop, behind, losses)
            if losses.lpips.weight > 0 and support.network is not None and iteration % losses.lpips.every == 0:
                wanted, weight = wanted_picture(crop, behind), crop.verdict != IGNORED
                distance, slope = perceptual(support.network, losses.lpips, picture.rgb, wanted, weight, rng)
                loss += distance
                grad_rgb += slope
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
            if appearance is not None:
                appearance.step(grad_sh[:, :1], back.logit_opacities)
            position_m = float(np.exp(np.interp(iteration / iterations, [0, 1], np.log([rates.position_m, rates.position_end_m]))))
            adam.step(gradients, fixed | {"means": position_m}, back.screen > 0)
            # A needle at a joint or a blanket over the chest fits four views and spoils the fifth.
            np.clip(own["scales"], *scale_range, out=own["scales"])
            if feedback.add(loss, crop_psnr_db(picture.rgb, crop)):
                view = crops[len(crops) // 2]
                name = f"frame {view.frame} of {view.camera.name}"
                feedback.tell(start.count, name, draw(view, grey)[0].rgb, wanted_picture(view, grey), view.verdict != IGNORED)
            if checkpoint is not None and checkpoint.due():
                facts, state = {"iteration": iteration + 1, "generator": rng.bit_generator.state}, {}
                if appearance is not None:
                    facts["decision"] = asdict(appearance.decision) if appearance.decision else None
                    state = appearance.arrays()
                checkpoint.save({**adam.arrays(), **motion.arrays(), **feedback.record(), **state}, facts)
    if adam.refused:
        warn(f"{adam.refused} gradient entries were not finite and were skipped")
    sh = np.concatenate([own["colour"], own["harmonics"]], axis=1)
    return Gaussians(own["means"], own["quaternions"], own["scales"], own["opacities"], sh)


def crop_psnr_db(rgb: np.ndarray, crop: Crop) -> float:
    """PSNR of a rendered crop (h, w, 3) on the person's own pixels; 0 when there are none."""
    person = crop.verdict == PERSON
    if not person.any():
        return 0.0
    errors = rgb[person] - crop.rgb[person].astype(np.float32) / np.float32(255)
    return float(-10 * np.log10(max(float(np.mean(errors * errors)), 1e-12)))
