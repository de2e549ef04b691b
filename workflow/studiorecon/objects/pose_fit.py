# SPDX-License-Identifier: Apache-2.0
"""The pose of an object of known shape at one moment: its Gaussians are fitted to all cameras' crops.

Colours and outlines are compared at once: the picture on black, and its coverage. Each camera's crop is drawn seven
times a step, at the pose and with its six degrees of freedom varied. The steps are Levenberg-Marquardt's, first on
blurred pictures, which converge from further away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.footage.video import to_float
from studiorecon.geometry import rotations
from studiorecon.objects.residual import LOOSE, UNKNOWN
from studiorecon.objects.rigid import NEAR_M
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.cpu.rasterise import Rasteriser

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

# Difference beyond which the cost is linear; sigma of one pixel's difference, large because shapes are not exact and
# neighbours err together.
_HUBER, _NOISE = 0.25, 0.4
# Step of the derivatives, radians, and metres per metre of reach; convergence threshold, radians.
_STEP_RAD, _STEP_SHARE, _ENOUGH_RAD = 0.02, 0.03, 2e-3
_DAMPING = (1e-2, 1e3)


@dataclass(frozen=True)
class ObjectObservation:
    """One camera's observation of an object: the crop's ``camera``, ``rgb`` on black, ``mask`` and ``weight``."""

    camera: Camera
    rgb: Float[np.ndarray, "h w 3"]
    mask: Num[np.ndarray, "h w"]
    weight: Float[np.ndarray, "h w"]


def observe_crop(
    camera: Camera, rgb: Integer[np.ndarray, "h w 3"], state: Integer[np.ndarray, "h w"]
) -> ObjectObservation:
    """The observation of a crop's camera; ``state`` as in ``ResidualRegion``; occluded pixels have weight 0."""
    mask = (state == LOOSE).astype(np.float32)
    return ObjectObservation(camera, to_float(rgb) * mask[..., None], mask, (state != UNKNOWN).astype(np.float32))


@dataclass(frozen=True)
class Prior:
    """Prior of a pose: near ``world_from_thing`` (4, 4) within deviations in radians and metres."""

    world_from_thing: Float[np.ndarray, "4 4"]
    turn_rad: float
    place_m: float

    def residuals(self, pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, " 6"]:
        """Differences of a pose from the prior, in deviations."""
        turn = rotations.log(self.world_from_thing[:3, :3].T @ pose[:3, :3])
        return np.concatenate([turn / self.turn_rad, (pose[:3, 3] - self.world_from_thing[:3, 3]) / self.place_m])


def move_pose(pose: Float[np.ndarray, "4 4"], step: Float[np.ndarray, " 6"]) -> Float[np.ndarray, "4 4"]:
    """A pose turned about its own middle by ``step[:3]``, radians, and shifted by ``step[3:]``, metres, in its own
    axes."""
    new = pose.copy()
    new[:3, :3] = pose[:3, :3] @ rotations.exp(step[:3])
    new[:3, 3] += step[3:]
    return new


class Fitter:
    """One object's Gaussians, rendered over observations; ``reach_m`` is their extent from the middle."""

    def __init__(self, gaussians: Gaussians, reach_m: float, threads: int) -> None:
        self._gaussians, self.reach_m = gaussians, reach_m
        self._rasteriser = Rasteriser(near_m=NEAR_M, threads=threads)

    def misfit(self, pose: Float[np.ndarray, "4 4"], observations: Sequence[ObjectObservation]) -> tuple[float, float]:
        """Sum of the squared differences in the crops at a pose, and the number of the object's pixels."""
        squares = sum(float(np.square(self._difference(pose, g, 0.0)).sum()) for g in observations)
        return squares, float(sum((g.mask * g.weight).sum() for g in observations))

    def fit(
        self,
        pose: Float[np.ndarray, "4 4"],
        observations: Sequence[ObjectObservation],
        prior: Prior,
        blurs_px: Sequence[float],
        steps: int,
    ) -> Float[np.ndarray, "4 4"]:
        """The pose near ``pose`` that best explains the observations and the prior."""
        for blur_px in blurs_px:
            pose = self._descended(pose, observations, prior, blur_px, steps)
        return pose

    def cost(
        self, pose: Float[np.ndarray, "4 4"], observations: Sequence[ObjectObservation], prior: Prior, blur_px: float
    ) -> float:
        """The cost that ``fit`` minimises."""
        return _cost(self._residuals(pose, observations, blur_px)) + float(np.square(prior.residuals(pose)).sum())

    def _descended(
        self, pose: np.ndarray, observations: Sequence[ObjectObservation], prior: Prior, blur_px: float, steps: int
    ) -> np.ndarray:
        lengths = np.array([_STEP_RAD] * 3 + [_STEP_SHARE * self.reach_m] * 3)
        damping, residual = _DAMPING[0], self._residuals(pose, observations, blur_px)
        expected = prior.residuals(pose)
        cost = _cost(residual) + float(expected @ expected)
        for _ in range(steps):
            varied = [move_pose(pose, lengths * unit) for unit in np.eye(6)]
            slope = np.stack(
                [(self._residuals(v, observations, blur_px) - residual) / h for v, h in zip(varied, lengths)], axis=1
            )
            pull = np.stack([(prior.residuals(v) - expected) / h for v, h in zip(varied, lengths)], axis=1)
            robust = np.minimum(1.0, _HUBER / _NOISE / np.maximum(np.abs(residual), 1e-9))
            normal = slope.T @ (robust[:, None] * slope) + pull.T @ pull
            gradient = slope.T @ (robust * residual) + pull.T @ expected
            while damping < _DAMPING[1]:
                step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)), gradient)
                step[:3] *= min(1.0, 0.5 / max(float(np.linalg.norm(step[:3])), 1e-12))
                new = move_pose(pose, step)
                new_residual, new_expected = self._residuals(new, observations, blur_px), prior.residuals(new)
                new_cost = _cost(new_residual) + float(new_expected @ new_expected)
                if new_cost < cost:
                    break
                damping *= 10
            else:
                return pose
            small = np.linalg.norm(step[:3]) < _ENOUGH_RAD and np.linalg.norm(step[3:]) < _ENOUGH_RAD * self.reach_m
            pose, residual, expected, cost = new, new_residual, new_expected, new_cost
            damping = max(damping / 10, 1e-4)
            if small:
                break
        return pose

    def _residuals(self, pose: np.ndarray, observations: Sequence[ObjectObservation], blur_px: float) -> np.ndarray:
        return (
            np.concatenate([self._difference(pose, g, blur_px).ravel() for g in observations]).astype(np.float64)
            / _NOISE
        )

    def _difference(self, pose: np.ndarray, seen: ObjectObservation, blur_px: float) -> np.ndarray:
        """(h, w, 4) weighted differences of colours on black and of coverage."""
        camera = Camera(seen.camera.name, seen.camera.wh, seen.camera.intrinsics, seen.camera.camera_from_world @ pose)
        drawn = self._rasteriser.forward(self._gaussians, camera)
        off = (
            np.concatenate([drawn.rgb - seen.rgb, (drawn.alpha - seen.mask)[..., None]], axis=-1)
            * seen.weight[..., None]
        )
        return cv2.GaussianBlur(off, (0, 0), blur_px) if blur_px > 0 else off


def _cost(residual: np.ndarray) -> float:
    """Huber's cost, in the residuals' own unit."""
    size, edge = np.abs(residual), _HUBER / _NOISE
    return float(np.where(size <= edge, size**2, edge * (2 * size - edge)).sum())
