# SPDX-License-Identifier: Apache-2.0
"""``PersonInTraining`` on a CUDA device: posing, temporal network, loss and Adam are tensors, gsplat draws.

Crops, draw order, terms, rates and density control are the same, so it learns the same to rounding. A crop goes to the
device at every step and nothing comes back: losses are read at every tenth of the way.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from kornia.geometry.liegroup import So3

from studiorecon.body.avatar import tensor_posing as posing
from studiorecon.body.avatar.weight_grid import WeightGrid
from studiorecon.humans.crops import Crop
from studiorecon.humans.refined_motion import FIRST_DECAY, SECOND_DECAY, RefinedMotion
from studiorecon.humans.training import GREY, PersonInTraining, training_target
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.cuda.adam import Adam
from studiorecon.splatting.cuda.rasterise import FIELDS, DeviceView, Rasterization, draw_view, gsplat_function
from studiorecon.splatting.train.density import grow
from studiorecon.splatting.train.terms import TensorView

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from jaxtyping import Float, Integer, Shaped


class TensorPerson(PersonInTraining):
    """A person for ``splatting.train.trainer.train``; ``finish`` brings motion and temporal network back.

    ``place`` and ``function`` (instead of gsplat's) let it run without a GPU.
    """

    def __init__(
        self, *arguments: Any, place: str = "cuda", function: Rasterization | None = None, **named: Any
    ) -> None:
        super().__init__(*arguments, **named)
        self._place, self._function = place, function or gsplat_function()
        start = super().gaussians()
        self._put({name: getattr(start, name) for name in FIELDS})
        self.device_adam = Adam(self.leaves, 0.0)
        self._moving = _Motion(self._motion, place)
        self._skinning = None if self._grid is None else _Grid(self._grid, place)
        if self._appearance is not None:
            self._network = {"flat": torch.tensor(self._appearance.network.flat, device=place, requires_grad=True)}
            self._network_adam = Adam(self._network, 0.0)
        self._descend(self.source)

    @property
    def refused(self) -> int:
        """Gradient entries so far that were not finite."""
        return int(self.device_adam.refused)

    def gaussians(self) -> Gaussians:
        """The current canonical Gaussians."""
        return Gaussians(*(self.leaves[name].detach().cpu().numpy() for name in FIELDS))

    @property
    def bones(self) -> Integer[np.ndarray, "N K"]:
        """The joints that carry each Gaussian."""
        if self._grid is None:
            return self._first.bones[self.source]
        return np.tile(np.arange(self._grid.weights.shape[3], dtype=np.uint8), (len(self.source), 1))

    @property
    def weights(self) -> Float[np.ndarray, "N K"]:
        """Skinning weights at the Gaussians' current positions."""
        return self._first.weights[self.source] if self._grid is None else self._grid.query(self.gaussians().means_m)

    def threads(self) -> AbstractContextManager[Any]:
        """A context with float32 whatever the caller's autocast; the CPU's threads do not draw."""
        return torch.autocast(torch.device(self._place).type, enabled=False)

    def begin(self, iteration: int) -> None:
        """Start the temporal network, or not, once the person can be measured."""
        if self._appearance is not None and iteration == self._appearance.settings.start:
            self.finish()
        super().begin(iteration)

    def finish(self) -> None:
        """Copy motion and temporal network to where the person's files are written from."""
        self._moving.copy_to(self._motion)
        if self._appearance is not None:
            self._appearance.network.flat[...] = self._network["flat"].detach().cpu().numpy()

    def draw(self, iteration: int) -> TensorView:  # type: ignore[override]
        """The view of a crop, posed and rendered over a random colour, or black."""
        crop, behind = self._next_crop()
        target = training_target(crop, behind)
        self._turn = self._moving.no_turn()
        self._turn.requires_grad_(self._rates.pose_rad > 0 and iteration >= self._pose_from)
        self._drawn = drawn = self._view(crop, behind)
        assert target.weight is not None
        rgb, weight = (torch.as_tensor(array, device=self._place) for array in (target.rgb, target.weight))
        return TensorView(target, iteration, self._rng, drawn.rgb, drawn.alpha, rgb.permute(2, 0, 1), weight, None)

    def _view(self, crop: Crop, behind: np.ndarray) -> DeviceView:
        background = torch.tensor(behind, dtype=torch.float32, device=self._place)
        posed = self._posed_leaves(crop.frame)
        degree = int(np.sqrt(posed["sh"].shape[1])) - 1
        return draw_view(
            posed, crop.camera, background, self._near_m, degree=degree, antialias=False, function=self._function
        )

    def _posed_leaves(self, frame: int) -> dict[str, torch.Tensor]:
        own = self.leaves
        sh, logits = own["sh"], own["logit_opacities"]
        if self._appearance is not None and (network := self._appearance.active_network) is not None:
            control, flat = network.control, self._network["flat"]
            if control is None:
                found = posing.residuals(network, flat, own["means_m"][self._seen_rows], frame)
            else:
                points, near, shares = self._control
                found = (posing.residuals(network, flat, points, frame)[near] * shares[..., None]).sum(1)
            more = torch.zeros((len(sh), 4), device=self._place).index_copy(0, self._seen_rows, found)
            sh, logits = torch.cat([sh[:, :1] + more[:, None, :3], sh[:, 1:]], dim=1), logits + more[:, 3]
        weights = self._fixed if self._skinning is None else self._skinning.query(own["means_m"].detach())
        transforms = self._moving.transforms(frame, self._turn)
        means, quaternions, sh = posing.pose_gaussians(weights, transforms, own["means_m"], own["quaternions"], sh)
        return own | {"means_m": means, "quaternions": quaternions, "sh": sh, "logit_opacities": logits}

    def _shown(self, crop: Crop) -> np.ndarray:
        with torch.no_grad():
            self._turn = self._moving.no_turn()
            return self._view(crop, GREY).rgb.cpu().numpy()

    def step(self, iteration: int, view: TensorView, loss: torch.Tensor) -> tuple[Any, Any]:  # type: ignore[override]
        """Move pose, temporal network and Gaussians by autograd; returns loss and PSNR as tensors."""
        drawn, rates, own = self._drawn, self._rates.at(iteration / self._iterations), self.leaves
        for leaf in own.values():
            leaf.grad = None
        loss.backward()
        with torch.no_grad():
            assert own["means_m"].grad is not None
            screen = torch.zeros(len(own["means_m"]), device=self._place)
            if drawn.centres.grad is not None:
                screen = drawn.centres.grad[0].norm(dim=1).to(screen)
            pull = 2 * self._losses.surface / (self._limits.surface_m**2 * len(screen))
            own["means_m"].grad += pull * (own["means_m"] - self._start)
            if self._turn.grad is not None:
                self._moving.step(self._crop.frame, self._turn.grad, self._losses.pose, self._rates.pose_rad)
            by_field = dict(zip(FIELDS, (rates[n] for n in ("means", "quaternions", "scales", "opacities", "colour"))))
            self.device_adam.step(own, by_field, rates["harmonics"], own["sh"].shape[1], screen > 0)
            if self._appearance is not None and self._network["flat"].grad is not None:
                every = torch.ones(1, dtype=torch.bool, device=self._place)
                self._network_adam.step(self._network, {"flat": self._appearance.settings.rate}, 0.0, 0, every)
                self._network["flat"].grad = None
            if self._additions.limit_scales:
                own["log_scales"].clamp_(*map(float, self._scale_range))
            if self._growing.densifies(iteration + 1, self._iterations):
                self._grow_on_device(iteration + 1, screen)
            return loss.detach(), self._psnr_db(view)

    def _psnr_db(self, view: TensorView) -> torch.Tensor:
        """PSNR on the person's own pixels; 0 when there are none."""
        person = torch.as_tensor(view.target.silhouette, device=self._place)
        error = torch.where(person, (view.rgb.permute(2, 0, 1) - view.wanted_rgb).square(), 0.0).sum()
        pixels = person.sum()
        return torch.where(pixels > 0, -10 * torch.log10((error / (3 * pixels.clamp_min(1))).clamp_min(1e-12)), 0.0)

    def _grow_on_device(self, done: int, screen: torch.Tensor) -> None:
        """Add up the screen gradient; when due, clone, split and prune on the CPU."""
        growing = self._growing
        self._screen[0] += screen * (self._crop.camera.wh[0] / 2)
        self._screen[1] += screen > 0
        if done % growing.every:
            return
        mean = (self._screen[0] / self._screen[1].clamp_min(1)).cpu().numpy()
        grown = grow(self.gaussians(), mean, **self._growth())
        self._put({name: getattr(grown.gaussians, name) for name in FIELDS})
        self.device_adam.regrow(grown.parent, grown.fresh)
        self._descend(self.source[grown.parent])

    def _descend(self, source: Integer[np.ndarray, " N"]) -> None:
        """Copy to Gaussians all arrays of the ones that they descend from."""
        self.source, self._start_m = source, self._first_m[source]
        self._start = torch.as_tensor(self._start_m, device=self._place)
        self._screen = torch.zeros((2, len(source)), device=self._place)
        if self._grid is None:
            joints = len(self._motion.parents)
            dense = np.zeros((len(source), joints), np.float32)
            np.add.at(dense, (np.arange(len(source))[:, None], self._first.bones[source]), self._first.weights[source])
            self._fixed = torch.as_tensor(dense, device=self._place)
        if (appearance := self._appearance) is not None and self._seen is not None:
            appearance.seen = self._seen[source]
            self._seen_rows = torch.as_tensor(np.flatnonzero(appearance.seen), device=self._place)
            if (control := appearance.network.control) is not None:
                parts = control.points_m, control.near.astype(np.int64), control.shares
                self._control = [torch.as_tensor(part, device=self._place) for part in parts]

    def _put(self, arrays: Mapping[str, np.ndarray]) -> None:
        self.leaves = {
            name: torch.tensor(np.asarray(array, np.float32), device=self._place, requires_grad=True)
            for name, array in arrays.items()
        }

    def snapshot(self) -> tuple[dict[str, Shaped[np.ndarray, " ..."]], dict[str, Any]]:
        """Gaussians, motion, temporal network, and Adam's state of each."""
        parts: dict[str, Mapping[str, Any]] = {
            "leaf": self.leaves,
            "adam": self.device_adam.arrays(),
            "motion": self._moving.state,
            "growth": {"source": self.source, "screen": self._screen},
        }
        facts: dict[str, Any] = {"turned": self._moving.turned}
        if (appearance := self._appearance) is not None:
            parts |= {"network": self._network, "network_adam": self._network_adam.arrays()}
            facts |= appearance.facts()
        arrays = {
            f"{part}.{name}": value.detach().cpu().numpy() if isinstance(value, torch.Tensor) else value
            for part, values in parts.items()
            for name, value in values.items()
        }
        return arrays, facts

    def resume(self, arrays: dict[str, Shaped[np.ndarray, " ..."]], facts: dict[str, Any]) -> None:
        """Restore a ``snapshot``."""

        def part(name: str) -> dict[str, np.ndarray]:
            return {key.removeprefix(f"{name}."): a for key, a in arrays.items() if key.startswith(f"{name}.")}

        self._put(part("leaf"))
        self.device_adam.resume(part("adam"))
        self._descend(arrays["growth.source"])
        self._screen.copy_(torch.as_tensor(arrays["growth.screen"]))
        for name, value in part("motion").items():
            self._moving.state[name].copy_(torch.as_tensor(value))
        self._moving.turned = list(facts["turned"])
        if self._appearance is not None:
            self._network["flat"].data.copy_(torch.as_tensor(arrays["network.flat"]))
            self._network_adam.resume(part("network_adam"))
            self._appearance.resume_facts(facts)


class _Motion:
    """``RefinedMotion`` on the device: rotations, positions and Adam's moments of every frame.

    ``turned`` counts the steps of every frame.
    """

    def __init__(self, motion: RefinedMotion, place: str) -> None:
        def tensor(array: np.ndarray) -> torch.Tensor:
            return torch.tensor(np.asarray(array, np.float64), device=place)

        frames = len(motion.local)
        moments = torch.zeros((2, frames, len(motion.parents) + 1, 3), dtype=torch.float64, device=place)
        self.state = {"local": tensor(motion.local), "root_m": tensor(motion.trans_m), "moments": moments}
        self.turned = [0] * frames
        self._tree = posing.JointTree(motion.parents, tensor(motion.rest_joints_m))
        free = np.ones((len(motion.parents) + 1, 1))
        free[motion.held] = 0
        self._free = tensor(free)

    def copy_to(self, motion: RefinedMotion) -> None:
        """Put rotations and positions into ``motion``."""
        motion.local[...], motion.trans_m[...] = (self.state[name].cpu().numpy() for name in ("local", "root_m"))

    def no_turn(self) -> torch.Tensor:
        """(J + 1, 3) zeros, which receive the gradient by turns of joints and the shift of the pelvis."""
        return torch.zeros(self.state["moments"].shape[2:], dtype=torch.float64, device=self._free.device)

    def transforms(self, frame: int, turn: torch.Tensor) -> torch.Tensor:
        """World_from_rest (J, 3, 4) of a frame, whose joints ``turn`` moves."""
        local = self.state["local"][frame]
        local = local + So3.hat(turn[:-1]) @ local
        return self._tree.world_from_rest(local, self.state["root_m"][frame] + turn[-1]).float()

    def step(self, frame: int, gradient: torch.Tensor, smooth: float, rate: float) -> None:
        """Adam's step of one frame along ``gradient`` and that of smoothness, as in ``RefinedMotion``."""
        local, root_m = self.state["local"], self.state["root_m"]
        gradient = gradient.nan_to_num(0.0, 0.0, 0.0)
        for other in (frame - 1, frame + 1):
            if 0 <= other < len(local):
                turn = So3.from_matrix(local[frame] @ local[other].mT).log() / len(self._free[1:])
                gradient = gradient + 2 * smooth * torch.cat([turn, (root_m[frame] - root_m[other])[None]])
        gradient = gradient * self._free
        first, second = self.state["moments"][:, frame]
        first.lerp_(gradient, 1 - FIRST_DECAY)
        second.lerp_(gradient.square(), 1 - SECOND_DECAY)
        self.turned[frame] += 1
        count = self.turned[frame]
        deviation = (second / (1 - SECOND_DECAY**count)).sqrt() + 1e-12
        change = -rate * first / (1 - FIRST_DECAY**count) / deviation
        # One iteration takes off what rounding adds.
        local[frame] = posing.polar(So3.exp(change[:-1]).matrix() @ local[frame], steps=1)
        root_m[frame] += change[-1]


class _Grid:
    """``WeightGrid`` on the device."""

    def __init__(self, grid: WeightGrid, place: str) -> None:
        # (1, bones, z, y, x), as grid_sample has it.
        self._weights = torch.as_tensor(grid.weights, device=place).permute(3, 2, 1, 0)[None].contiguous()
        self._origin_m = torch.as_tensor(np.asarray(grid.origin_m, np.float32), device=place)
        self._half_m = grid.spacing_m * (grid.weights.shape[0] - 1) / 2

    def query(self, points_m: torch.Tensor) -> torch.Tensor:
        """Trilinear weights (N, B), rows summing to 1."""
        at = (points_m - self._origin_m) / self._half_m - 1
        found = torch.nn.functional.grid_sample(
            self._weights, at[None, None, None], mode="bilinear", padding_mode="border", align_corners=True
        )[0, :, 0, 0].T
        return found / found.sum(1, keepdim=True)
