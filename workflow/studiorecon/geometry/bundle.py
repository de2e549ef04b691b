# SPDX-License-Identifier: Apache-2.0
"""Bundle adjustment of camera poses on points that several cameras see, with a prior at the given poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from studiorecon.geometry.rotations import cross_matrix, exp, log
from studiorecon.scene.camera import Camera

_NEAR_M = 0.05


@dataclass(frozen=True)
class BundleSettings:
    """How far poses may move.

    Attributes:
        iterations: Levenberg-Marquardt steps.
        prior_deg, prior_m: standard deviations of the given rotations and centres. They hold what the points cannot see:
            the common rotation, translation and scale.
    """

    iterations: int
    prior_deg: float
    prior_m: float


def adjust(
    cameras: Sequence[Camera], pixels: np.ndarray, weights: np.ndarray, points_m: np.ndarray, huber_px: np.ndarray, settings: BundleSettings
) -> tuple[list[Camera], np.ndarray]:
    """Cameras and points (N, 3) that lower the Huber cost of ``pixels`` (V, N, 2); ``weights`` (V, N), 0 = not seen.

    Six numbers per camera; points are eliminated by their Schur complement, so a step costs O(N V²). The Huber norm is that of
    the two-dimensional residual (T11) with the delta ``huber_px`` (V,), so residuals are in error units and the priors
    count as one unit per standard deviation. Intrinsics stay. 0.1 s for 400 points and 4 views.
    """
    rotations = np.stack([c.camera_from_world[:3, :3] for c in cameras])
    centres = np.stack([c.centre_m for c in cameras])
    focal, principal = np.stack([c.focal_px for c in cameras]), np.stack([c.principal_px for c in cameras])
    given_rotations, given_centres, points = rotations.copy(), centres.copy(), np.array(points_m, dtype=np.float64)
    seen = (weights > 0) & np.isfinite(pixels).all(-1)
    measured = np.where(seen[..., None], pixels, 0.0)
    weights = np.where(seen, weights, 0.0)
    sigma = np.array([np.radians(settings.prior_deg)] * 3 + [settings.prior_m] * 3)

    def residuals(r: np.ndarray, c: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        in_camera = np.einsum("vij,vnj->vni", r, x[None] - c[:, None])
        depth = np.where(in_camera[..., 2] > _NEAR_M, in_camera[..., 2], np.nan)
        ahead = seen & np.isfinite(depth)
        if (seen & ~ahead).any():
            return in_camera, np.zeros_like(measured), ahead, np.inf
        depth = np.where(ahead, depth, 1.0)
        error = (in_camera[..., :2] / depth[..., None] * focal[:, None] + principal[:, None] - measured) / huber_px[:, None, None]
        error = np.where(ahead[..., None], error, 0.0)
        norm = np.linalg.norm(error, axis=-1)
        cost = (weights * np.where(norm <= 1, norm**2, 2 * norm - 1)).sum()
        prior = np.concatenate([log(r @ np.swapaxes(given_rotations, 1, 2)), c - given_centres], axis=1) / sigma
        return in_camera, error, ahead, float(cost + (prior**2).sum())

    damping = 1e-4
    in_camera, error, ahead, cost = residuals(rotations, centres, points)
    for _ in range(settings.iterations):
        poses = (rotations, centres, given_rotations, given_centres)
        step_cameras, step_points = _step(poses, (in_camera, error, ahead), weights, focal / huber_px[:, None], sigma, damping)
        new_rotations = exp(step_cameras[:, :3]) @ rotations
        new_centres, new_points = centres + step_cameras[:, 3:], points + step_points
        new_in_camera, new_error, new_ahead, new_cost = residuals(new_rotations, new_centres, new_points)
        if new_cost < cost:
            converged = cost - new_cost < 1e-7 * cost
            rotations, centres, points = new_rotations, new_centres, new_points
            in_camera, error, ahead, cost = new_in_camera, new_error, new_ahead, new_cost
            damping = max(damping / 5, 1e-9)
            if converged:
                break
        else:
            damping *= 10
            if damping > 1e6:
                break
    return [moved(camera, rotations[v], centres[v]) for v, camera in enumerate(cameras)], points


def moved(camera: Camera, rotation_camera_from_world: np.ndarray, centre_m: np.ndarray) -> Camera:
    """The camera at another place."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_camera_from_world, -rotation_camera_from_world @ centre_m
    return replace(camera, camera_from_world=pose)


