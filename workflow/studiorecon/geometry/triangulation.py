# SPDX-License-Identifier: Apache-2.0
"""World points from pixels of several cameras, batched over points, with "undetermined" as a possible answer.

All pairs of views propose a point, truncated cost picks one, and only the views that agree refine it (numerics T07-T10).
A point is undetermined when fewer than two views see it, rays are nearly parallel or opposite, it lies behind a camera that
uses it, or only a minority of the views agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from studiorecon.scene.camera import Camera

_REFINEMENTS = 3
_STEPS = 6


@dataclass(frozen=True)
class Limits:
    """What counts as agreement.

    Attributes:
        min_confidence: keypoints below it are not used.
        huber_share: one error unit, as a share of the longer image side (numerics U34: 0.005 = 6 px at 1280).
        outlier_units: a view further off than this many units is left out (U34: 3).
        min_angle_deg: smallest largest angle between two rays, and between a ray and the reverse of another (T01, T02).
        near_m: smallest depth in front of every camera that is used (T06).
    """

    min_confidence: float
    huber_share: float
    outlier_units: float
    min_angle_deg: float
    near_m: float


@dataclass(frozen=True)
class Triangulated:
    """N points, or the knowledge that there is none.

    Attributes:
        points_m: (N, 3) world points, NaN where undetermined.
        valid: (N,) bool.
        verified: (N,) bool: at least one view beyond the minimal pair agrees. The residual of a pair says nothing (T13).
        inliers: (V, N) bool: views the point rests on.
        covariance_m2: (N, 3, 3) for the given noise or the seen residual, whichever is larger; inf where undetermined.
        error_px: (V, N) reprojection error in every view that has the point, NaN elsewhere.
    """

    points_m: np.ndarray
    valid: np.ndarray
    verified: np.ndarray
    inliers: np.ndarray
    covariance_m2: np.ndarray
    error_px: np.ndarray

    @property
    def sigma_m(self) -> np.ndarray:
        """(N,) root mean square 3D error to expect: the root of the covariance's trace."""
        return np.sqrt(np.trace(self.covariance_m2, axis1=1, axis2=2))


def unit_px(cameras: Sequence[Camera], limits: Limits) -> np.ndarray:
    """(V,) one error unit of every camera in pixels."""
    return np.array([limits.huber_share * max(camera.wh) for camera in cameras])


def triangulate(
    pixels: np.ndarray, confidence: np.ndarray, cameras: Sequence[Camera], limits: Limits, noise_px: float | None = None
) -> Triangulated:
    """World points of ``pixels`` (V, N, 2), seen with ``confidence`` (V, N), by V cameras; NaN pixels are missing views.

    ``noise_px`` is the standard deviation that ``covariance_m2`` assumes; by default a third of an error unit. Confidences
    weigh the squared residuals. float64; about 30 µs a point for 4 views. Numerics T01-T16.
    """
    pixels = np.asarray(pixels, dtype=np.float64)
    views, count = pixels.shape[:2]
    assert views == len(cameras), f"{views} views of pixels for {len(cameras)} cameras"
    units = unit_px(cameras, limits)
    usable = np.isfinite(pixels).all(-1) & np.isfinite(confidence) & (confidence > max(limits.min_confidence, 0))
    # Replace the input, not the output: NaN * 0 is NaN (numerics rule 3).
    seen = np.where(usable[..., None], pixels, 0.0)
    weights = np.where(usable, confidence, 0.0)
    problem = _Problem(cameras, seen, weights, usable, units, limits)
    points, found = problem.best_pair()
    inliers = np.zeros((views, count), dtype=bool)
    for _ in range(_REFINEMENTS):
        error = problem.error_units(points)
        agreed = usable & (error < limits.outlier_units) & found
        if (agreed == inliers).all():
            break
        inliers = agreed
        points = problem.refine(points, inliers)
    inliers = usable & (problem.error_units(points) < limits.outlier_units) & found
    support, seen_by = inliers.sum(0), usable.sum(0)
    valid = found & (support >= 2) & problem.well_seen(points, inliers)
    # Two views of ten may agree by chance (T09); two of four are reported, unverified.
    valid &= (support >= 3) | (2 * support >= seen_by)
    error_px = np.where(usable & valid, problem.error_units(points) * units[:, None], np.nan)
    covariance = problem.covariance(points, inliers, valid, error_px, float(np.mean(units)) / 3 if noise_px is None else noise_px)
    valid &= np.isfinite(covariance).all((1, 2))
    return Triangulated(
        points_m=np.where(valid[:, None], points, np.nan),
        valid=valid,
        verified=valid & (support >= 3),
        inliers=inliers & valid,
        covariance_m2=np.where(valid[:, None, None], covariance, np.inf),
        error_px=np.where(valid, error_px, np.nan),
    )


