# SPDX-License-Identifier: Apache-2.0
"""Compiles the training kernels of room and people while cameras and people are still being estimated.

That takes half a minute of one core on a new machine, and a minute of every core for gsplat's on a GPU. The trainings
run in parallel, and each would compile all of it separately. Where they are compiled already this takes some seconds
and changes nothing.
"""

from __future__ import annotations

import os

import numpy as np

from studiorecon.body.avatar.control_points import ControlPoints
from studiorecon.body.avatar.posing import Posing
from studiorecon.body.avatar.temporal import TemporalNetwork, with_residuals
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.signature import Written
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.device import Device, resolve
from studiorecon.splatting.train.optimiser import Adam
from studiorecon.splatting.train.schedule import TrainingSettings
from studiorecon.splatting.train.still import train_still
from studiorecon.splatting.train.targets import Target
from studiorecon.splatting.train.terms import L1AndSsim, PlaneView, Silhouette

_COUNT = 48
_NEAR_M = 0.1


def run(threads: int, device: str, kernels: Written) -> None:
    """Train a handful of Gaussians for two steps, as a room and as a person; write ``kernels`` when done."""
    place = resolve(device, "kernels are compiled")
    if place == "cuda":
        # torch would start a compiler per core of the machine, whatever the job has.
        os.environ.setdefault("MAX_JOBS", str(threads))
    _as_a_room(threads, place)
    # On a GPU people are drawn by the room's kernels, and the rest of their training is torch's.
    if place == "cpu":
        _as_a_person(threads)
    say("the training kernels are compiled")
    kernels.write_text("compiled\n", encoding="utf-8")


def _cloud(rng: np.random.Generator, degree: int = 1) -> Gaussians:
    """Gaussians a metre in front of the camera of ``_picture``."""
    means, quaternions = rng.normal([0, 0, 1], 0.1, (_COUNT, 3)), np.tile([1.0, 0, 0, 0], (_COUNT, 1))
    scales, sh = np.full((_COUNT, 3), -4.0), rng.normal(0, 0.1, (_COUNT, (degree + 1) ** 2, 3))
    return Gaussians(*(np.asarray(a, np.float32) for a in (means, quaternions, scales, np.zeros(_COUNT), sh)))


def _picture() -> Target:
    intrinsics = np.array([[40.0, 0, 20], [0, 40, 20], [0, 0, 1]])
    camera = Camera("kernels", (40, 40), intrinsics, np.eye(4))
    inside = np.zeros((40, 40), bool)
    inside[10:30, 10:30] = True
    return Target(camera, np.zeros((40, 40, 3), np.float32), np.ones((40, 40), np.float32), silhouette=inside)


def _as_a_room(threads: int, place: Device) -> None:
    rng, settings = np.random.default_rng(0), TrainingSettings(iterations=2, checkpoint_every_s=0.0)
    train_still(_cloud(rng), [_picture()], settings, rng, extent_m=1.0, threads=threads, device=place, label="kernels")


def _as_a_person(threads: int) -> None:
    rng, target = np.random.default_rng(0), _picture()
    own = _cloud(rng)
    seen = np.ones(_COUNT, bool)
    network = TemporalNetwork.start(
        own.means_m.min(axis=0), own.means_m.max(axis=0), 2, rng, 4, 8, ControlPoints.on(own.means_m, 8)
    )
    posing = Posing(np.zeros((_COUNT, 4), np.uint8), np.full((_COUNT, 4), np.float32(0.25)))
    transforms = np.tile(np.eye(4), (24, 1, 1))
    colour, logits = with_residuals(network, seen, own.means_m, own.sh[:, :1].copy(), own.logit_opacities, 0)
    sh = np.concatenate([colour, own.sh[:, 1:]], axis=1)
    means, quaternions, sh = posing.out(own.means_m, own.quaternions, sh, transforms)
    posed = Gaussians(means, quaternions, own.log_scales, logits, sh)
    rasteriser = Rasteriser(near_m=_NEAR_M, threads=threads)
    rasteriser.forward(posed, target.camera)
    planes = rasteriser.forward_planes(posed, target.camera)
    view = PlaneView(target, 0, rng, planes, np.zeros_like(planes))
    view.total([L1AndSsim(0.8, 0.2), Silhouette(0.1)])
    back = rasteriser.backward_planes(view.gradient)
    by_means, _, by_sh = posing.back(back.means_m, back.quaternions, back.sh)
    posing.wrenches(own.means_m, back.means_m, transforms)
    Adam({"network": network.flat}).step(
        {"network": network.gradient(by_sh[:, 0], back.logit_opacities)}, {"network": 0.0}
    )
    Adam({"means": means}).step({"means": by_means}, {"means": 0.0}, back.screen > 0)