def without_drift(adjusted: Sequence[Camera], given: Sequence[Camera]) -> tuple[list[Camera], tuple[np.ndarray, np.ndarray, float]]:
    """The adjusted cameras without their common rotation, translation and scale against the given ones, and that similarity.

    Cameras that were not adjusted (held-out ones) stay consistent with them. The rotation is fitted to centres and viewing
    axes together, which also holds two cameras, or cameras in a line. The similarity (rotation, translation, scale) takes
    adjusted world points to given ones: X' = scale · rotation · X + translation.
    """
    new, old = np.stack([c.centre_m for c in adjusted]), np.stack([c.centre_m for c in given])
    new_off, old_off = new - new.mean(0), old - old.mean(0)
    spread = max(float(np.sqrt((old_off**2).sum(-1).mean())), 1e-9)
    axes = np.concatenate([c.camera_from_world[:3, :3] for c in adjusted]) * spread
    old_axes = np.concatenate([c.camera_from_world[:3, :3] for c in given]) * spread
    u, _, vt = np.linalg.svd(np.concatenate([old_off, old_axes]).T @ np.concatenate([new_off, axes]))
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    scale = float((old_off * (new_off @ rotation.T)).sum() / max((new_off**2).sum(), 1e-12)) if len(new) > 1 else 1.0
    translation = old.mean(0) - scale * rotation @ new.mean(0)
    back = [moved(c, c.camera_from_world[:3, :3] @ rotation.T, scale * rotation @ c.centre_m + translation) for c in adjusted]
    return back, (rotation, translation, scale)


def _step(
    poses: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    state: tuple[np.ndarray, np.ndarray, np.ndarray],
    weights: np.ndarray,
    focal: np.ndarray,
    sigma: np.ndarray,
    damping: float,
) -> tuple[np.ndarray, np.ndarray]:
    """One damped normal-equation step: (V, 6) turn about camera axes and centre shift, and (N, 3) point shifts."""
    rotations, centres, given_rotations, given_centres = poses
    in_camera, error, ahead = state
    views, count = ahead.shape
    norm = np.linalg.norm(error, axis=-1)
    robust = np.where(ahead, weights / np.maximum(norm, 1.0), 0.0)
    depth = np.where(ahead, in_camera[..., 2], 1.0)
    flat = np.where(ahead[..., None], in_camera, 0.0)
    rows = np.zeros((views, count, 2, 3))
    scaled = focal[:, None] / depth[..., None]
    rows[..., 0, 0], rows[..., 1, 1] = scaled[..., 0], scaled[..., 1]
    rows[..., 2] = -flat[..., :2] * scaled / depth[..., None]
    rows = np.where(ahead[..., None, None], rows, 0.0)
    # y = exp(w) R (X - C): dy/dw = -[y]x, dy/dC = -R, dy/dX = R
    of_points = rows @ rotations[:, None]
    of_cameras = np.concatenate([-rows @ cross_matrix(flat), -of_points], axis=-1)
    weighted = of_cameras * robust[..., None, None]
    camera_blocks = np.einsum("vnki,vnkj->vij", weighted, of_cameras)
    camera_side = np.einsum("vnki,vnk->vi", weighted, error)
    weighted_points = of_points * robust[..., None, None]
    point_blocks = np.einsum("vnki,vnkj->nij", weighted_points, of_points)
    point_side = np.einsum("vnki,vnk->ni", weighted_points, error)
    mixed = np.einsum("vnki,vnkj->vnij", weighted, of_points)
    prior = np.concatenate([log(rotations @ np.swapaxes(given_rotations, 1, 2)), centres - given_centres], axis=1)
    camera_blocks += np.diag(1 / sigma**2)
    camera_side += prior / sigma**2
    camera_blocks += damping * np.einsum("vii->vi", camera_blocks)[:, None] * np.eye(6)
    point_blocks += (damping * np.trace(point_blocks, axis1=1, axis2=2) / 3 + 1e-9)[:, None, None] * np.eye(3)
    inverse = np.linalg.inv(point_blocks)
    eliminated = mixed @ inverse
    system = np.zeros((views, 6, views, 6))
    for v in range(views):
        system[v, :, v] += camera_blocks[v]
    system -= np.einsum("vnij,wnkj->viwk", eliminated, mixed)
    side = camera_side - np.einsum("vnij,nj->vi", eliminated, point_side)
    step_cameras = -np.linalg.solve(system.reshape(6 * views, 6 * views), side.reshape(-1)).reshape(views, 6)
    step_points = -np.einsum("nij,nj->ni", inverse, point_side + np.einsum("vnij,vi->nj", mixed, step_cameras))
    return step_cameras, step_points