class _Problem:
    """The arrays that every part of the solution reads; nothing here changes after construction."""

    def __init__(
        self,
        cameras: Sequence[Camera],
        seen: np.ndarray,
        weights: np.ndarray,
        usable: np.ndarray,
        units: np.ndarray,
        limits: Limits,
    ) -> None:
        self.rotations = np.stack([c.camera_from_world[:3, :3] for c in cameras])
        self.translations = np.stack([c.camera_from_world[:3, 3] for c in cameras])
        self.centres = np.stack([c.centre_m for c in cameras])
        self.focal = np.stack([c.focal_px for c in cameras])
        self.principal = np.stack([c.principal_px for c in cameras])
        self.seen, self.weights, self.usable, self.units, self.limits = seen, weights, usable, units, limits
        self.min_sine = np.sin(np.radians(limits.min_angle_deg))
        in_camera = (seen - self.principal[:, None]) / self.focal[:, None]
        directions = np.concatenate([in_camera, np.ones_like(in_camera[..., :1])], axis=-1) @ self.rotations
        self.directions = directions / np.linalg.norm(directions, axis=-1, keepdims=True)

    def best_pair(self) -> tuple[np.ndarray, np.ndarray]:
        """(N, 3) the pair point with the lowest truncated cost over all views, and (N,) whether there is one."""
        views, count = self.usable.shape
        best, cost, found = np.zeros((count, 3)), np.full(count, np.inf), np.zeros(count, dtype=bool)
        for a, b in combinations(range(views), 2):
            both = np.flatnonzero(self.usable[a] & self.usable[b])
            if not len(both):
                continue
            point, possible = self._midpoint(a, b, both)
            error = self.error_units(point, both)
            share = np.minimum(error / self.limits.outlier_units, 1.0) ** 2
            total = (self.weights[:, both] * share).sum(0)
            agrees = (error[a] < self.limits.outlier_units) & (error[b] < self.limits.outlier_units)
            better = possible & agrees & (total < cost[both])
            best[both[better]], cost[both[better]], found[both[better]] = point[better], total[better], True
        return best, found

    def _midpoint(self, a: int, b: int, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Middle of the common perpendicular of two rays; possible where it lies before both and the rays cross enough."""
        baseline = self.centres[b] - self.centres[a]
        first, second = self.directions[a, which], self.directions[b, which]
        cosine = (first * second).sum(-1)
        sine_squared = 1 - cosine**2
        safe = np.maximum(sine_squared, 1e-12)
        along_first, along_second = first @ baseline, second @ baseline
        range_a = (along_first - cosine * along_second) / safe
        range_b = (cosine * along_first - along_second) / safe
        point = (self.centres[a] + range_a[:, None] * first + self.centres[b] + range_b[:, None] * second) / 2
        possible = (sine_squared > self.min_sine**2) & (range_a > self.limits.near_m) & (range_b > self.limits.near_m)
        return point, possible

    def _in_cameras(self, points: np.ndarray) -> np.ndarray:
        return np.einsum("vij,nj->vni", self.rotations, points) + self.translations[:, None]

    def error_units(self, points: np.ndarray, which: np.ndarray | slice = slice(None)) -> np.ndarray:
        """(V, N) reprojection error in error units; inf behind the near plane, where there is no projection (C05)."""
        in_camera = self._in_cameras(points)
        ahead = in_camera[..., 2] > self.limits.near_m
        depth = np.where(ahead, in_camera[..., 2], 1.0)
        projected = in_camera[..., :2] / depth[..., None] * self.focal[:, None] + self.principal[:, None]
        error = np.linalg.norm(projected - self.seen[:, which], axis=-1) / self.units[:, None]
        return np.where(ahead, error, np.inf)

    def _normal(self, points: np.ndarray, inliers: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(N, 3, 3) normal matrices, (N, 3) right sides and (N,) costs of the weighted squared error in pixels over inliers."""
        in_camera = self._in_cameras(points)
        depth = np.where(inliers, in_camera[..., 2], 1.0)
        scaled = self.focal[:, None] / depth[..., None]  # (V, N, 2)
        flat = np.where(inliers[..., None], in_camera[..., :2], 0.0)
        residual = np.where(inliers[..., None], flat * scaled + self.principal[:, None] - self.seen, 0.0)
        rows = np.zeros((*inliers.shape, 2, 3))
        rows[..., 0, 0], rows[..., 1, 1] = scaled[..., 0], scaled[..., 1]
        rows[..., 2] = -flat * scaled / depth[..., None]
        rows = rows @ self.rotations[:, None]
        weights = np.where(inliers, weights, 0.0)
        weighted = rows * weights[..., None, None]
        return (
            np.einsum("vnki,vnkj->nij", weighted, rows),
            np.einsum("vnki,vnk->ni", weighted, residual),
            (weights * (residual**2).sum(-1)).sum(0),
        )

    def refine(self, points: np.ndarray, inliers: np.ndarray) -> np.ndarray:
        """Damped Gauss-Newton on the inliers; a step that raises the cost or crosses a camera's near plane is not taken (T12)."""
        points, active = points.copy(), inliers.sum(0) >= 2
        weights = np.where(inliers, self.weights / self.units[:, None] ** 2, 0.0)
        damping = np.full(len(points), 1e-6)
        matrix, side, cost = self._normal(points, inliers, weights)
        for _ in range(_STEPS):
            if not active.any():
                break
            lift = damping * np.maximum(np.trace(matrix, axis1=1, axis2=2), 1e-12) / 3
            # Points with nothing to refine get the identity, so that one of them cannot make the batch singular (T04).
            solvable = np.where(active[:, None, None], matrix + lift[:, None, None] * np.eye(3), np.eye(3))
            step = np.linalg.solve(solvable, side[..., None])[..., 0]
            moved = points - np.where(active[:, None], step, 0.0)
            ahead = ((self._in_cameras(moved)[..., 2] > self.limits.near_m) | ~inliers).all(0)
            safe = np.where((ahead & active)[:, None], moved, points)
            new_matrix, new_side, new_cost = self._normal(safe, inliers, weights)
            taken = active & ahead & (new_cost <= cost)
            points[taken] = safe[taken]
            done = taken & (cost - new_cost < 1e-12 * np.maximum(cost, 1e-12))
            matrix[taken], side[taken], cost[taken] = new_matrix[taken], new_side[taken], new_cost[taken]
            damping = np.where(taken, damping / 10, damping * 10)
            active &= ~done
        return points

    def well_seen(self, points: np.ndarray, inliers: np.ndarray) -> np.ndarray:
        """(N,) whether some two inlier rays, from the point to the camera centres, are neither parallel nor opposite."""
        rays = points - self.centres[:, None]
        rays = rays / np.maximum(np.linalg.norm(rays, axis=-1, keepdims=True), 1e-12)
        sine = np.zeros(points.shape[0])
        for a, b in combinations(range(len(self.centres)), 2):
            crossed = np.linalg.norm(np.cross(rays[a], rays[b]), axis=-1)
            sine = np.maximum(sine, np.where(inliers[a] & inliers[b], crossed, 0.0))
        return sine > self.min_sine

    def covariance(self, points: np.ndarray, inliers: np.ndarray, valid: np.ndarray, error_px: np.ndarray, noise_px: float) -> np.ndarray:
        """(N, 3, 3) inverse normal matrices times the variance per coordinate, the given or the seen one."""
        used = inliers & valid
        matrix, _, _ = self._normal(points, used, np.ones_like(self.weights))
        freedom = np.maximum(2 * used.sum(0) - 3, 1)
        seen = np.where(used, np.nan_to_num(error_px), 0.0)
        variance = np.maximum(noise_px**2, (seen**2).sum(0) / freedom)
        inverse = np.linalg.inv(np.where(valid[:, None, None], matrix, np.eye(3)))
        return inverse * variance[:, None, None]
