# SPDX-License-Identifier: Apache-2.0
"""Bundle adjustment of cameras on points that several of them see, with a prior at the given poses and lenses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require
from studiorecon.geometry.rotations import cross_matrix, exp, log
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Num

_NEAR_M = 0.05
# Sigma of a lens parameter that is fixed: its column stays in the matrix and does not move.
_FIXED = 1e-9


@dataclass(frozen=True)
class BundleSettings:
    """How far poses may move: ``prior_deg`` and ``prior_m`` are sigmas of the given ones, the calibration's error."""

    iterations: int = 30
    prior_deg: float | Num[np.ndarray, " V"] = 0.3
    prior_m: float | Num[np.ndarray, " V"] = 0.03


@dataclass(frozen=True)
class LensPrior:
    """Sigmas, for all cameras or each, of the log focal length and of a radial term k1 that starts at 0."""

    log_focal: float | Num[np.ndarray, " V"]
    radial: float


@dataclass(frozen=True)
class BundleResult:
    """Result of the bundle adjustment.

    Attributes:
        cameras: with their new poses and focal lengths.
        radial: k1 on undistorted normalised coordinates, in addition to the distortion removed before.
        sigma: turn about camera axes (rad), centre (m), log focal length, radial term. Poses are relative to each other
            (the common rotation, translation and scale are removed); noise is the residuals' own.
    """

    cameras: list[Camera]
    points_m: Num[np.ndarray, "N 3"]
    radial: Num[np.ndarray, " V"]
    sigma: Num[np.ndarray, "V 8"]


@dataclass(frozen=True)
class _State:
    rotations: Num[np.ndarray, "V 3 3"]
    centres: Num[np.ndarray, "V 3"]
    lens: Num[np.ndarray, "V 2"]  # log of the focal length's factor, radial term
    points: Num[np.ndarray, "N 3"]


def adjust_with_lenses(
    cameras: Sequence[Camera],
    pixels: Num[np.ndarray, "V N 2"],
    weights: Num[np.ndarray, "V N"],
    points_m: Num[np.ndarray, "N 3"],
    huber_px: Num[np.ndarray, " V"],
    settings: BundleSettings,
    lens: LensPrior,
    given: Sequence[Camera] | None = None,
) -> BundleResult:
    """Cameras and points of least Huber cost of ``pixels``, with their uncertainty; ``weights``: 0 = not seen.

    Six numbers per camera, and one focal factor and one radial term where ``lens`` leaves them free; points are
    eliminated by their Schur complement, so a step costs O(N V²). The Huber norm is that of the two-dimensional
    residual (T11) with the delta ``huber_px``, so residuals are in error units and the priors count as one unit per
    standard deviation. 0.1 s for 400 points and 4 views. ``given``: the cameras that the priors refer to, lenses
    included, where the search starts from others. Pixels that are not finite are not seen. Raises ValueError that names
    the argument for other shapes, and for points that are seen and not finite.
    """
    problem = _Problem(cameras, pixels, weights, huber_px, settings, lens, given)
    state, _ = _solve(problem, points_m, settings.iterations)
    found = []
    for v, camera in enumerate(cameras):
        turned = move_camera(camera, state.rotations[v], state.centres[v])
        factor = np.where(np.diag([True, True, False]), np.exp(state.lens[v, 0]), 1.0)
        found.append(replace(turned, intrinsics=camera.intrinsics * factor))
    return BundleResult(found, state.points, state.lens[:, 1].copy(), problem.accuracy(state))


