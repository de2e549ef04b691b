# SPDX-License-Identifier: Apache-2.0
"""One person in training: canonical Gaussians, crops of all training cameras and frames, terms and hooks.

Every step draws one crop, poses the Gaussians, renders them over a random colour, and carries the gradients back
through the skinning (paper, section 3.3 and appendix D). The random colour replaces the background that the mask has
removed: opaque pixels there, or transparent ones on the person, are wrong with any colour (U52). The hooks are the
temporal network, which begins late, and the pose, which moves with the Gaussians.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from studiorecon.body.avatar.posing import Posing
from studiorecon.body.avatar.weight_grid import WeightGrid, all_bone_weights
from studiorecon.humans.additions import Additions
from studiorecon.humans.appearance import Appearance
from studiorecon.humans.crops import IGNORED, PERSON, Crop
from studiorecon.humans.refined_motion import RefinedMotion
from studiorecon.humans.train_settings import GaussianLimits, Growing, Losses, Rates
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.train.density import grow
from studiorecon.splatting.train.optimiser import Adam
from studiorecon.splatting.train.targets import Target
from studiorecon.splatting.train.terms import PlaneView
from studiorecon.splatting.train.trainer import Preview

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num, Shaped

GREY = np.full(3, 0.5)


def training_target(crop: Crop, behind_rgb: Num[np.ndarray, " 3"]) -> Target:
    """The person as filmed, over ``behind_rgb``; undecided pixels are masked."""
    rgb, weight = np.empty(crop.rgb.shape, np.float32), np.empty(crop.verdict.shape, np.float32)
    _paint_target(crop.rgb, crop.verdict, behind_rgb.astype(np.float32), rgb, weight)
    return Target(crop.camera, rgb, weight, background_rgb=tuple(behind_rgb), silhouette=crop.verdict == PERSON)


@numba.njit(cache=True)
def _paint_target(photo, verdict, behind_rgb, rgb, weight):
    for y in range(verdict.shape[0]):
        for x in range(verdict.shape[1]):
            weight[y, x] = np.float32(verdict[y, x] != IGNORED)
            for channel in range(3):
                own = np.float32(photo[y, x, channel]) / np.float32(255)
                rgb[y, x, channel] = own if verdict[y, x] == PERSON else behind_rgb[channel]


def surface_pull_gradient(
    means_m: Float[np.ndarray, "N 3"], start_m: Float[np.ndarray, "N 3"], reach_m: float
) -> Float[np.ndarray, "N 3"]:
    """Gradient of mean(|Δ|²) / reach² for the distance Δ from each start: the person is on the body."""
    return (2 / (reach_m**2 * len(means_m)) * (means_m - start_m)).astype(np.float32)


class PersonInTraining:
    """A person for ``splatting.train.trainer.train``; ``motion`` and ``appearance`` are refined in place.

    Gaussians start on the surface, because a person's pixels come from there. Their number is constant unless
    ``growing`` is set; new ones are carried by the bones of the one they come from. The pose moves from iteration
    ``pose_from`` on when its rate is above 0. With a ``grid`` the weights are sampled at every step at the Gaussians'
    current positions (Eq. 6; the weights' own gradient is ignored). ``source`` is the initial Gaussian that each
    descends from.
    """

    def __init__(
        self,
        start: Gaussians,
        spacing_m: float,
        posing: Posing,
        motion: RefinedMotion,
        crops: Sequence[Crop],
        iterations: int,
        pose_from: int,
        losses: Losses,
        rates: Rates,
        limits: GaussianLimits,
        near_m: float,
        threads: int,
        rng: np.random.Generator,
        appearance: Appearance | None = None,
        growing: Growing | None = None,
        additions: Additions | None = None,
        grid: WeightGrid | None = None,
    ) -> None:
        self._own = {
            "means": start.means_m.copy(),
            "quaternions": start.quaternions.copy(),
            "scales": start.log_scales.copy(),
            "opacities": start.logit_opacities.copy(),
            "colour": start.sh[:, :1].copy(),
            "harmonics": start.sh[:, 1:].copy(),
        }
        self.adam = Adam(self._own)
        self._limits, self._growing, self._additions = limits, growing or Growing(), additions or Additions()
        self._grid = grid
        self.source = np.arange(start.count)
        self._first_m, self._first = start.means_m, posing
        self._seen = None if appearance is None else appearance.seen
        self._height_m = float(np.ptp(start.means_m, axis=0).max())
        self._start_m, self._watched = start.means_m, np.zeros((2, start.count))
        self._scale_range = np.log(spacing_m * limits.smallest), np.log(spacing_m * limits.largest)
        self._posing, self._motion, self._appearance, self._crops = posing, motion, appearance, crops
        self._iterations, self._pose_from, self._losses, self._rates = iterations, pose_from, losses, rates
        self._near_m, self._rng, self._rasteriser = near_m, rng, Rasteriser(near_m=near_m, threads=threads)

    def gaussians(self) -> Gaussians:
        """The current canonical Gaussians."""
        own = self._own
        sh = np.concatenate([own["colour"], own["harmonics"]], axis=1)
        return Gaussians(own["means"], own["quaternions"], own["scales"], own["opacities"], sh)

    @property
    def refused(self) -> int:
        """Gradient entries so far that were not finite."""
        return self.adam.refused

    def finish(self) -> None:
        """Does nothing: motion and temporal network are moved in place."""

    @property
    def bones(self) -> Integer[np.ndarray, "N K"]:
        """The joints that carry each Gaussian."""
        return self._posing.bones

    @property
    def weights(self) -> Float[np.ndarray, "N K"]:
        """Skinning weights at the Gaussians' current positions."""
        return self._posing.weights if self._grid is None else self._grid.query(self._own["means"])

    def threads(self) -> AbstractContextManager[None]:
        """The rasteriser's own context of threads."""
        return self._rasteriser.own_threads()

    def begin(self, iteration: int) -> None:
        """Start the temporal network, or not, once the person can be measured."""
        if self._appearance is not None and iteration == self._appearance.settings.start:
            self._appearance.begin(self._shown)

    def draw(self, iteration: int) -> PlaneView:
        """The view of a crop, posed and rendered over a random colour, or black."""
        _, behind = self._next_crop()
        planes = self._rasteriser.forward_planes(self._posed(self._crop), self._crop.camera, behind.tolist())
        return PlaneView(training_target(self._crop, behind), iteration, self._rng, planes, np.zeros_like(planes))

    def _next_crop(self) -> tuple[Crop, Float[np.ndarray, " 3"]]:
        """The next crop, and the colour behind the person."""
        self._crop = self._crops[int(self._rng.integers(len(self._crops)))]
        return self._crop, self._rng.random(3) if self._additions.background == "random" else np.zeros(3)

    def _shown(self, crop: Crop) -> np.ndarray:
        """(h, w, 3) render of the person over grey."""
        return self._rasteriser.forward(self._posed(crop), crop.camera, GREY.tolist()).rgb

    def _posed(self, crop: Crop) -> Gaussians:
        own = self._own
        if self._grid is not None:
            self._posing.weights = self.weights
        self._transforms = self._motion.transforms(crop.frame)
        colour, logits = own["colour"], own["opacities"]
        if self._appearance is not None:
            colour, logits = self._appearance.add_residuals(own["means"], colour, logits, crop.frame)
        sh = np.concatenate([colour, own["harmonics"]], axis=1)
        means, quaternions, sh = self._posing.out(own["means"], own["quaternions"], sh, self._transforms)
        return Gaussians(means, quaternions, own["scales"], logits, sh)

    def step(self, iteration: int, view: PlaneView, loss: float) -> tuple[float, float]:
        """Move pose, temporal network and Gaussians by gradients through the pose; returns loss and PSNR."""
        own, losses, rates, frame = self._own, self._losses, self._rates, self._crop.frame
        back = self._rasteriser.backward_planes(view.gradient)
        grad_means, grad_quaternions, grad_sh = self._posing.back(back.means_m, back.quaternions, back.sh)
        grad_means += losses.surface * surface_pull_gradient(own["means"], self._start_m, self._limits.surface_m)
        if rates.pose_rad > 0 and iteration >= self._pose_from:
            wrenches = self._posing.wrenches(own["means"], back.means_m, self._transforms)
            turn = self._motion.gradient(frame, *wrenches) + self._motion.smoothness_gradient(frame, losses.pose)
            self._motion.step(frame, turn, rates.pose_rad)
        gradients = {
            "means": grad_means,
            "quaternions": grad_quaternions,
            "scales": back.log_scales,
            "opacities": back.logit_opacities,
            "colour": grad_sh[:, :1],
            "harmonics": grad_sh[:, 1:],
        }
        if self._appearance is not None:
            self._appearance.step(grad_sh[:, :1], back.logit_opacities)
        self.adam.step(gradients, rates.at(iteration / self._iterations), back.screen > 0)
        # A needle at a joint or a wide, flat Gaussian over the chest fits four views and spoils the fifth.
        if self._additions.limit_scales:
            np.clip(own["scales"], *self._scale_range, out=own["scales"])
        if self._growing.densifies(iteration + 1, self._iterations):
            self._grow(iteration + 1, back.screen)
        return loss, crop_psnr_db(view.planes, self._crop)

    def _grow(self, done: int, screen: np.ndarray) -> None:
        """Add up the screen gradient (N,) in pixels; when due, clone, split and prune."""
        growing, seen = self._growing, screen > 0
        self._watched += np.where(seen, screen * self._crop.camera.wh[0] / 2, 0), seen
        if done % growing.every:
            return
        grown = grow(
            self.gaussians(),
            self._watched[0] / np.maximum(self._watched[1], 1),
            **self._growth(),
        )
        g = grown.gaussians
        self._own = {
            name: np.ascontiguousarray(value, self._own[name].dtype)
            for name, value in {
                "means": g.means_m,
                "quaternions": g.quaternions,
                "scales": g.log_scales,
                "opacities": g.logit_opacities,
                "colour": g.sh[:, :1],
                "harmonics": g.sh[:, 1:],
            }.items()
        }
        self.adam = self.adam.regrown(self._own, grown.parent, grown.fresh)
        self._descend(self.source[grown.parent])

    def _growth(self) -> dict[str, Any]:
        """How ``density.grow`` adds Gaussians to this person."""
        growing = self._growing
        return {
            "threshold": growing.gradient,
            "large_m": growing.scale * self._height_m,
            "prune_opacity": growing.prune_opacity,
            "cap": growing.cap,
            "rng": self._rng,
        }

    def _descend(self, source: np.ndarray) -> None:
        """Copy to new Gaussians all arrays of the ones that they descend from."""
        self.source, self._start_m = source, self._first_m[source]
        self._posing = (
            Posing(self._first.bones[source], self._first.weights[source])
            if self._grid is None
            else Posing(*all_bone_weights(self._grid, self._own["means"]))
        )
        self._watched = np.zeros((2, len(source)))
        if self._appearance is not None and self._seen is not None:
            self._appearance.seen = self._seen[source]

    def preview(self) -> Preview:
        """A preview of the middle crop, over grey."""
        crop = self._crops[len(self._crops) // 2]
        name, target = f"frame {crop.frame} of {crop.camera.name}", training_target(crop, GREY)
        return Preview(len(self._start_m), name, self._shown(crop), target.rgb, target.used)

    def snapshot(self) -> tuple[dict[str, Shaped[np.ndarray, " ..."]], dict[str, Any]]:
        """Gaussians, motion, temporal network, and Adam's state of each."""
        arrays, facts = {**self.adam.arrays(), **self._motion.arrays()}, {}
        arrays |= {"growth.source": self.source, "growth.watched": self._watched}
        if (appearance := self._appearance) is not None:
            facts, arrays = appearance.facts(), arrays | appearance.arrays()
        return arrays, facts

    def resume(self, arrays: dict[str, Shaped[np.ndarray, " ..."]], facts: dict[str, Any]) -> None:
        """Restore a ``snapshot``, in place."""
        if len(arrays["growth.source"]) != len(self.source) or (arrays["growth.source"] != self.source).any():
            source = arrays["growth.source"]
            self._own = {name: np.ascontiguousarray(value[source]) for name, value in self._own.items()}
            self.adam = self.adam.regrown(self._own, source, np.ones(len(source), bool))
            self._descend(source)
        self._watched[...] = arrays["growth.watched"]
        self.adam.resume(arrays)
        self._motion.resume(arrays)
        if self._appearance is not None:
            self._appearance.resume(arrays)
            self._appearance.resume_facts(facts)


def crop_psnr_db(planes: Float[np.ndarray, "5 h w"], crop: Crop) -> float:
    """PSNR of a crop, drawn as planes, on the person's own pixels; 0 when there are none."""
    squares, pixels = _squared_error(planes, crop.rgb, crop.verdict)
    return float(-10 * np.log10(max(squares / (3 * pixels), 1e-12))) if pixels else 0.0


@numba.njit(cache=True)
def _squared_error(planes, photo, verdict):
    total, pixels = 0.0, 0
    for y in range(verdict.shape[0]):
        for x in range(verdict.shape[1]):
            if verdict[y, x] == PERSON:
                pixels += 1
                for channel in range(3):
                    error = planes[channel, y, x] - np.float32(photo[y, x, channel]) / np.float32(255)
                    total += error * error
    return total, pixels
