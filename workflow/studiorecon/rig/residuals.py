# SPDX-License-Identifier: Apache-2.0
"""Readout times from rays of one body point that do not meet: lens, clock and readout are estimated together.

Each camera c sees point X of a body at u = π_c(X) + lag_c v + readout_c v (row/H - 1/2) + k1_c f r² n + pose + noise, v
the image velocity in px/frame. Linear in everything but X, and X is eliminated per point (its three columns are
projected out), so no effect is damped by a previous triangulation (evaluation 3.4: by a factor of 20). Estimated
together, one effect does not appear as another.

Velocities come from an antisymmetric kernel, the same for all cameras and not using the frame itself: for stationary
noise it is uncorrelated with the residual, so a person at rest gives no false lag (V07); it gives a wide interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.rotations import cross_matrix
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# Antisymmetric derivative over five frames (Savitzky-Golay): a tenth of the noise variance per frame.
_DERIVATIVE = np.array([-2.0, -1.0, 0.0, 1.0, 2.0]) / 10
_REACH = len(_DERIVATIVE) // 2
# Prior sigmas of lag, readout, lens, three angles and three lengths of the pose (frames, frame intervals, k1, radians,
# metres). Wide for the estimated effects; the calibration's own errors for the pose, so that they do not appear as a
# lens.
_PRIOR = np.array([10.0, 3.0, 1.0, *[np.radians(0.3)] * 3, *[0.01] * 3])
_HUBER, _ROUNDS = 2.0, 4
# Fewer points or moments give no estimate.
_MIN_POINTS, _MIN_MOMENTS = 60, 8


@dataclass(frozen=True)
class Readouts:
    """The estimates per camera; NaN everywhere, with a ``reason``, when there was too little evidence.

    Attributes:
        readout, readout_sigma: (V,) time from the first to the last row, in frame intervals.
        speed_px: median, and 95 % quantile, of the image speed per frame.
        rows: share of the picture's height between the 5 % and 95 % quantile of the rows in use.
    """

    readout: Num[np.ndarray, " V"]
    readout_sigma: Num[np.ndarray, " V"]
    speed_px: tuple[float, float]
    rows: float
    reason: str = ""


def readouts_from_residuals(
    pixels: Num[np.ndarray, "V P T J 2"], cameras: Sequence[Camera], moments: int, limits: Limits
) -> Readouts:
    """Readout of every camera from tracks ``pixels`` of P people, NaN where not seen.

    Lag and lens are estimated with it, so that they do not appear as a readout. At most ``moments`` frames are used,
    evenly spaced. 0.3 s for 4 cameras, 60 moments and 17 keypoints.
    """
    system = _system(pixels, cameras, moments, limits)
    if isinstance(system, str):
        nothing = np.full(len(cameras), np.nan)
        return Readouts(nothing, nothing, (np.nan, np.nan), np.nan, system)
    solution, covariance = _solve(system)
    # Index of the readout among them.
    place = np.arange(len(cameras)) * len(_PRIOR) + 1
    return Readouts(solution[place], np.sqrt(np.diag(covariance))[place], system.speed_px, system.rows)


@dataclass(frozen=True)
class _System:
    target: Num[np.ndarray, "N 2*V"]  # residuals with the points projected out
    columns: Num[np.ndarray, "N 2*V K*V"]
    seen: Num[np.ndarray, "N V"]
    cluster: Integer[np.ndarray, " N"]  # which moment of which person
    speed_px: tuple[float, float]
    rows: float
    moments: int


def _sample(pixels: np.ndarray, moments: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels and velocities (V, N, 2) at evenly spaced frames, and the moment and person (N,) of each."""
    views, people, length, joints = pixels.shape[:4]
    if length < 2 * _REACH + 1:
        return np.zeros((views, 0, 2)), np.zeros((views, 0, 2)), np.zeros(0, int)
    at = np.unique(np.linspace(_REACH, length - 1 - _REACH, min(moments, length - 2 * _REACH)).round().astype(int))
    velocity = sum(w * pixels[:, :, at + k - _REACH] for k, w in enumerate(_DERIVATIVE) if w)
    cluster = np.broadcast_to(
        np.arange(people)[:, None, None] * len(at) + np.arange(len(at))[:, None], (people, len(at), joints)
    )
    return pixels[:, :, at].reshape(views, -1, 2), velocity.reshape(views, -1, 2), cluster.reshape(-1)


def _points(
    seen_px: np.ndarray, velocity: np.ndarray, cameras: Sequence[Camera], limits: Limits
) -> tuple[np.ndarray, np.ndarray]:
    """World points (N, 3) and their views (V, N); a point needs three views, because two always meet."""
    usable = np.isfinite(seen_px).all(-1) & np.isfinite(velocity).all(-1)
    found = triangulate(
        np.where(usable[..., None], seen_px, np.nan), usable.astype(float), cameras, limits, solver="dlt"
    )
    usable &= found.valid & (usable.sum(axis=0) >= min(3, len(cameras)))
    return found.points_m, usable