def move_camera(
    camera: Camera, rotation_camera_from_world: Num[np.ndarray, "3 3"], centre_m: Num[np.ndarray, " 3"]
) -> Camera:
    """The camera at another pose."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_camera_from_world, -rotation_camera_from_world @ centre_m
    return replace(camera, camera_from_world=pose)


def remove_drift(
    adjusted: Sequence[Camera], given: Sequence[Camera], weights: Sequence[float] | None = None
) -> tuple[list[Camera], tuple[Num[np.ndarray, "3 3"], Num[np.ndarray, " 3"], float]]:
    """The adjusted cameras without their common rotation, translation and scale against the given ones; that
    similarity.

    Cameras that were not adjusted (held-out ones) stay consistent with them. The rotation is fitted to centres and
    viewing axes together, which determines it for cameras in a line too. The similarity (rotation, translation, scale)
    maps adjusted world points to given ones: X' = scale · rotation · X + translation. ``weights``: positive; equal by
    default.
    """
    new, old = np.stack([c.centre_m for c in adjusted]), np.stack([c.centre_m for c in given])
    share = np.ones(len(new)) if weights is None else np.asarray(weights, np.float64)
    share = share / share.sum()
    new_middle, old_middle = share @ new, share @ old
    root = np.sqrt(share)[:, None]
    new_off, old_off = root * (new - new_middle), root * (old - old_middle)
    spread = max(float(np.sqrt((old_off**2).sum())), 1e-9) * root[..., None]
    axes = np.concatenate(spread * np.stack([c.camera_from_world[:3, :3] for c in adjusted]))
    old_axes = np.concatenate(spread * np.stack([c.camera_from_world[:3, :3] for c in given]))
    u, _, vt = np.linalg.svd(np.concatenate([old_off, old_axes]).T @ np.concatenate([new_off, axes]))
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    scale = float((old_off * (new_off @ rotation.T)).sum() / max((new_off**2).sum(), 1e-12)) if len(new) > 1 else 1.0
    translation = old_middle - scale * rotation @ new_middle
    back = [
        move_camera(c, c.camera_from_world[:3, :3] @ rotation.T, scale * rotation @ c.centre_m + translation)
        for c in adjusted
    ]
    return back, (rotation, translation, scale)


class _Problem:
    """The measurements and priors; immutable after construction."""

    def __init__(
        self,
        cameras: Sequence[Camera],
        pixels: Num[np.ndarray, "V N 2"],
        weights: Num[np.ndarray, "V N"],
        huber_px: Num[np.ndarray, " V"],
        settings: BundleSettings,
        lens: LensPrior,
        given: Sequence[Camera] | None = None,
    ) -> None:
        sizes = require("pixels", pixels, (len(cameras), "N", 2))
        require("weights", weights, (len(cameras), "N"), sizes)
        require("huber_px", huber_px, (len(cameras),), finite=True)
        self.rotations = np.stack([c.camera_from_world[:3, :3] for c in cameras])
        self.centres = np.stack([c.centre_m for c in cameras])
        self.given_rotations = np.stack([c.camera_from_world[:3, :3] for c in given or cameras])
        self.given_centres = np.stack([c.centre_m for c in given or cameras])
        longer = [np.log(g.focal_px[0] / c.focal_px[0]) for g, c in zip(given or cameras, cameras)]
        self.given_lens = np.stack([longer, np.zeros(len(longer))], axis=1)
        self.focal = np.stack([c.focal_px for c in cameras]) / huber_px[:, None]
        principal = np.stack([c.principal_px for c in cameras])
        self.seen = (weights > 0) & np.isfinite(pixels).all(-1)
        self.measured = (np.where(self.seen[..., None], pixels, principal[:, None]) - principal[:, None]) / huber_px[
            :, None, None
        ]
        self.weights = np.where(self.seen, weights, 0.0)
        columns = (
            [np.radians(settings.prior_deg)] * 3
            + [settings.prior_m] * 3
            + [np.maximum(lens.log_focal, _FIXED), lens.radial or _FIXED]
        )
        self.sigma = np.stack([np.broadcast_to(c, len(cameras)) for c in columns], axis=1)

    def start(self, points_m: Num[np.ndarray, "N 3"]) -> _State:
        require("points_m", points_m, (self.seen.shape[1], 3))
        require("points_m that are seen", np.asarray(points_m)[self.seen.any(0)], ("n", 3), finite=True)
        return _State(
            self.rotations.copy(),
            self.centres.copy(),
            np.zeros((len(self.centres), 2)),
            np.array(points_m, dtype=np.float64),
        )

    def prior(self, state: _State) -> Num[np.ndarray, "V 8"]:
        """Deviations from the given values."""
        turned = log(state.rotations @ np.swapaxes(self.given_rotations, 1, 2))
        return np.concatenate([turned, state.centres - self.given_centres, state.lens - self.given_lens], axis=1)

    def residuals(self, state: _State) -> tuple[Num[np.ndarray, "V N 3"], Num[np.ndarray, "V N 2"], float]:
        """Points in the cameras, errors in error units, and the cost: inf when a seen point is behind."""
        in_camera = np.einsum("vij,vnj->vni", state.rotations, state.points[None] - state.centres[:, None])
        if (self.seen & ~(in_camera[..., 2] > _NEAR_M)).any():
            return in_camera, np.zeros_like(self.measured), np.inf
        normal = in_camera[..., :2] / np.where(self.seen, in_camera[..., 2], 1.0)[..., None]
        normal = np.where(self.seen[..., None], normal, 0.0)
        bent = 1 + state.lens[:, None, 1:] * (normal**2).sum(-1, keepdims=True)
        factor = (self.focal * np.exp(state.lens[:, :1]))[:, None]
        error = np.where(self.seen[..., None], normal * bent * factor - self.measured, 0.0)
        norm = np.linalg.norm(error, axis=-1)
        cost = (self.weights * np.where(norm <= 1, norm**2, 2 * norm - 1)).sum()
        return in_camera, error, float(cost + ((self.prior(state) / self.sigma) ** 2).sum())

    def normal_equations(
        self, state: _State, in_camera: Num[np.ndarray, "V N 3"], error: Num[np.ndarray, "V N 2"]
    ) -> tuple[
        Num[np.ndarray, "V 8 8"],
        Num[np.ndarray, "V 8"],
        Num[np.ndarray, "N 3 3"],
        Num[np.ndarray, "N 3"],
        Num[np.ndarray, "V 8 3 N"],
    ]:
        """Camera blocks and sides, point blocks and sides, mixed blocks; priors included."""
        views, points = self.seen.shape
        robust = (self.weights / np.maximum(np.linalg.norm(error, axis=-1), 1.0))[:, None, None]
        x, y, depth = np.moveaxis(np.where(self.seen[..., None], in_camera, [0.0, 0.0, 1.0]), -1, 0)[:, :, None]
        normal = np.concatenate([x, y], axis=1) / depth  # (V, 2, N)
        squared = (normal**2).sum(1, keepdims=True)
        factor = (self.focal * np.exp(state.lens[:, :1]))[..., None]  # (V, 2, 1)
        radial = state.lens[:, 1:, None]
        bent = 1 + radial * squared
        # Arrays run over the points for every number of a derivative: small matrices, one product per point and camera,
        # would take longer to build than to multiply.
        rows = np.empty((views, 2, 3, points))
        rows[:, :, :2] = 2 * radial[..., None] * normal[:, :, None] * normal[:, None]
        rows[:, [0, 1], [0, 1]] += bent
        rows[:, :, 2] = -(bent + 2 * radial * squared) * normal
        rows *= (np.where(self.seen[:, None], 1 / depth, 0.0) * factor)[:, :, None]
        # y = exp(w) R (X - C): dy/dw = -[y]x, dy/dC = -R, dy/dX = R
        of_points = np.swapaxes(state.rotations, 1, 2)[:, None] @ rows
        of_cameras = np.empty((views, 8, 2, points))
        of_cameras[:, 0] = y * rows[:, :, 2] - depth * rows[:, :, 1]
        of_cameras[:, 1] = depth * rows[:, :, 0] - x * rows[:, :, 2]
        of_cameras[:, 2] = x * rows[:, :, 1] - y * rows[:, :, 0]
        of_cameras[:, 3:6] = -np.swapaxes(of_points, 1, 2)
        of_cameras[:, 6] = factor * bent * normal
        of_cameras[:, 7] = factor * squared * normal
        weighted = of_cameras * robust
        by_camera = weighted.reshape(views, 8, 2 * points)
        errors = np.ascontiguousarray(np.swapaxes(error, 1, 2))
        point_blocks, side = np.empty((points, 3, 3)), np.empty((points, 3))
        for i in range(3):
            own = of_points[:, :, i] * robust[:, 0]
            side[:, i] = (own * errors).sum((0, 1))
            for j in range(i, 3):
                point_blocks[:, i, j] = point_blocks[:, j, i] = (own * of_points[:, :, j]).sum((0, 1))
        mixed = weighted[:, :, 0, None] * of_points[:, None, 0]
        mixed += weighted[:, :, 1, None] * of_points[:, None, 1]
        return (
            by_camera @ of_cameras.reshape(views, 8, 2 * points).swapaxes(1, 2) + np.eye(8) / self.sigma[:, None] ** 2,
            (by_camera @ errors.reshape(views, 2 * points, 1))[..., 0] + self.prior(state) / self.sigma**2,
            point_blocks,
            side,
            mixed,
        )

    def accuracy(self, state: _State) -> Num[np.ndarray, "V 8"]:
        """Standard deviations without the common similarity."""
        in_camera, error, _ = self.residuals(state)
        blocks, _, point_blocks, _, mixed = self.normal_equations(state, in_camera, error)
        reduced = _schur_complement(blocks, _times(mixed, np.linalg.inv(point_blocks + 1e-9 * np.eye(3))), mixed)
        norm = np.linalg.norm(error, axis=-1)
        counted = (self.weights / np.maximum(norm, 1.0)).sum()
        variance = float((self.weights / np.maximum(norm, 1.0) * norm**2).sum() / max(2 * counted, 1e-9))
        # Scaled by likely sizes so that radians, metres and lens parameters share one inverse; fixed ones take no part.
        unit = np.tile(np.array([0.01] * 3 + [0.03] * 3 + [0.05, 0.05]), len(blocks))
        free = (self.sigma > _FIXED).reshape(-1)
        scaled = (reduced * unit[:, None] * unit[None])[np.ix_(free, free)]
        gauge, _ = np.linalg.qr((_gauge(state) / unit[:, None])[free])
        keep = np.eye(len(scaled)) - gauge @ gauge.T
        # The common similarity gets its own block, which the projection removes again.
        covariance = keep @ np.linalg.inv(keep @ scaled @ keep + gauge @ gauge.T) @ keep
        sigma = np.zeros(len(unit))
        sigma[free] = np.sqrt(np.maximum(np.diag(covariance) * variance, 0.0)) * unit[free]
        return sigma.reshape(len(blocks), 8)


def _gauge(state: _State) -> np.ndarray:
    """Derivatives of the cameras' parameters by a small common rotation, translation and scale of the world."""
    views = len(state.centres)
    columns = np.zeros((views, 8, 7))
    middle = state.centres - state.centres.mean(0)
    columns[:, :3, :3] = -state.rotations  # R exp(-w): a turn about the camera's own axes is -R w
    columns[:, 3:6, :3] = -cross_matrix(middle)
    columns[:, 3:6, 3:6] = np.eye(3)
    columns[:, 3:6, 6] = middle
    return columns.reshape(8 * views, 7)


