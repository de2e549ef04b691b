# SPDX-License-Identifier: Apache-2.0
"""Pieces of a training for tests: one step on a chosen target, the value and gradient of one term, training by tensors
without a GPU."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any
from unittest import mock

import numpy as np
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.train.blocked_set import BlockedSet
from studiorecon.splatting.train.schedule import TrainingSettings
from studiorecon.splatting.train.still import TrainedGaussians, train_still
from studiorecon.splatting.train.targets import Target
from studiorecon.splatting.train.terms import L1AndSsim, PlaneView, Term

from tests.made.gaussians import camera


def begun(initial: Gaussians, targets: Sequence[Target], settings: TrainingSettings, threads: int = 1) -> BlockedSet:
    """A training before its first step, in a world of one metre."""
    return BlockedSet(initial, targets, settings, np.random.default_rng(0), 1.0, threads)


def one_step(run: BlockedSet, terms: Sequence[Term], iteration: int, index: int) -> tuple[float, float]:
    """Loss and PSNR of a whole step on the target ``index``."""
    with run.threads():
        run.order.pending = [index]
        view = run.draw(iteration)
        return run.step(iteration, view, view.total(terms))


def plane_view(
    planes: np.ndarray, rgb: np.ndarray | None = None, weight: np.ndarray | None = None, **more: Any
) -> PlaneView:
    """Planes (5, H, W) beside a target; ``more`` are fields of the target."""
    hw = planes.shape[1:]
    target = Target(camera(hw[1], hw[0]), np.zeros((*hw, 3), np.float32) if rgb is None else rgb, weight, **more)
    gradient = np.zeros(planes.shape, np.float32)
    return PlaneView(target, 0, np.random.default_rng(0), np.ascontiguousarray(planes), gradient)


def of_term(term: Term, view: PlaneView) -> tuple[float, np.ndarray]:
    """Its value and its gradient (5, H, W)."""
    return term.on_cpu(view), view.gradient


def photometric(
    rendered_rgb: np.ndarray, target_rgb: np.ndarray, weight: np.ndarray | None, l1: float, ssim: float
) -> tuple[float, np.ndarray]:
    """L1 and SSIM of a pair of images, and the gradient (H, W, 3)."""
    planes = np.zeros((5, *rendered_rgb.shape[:2]), np.float32)
    planes[:3] = rendered_rgb.transpose(2, 0, 1)
    value, gradient = of_term(L1AndSsim(l1, ssim), plane_view(planes, target_rgb, weight))
    return value, np.ascontiguousarray(gradient[:3].transpose(1, 2, 0))


def of_alpha(term: Term, alpha: np.ndarray, weight: np.ndarray | None) -> tuple[float, np.ndarray]:
    """Value of a term on alpha (H, W), and its gradient (H, W)."""
    planes = np.zeros((5, *alpha.shape), np.float32)
    planes[4] = 1 - alpha
    value, gradient = of_term(term, plane_view(planes, weight=weight))
    return value, gradient[4]


def train_on_tensors(*arguments: Any, **named: Any) -> TrainedGaussians:
    """``train_still`` on the CUDA path, with float64 autograd on the CPU in gsplat's place."""
    from studiorecon.splatting.cuda import tensor_set

    from tests.made.gsplat_stand_in import rasterization

    here = functools.partial(tensor_set.TensorSet, place="cpu", function=rasterization)
    with mock.patch.object(tensor_set, "TensorSet", here):
        return train_still(*arguments, **named, device="cuda")