def _system(pixels: np.ndarray, cameras: Sequence[Camera], moments: int, limits: Limits) -> _System | str:
    if not pixels.size or len(cameras) < 2:
        return "no body points are followed by several cameras"
    seen_px, velocity, cluster = _sample(pixels, moments)
    points, usable = _points(seen_px, velocity, cameras, limits)
    keep = usable.any(axis=0)
    held = len(np.unique(cluster[keep]))
    if keep.sum() < _MIN_POINTS or held < _MIN_MOMENTS:
        return f"{int(keep.sum())} body points of {held} moments are seen by three cameras, which is too few"
    seen_px, velocity, points, usable, cluster = (
        seen_px[:, keep],
        velocity[:, keep],
        points[keep],
        usable[:, keep],
        cluster[keep],
    )
    views, count, size = len(cameras), len(points), len(_PRIOR)
    target, columns = np.zeros((count, views, 2)), np.zeros((count, views, 2, views, size))
    of_point = np.zeros((count, views, 2, 3))
    for v, camera in enumerate(cameras):
        use = usable[v]
        inside = points[use] @ camera.rotation_camera_from_world.T + camera.camera_from_world[:3, 3]
        normal, depth, focal = inside[:, :2] / inside[:, 2:], inside[:, 2], np.array(camera.focal_px)
        target[use, v] = seen_px[v, use] - (normal * focal + np.array(camera.principal_px))
        rows = np.zeros((len(normal), 2, 3))
        rows[:, 0, 0] = rows[:, 1, 1] = 1
        rows[:, :, 2] = -normal
        rows *= (focal[:, None] / depth[:, None, None]).reshape(len(normal), 2, 1)
        of_point[use, v] = rows @ camera.rotation_camera_from_world
        moving = velocity[v, use]
        row = seen_px[v, use, 1:] / camera.wh[1] - 0.5
        own = [moving, moving * row, focal * normal * (normal**2).sum(-1, keepdims=True)]
        # A turn w of the camera moves its points by w × p, a step d of its centre by -R d.
        columns[use, v, :, v] = np.concatenate(
            [np.stack(own, axis=-1), -rows @ cross_matrix(inside), -of_point[use, v]], axis=-1
        )
    a, b, y = (x.reshape(count, 2 * views, -1) for x in (of_point, columns, target))
    inverse = np.linalg.inv(np.swapaxes(a, 1, 2) @ a + 1e-9 * np.eye(3))
    out = np.eye(2 * views) - a @ inverse @ np.swapaxes(a, 1, 2)
    speed = np.linalg.norm(velocity, axis=-1)[usable]
    heights = np.concatenate([seen_px[v, usable[v], 1] / c.wh[1] for v, c in enumerate(cameras)])
    return _System(
        (out @ y)[..., 0],
        out @ b,
        usable.T,
        cluster,
        (float(np.median(speed)), float(np.quantile(speed, 0.95))),
        float(np.quantile(heights, 0.95) - np.quantile(heights, 0.05)),
        held,
    )


def _solve(system: _System) -> tuple[np.ndarray, np.ndarray]:
    """Robust solution (V K,) and its covariance.

    Points are weighted as a whole (Huber on their root mean square residual), because the projection must stay the
    same. The covariance is the larger of the one from the noise and the one from the scatter of whole moments, whose
    keypoints have correlated errors.
    """
    views = system.seen.shape[1]
    columns, prior = system.columns, np.tile(1 / _PRIOR**2, views)
    free = np.maximum(2 * system.seen.sum(axis=1) - 3, 1)
    solution, weights, variance = np.zeros(columns.shape[-1]), np.ones(len(free)), 1.0
    for _ in range(_ROUNDS):
        weighted = columns * weights[:, None, None]
        information = np.einsum("nik,nil->kl", weighted, columns, optimize=True)
        hessian = information + variance * np.diag(prior)
        solution = np.linalg.solve(hessian, np.einsum("nik,ni->k", weighted, system.target))
        residual = system.target - columns @ solution
        size = np.sqrt((residual**2).sum(axis=1) / free)
        scale = max(float(np.median(size)), 1e-6)
        weights = 1 / np.maximum(size / (_HUBER * scale), 1.0) ** 2
        variance = float((weights * (residual**2).sum(axis=1)).sum() / (weights * free).sum())
    inverse = np.linalg.inv(hessian)
    scores = np.zeros((system.cluster.max() + 1, len(solution)))
    np.add.at(scores, system.cluster, np.einsum("nik,ni->nk", columns * weights[:, None, None], residual))
    moments = max(system.moments, 2)
    scatter = inverse @ (scores.T @ scores) @ inverse * moments / (moments - 1)
    model = inverse * variance
    stretch = np.sqrt(np.maximum(np.diag(scatter) / np.diag(model), 1.0))
    return solution, model * stretch[:, None] * stretch[None]