def _times(mixed: np.ndarray, of_points: np.ndarray) -> np.ndarray:
    """(V, 8, 3, N) mixed blocks (V, 8, 3, N), each times its point's matrix (N, 3, 3)."""
    by_number = np.ascontiguousarray(np.moveaxis(of_points, 0, -1))
    product = mixed[:, :, 0, None] * by_number[0]
    for k in (1, 2):
        product += mixed[:, :, k, None] * by_number[k]
    return product


def _schur_complement(blocks: np.ndarray, divided: np.ndarray, mixed: np.ndarray) -> np.ndarray:
    """Normal matrix of the cameras only: Schur complement of the points, with mixed blocks ``divided`` by theirs."""
    views = len(blocks)
    system = np.zeros((views, 8, views, 8))
    for v in range(views):
        system[v, :, v] += blocks[v]
    return system.reshape(8 * views, 8 * views) - divided.reshape(8 * views, -1) @ mixed.reshape(8 * views, -1).T


def _solve(problem: _Problem, points_m: np.ndarray, iterations: int) -> tuple[_State, float]:
    """State and error after damped Gauss-Newton; steps that raise the cost or cross a camera plane are refused
    (T12)."""
    state, damping = problem.start(points_m), 1e-4
    in_camera, error, cost = problem.residuals(state)
    for _ in range(iterations):
        step_cameras, step_points = _step(problem.normal_equations(state, in_camera, error), damping)
        trial = _State(
            exp(step_cameras[:, :3]) @ state.rotations,
            state.centres + step_cameras[:, 3:6],
            state.lens + step_cameras[:, 6:],
            state.points + step_points,
        )
        new_in_camera, new_error, new_cost = problem.residuals(trial)
        if new_cost < cost:
            converged = cost - new_cost < 1e-7 * cost
            state, in_camera, error, cost = trial, new_in_camera, new_error, new_cost
            damping = max(damping / 5, 1e-9)
            if converged:
                break
        else:
            damping *= 10
            if damping > 1e6:
                break
    return state, cost


def _step(equations: tuple[np.ndarray, ...], damping: float) -> tuple[np.ndarray, np.ndarray]:
    """One damped step: (V, 8) of the cameras and (N, 3) of the points."""
    blocks, camera_side, point_blocks, point_side, mixed = equations
    views = len(blocks)
    blocks = blocks + damping * np.einsum("vii->vi", blocks)[:, None] * np.eye(8)
    point_blocks = point_blocks + (damping * np.trace(point_blocks, axis1=1, axis2=2) / 3 + 1e-9)[
        :, None, None
    ] * np.eye(3)
    inverse = np.linalg.inv(point_blocks)
    divided = _times(mixed, inverse)
    side = camera_side - divided.reshape(views, 8, -1) @ point_side.T.reshape(-1)
    # Columns of radians, metres and fixed numbers differ by 18 powers of ten: solved with a unit diagonal.
    system = _schur_complement(blocks, divided, mixed)
    unit = 1 / np.sqrt(np.maximum(np.diag(system), 1e-300))
    solved = np.linalg.solve(system * unit[:, None] * unit[None], side.reshape(-1) * unit) * unit
    step_cameras = -solved.reshape(views, 8)
    pull = step_cameras.reshape(-1) @ mixed.reshape(8 * views, -1)
    step_points = -(inverse @ (point_side + pull.reshape(3, -1).T)[..., None])[..., 0]
    return step_cameras, step_points
