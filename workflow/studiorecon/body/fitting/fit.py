# SPDX-License-Identifier: Apache-2.0
"""Pose and shape of a body from 3D keypoints over time: batched Levenberg-Marquardt with analytic derivatives.

One person, T frames, K keypoints: 24 rotations and a position per frame, and one shape (optionally one scale) for all,
which a Schur complement eliminates to (paper §fitting; S06, M03-M07, U37-U39; ``problem``). Surface points are used
where the source gives a body (U33). The cost is that of a maximum a posteriori estimate: residuals in standard
deviations with a Huber bound, angles in deviations of a pose prior with limits, betas in deviations of the shape space.
25 points do not determine 24 rotations: without the prior, spine, collar and twist run away (21 → 34 mm at the surface
for 10 mm of noise). ``Fit.turn_sigma_rad`` reports the remaining uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.arrays import require
from studiorecon.body.fitting import multi_start
from studiorecon.body.fitting.elimination import Equations
from studiorecon.body.fitting.levenberg_marquardt import descend
from studiorecon.body.fitting.point_model import FitState, PointModel
from studiorecon.body.fitting.problem import PointEvidence, PriorWeights, Problem
from studiorecon.body.fitting.start import initial_pose
from studiorecon.body.model import BodyModel

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer, Num

PER_FRAME = (
    "rotations",
    "trans_m",
    "frame_betas",
    "valid",
    "joints_m",
    "joint_sigma_m",
    "turn_sigma_rad",
    "part_sigma_rad",
    "residual_m",
)
"""Fields of ``Fit`` with an entry per frame."""


@dataclass(frozen=True)
class FitSettings:
    """Weights and limits of the fit.

    Attributes:
        iterations: most Levenberg-Marquardt steps; it ends earlier when a step gains less than ``tolerance`` of the
            cost.
        tolerance: relative gain below which it has converged.
        point_sigma_m: deviation between a detector's point and the body's from frame to frame, added to the
            triangulation's.
        correction_sigma_m: deviation of the constant part of that difference, one vector per keypoint, which is
            estimated: no detector's hip is the body's hip (M07).
        huber_units: deviations beyond which a point pulls with constant force.
        pose_weight: multiplies the squared angle prior; 1 = the deviations of ``body/fitting/prior.py``.
        limit_weight: multiplies the squared excess beyond the joints' limits; 0 = none.
        beta_weight: multiplies Σ β² in every frame (paper: λ_β = 10). Counted only once per person, real footage bends
            the shape to 15 deviations, because a detector's errors repeat in every frame.
        vertex_weight: total weight of a frame's surface points, as a share of its keypoints, at most 1 (U33: they carry
            the monocular prior, not image evidence); 0 = not used.
        shape: "shared" by all frames, or one "per_frame" (the paper's; U39).
        free_scale: estimate one scale as well; only where lengths are not metres, since scale and β₀ are exchangeable.
    """

    iterations: int
    tolerance: float
    point_sigma_m: float
    correction_sigma_m: float
    huber_units: float
    pose_weight: float
    limit_weight: float
    beta_weight: float
    vertex_weight: float
    shape: str
    free_scale: bool


@dataclass(frozen=True)
class SurfacePoints:
    """Observed surface points: ``vertices`` of the body model, ``points_m`` (NaN = none) and ``sigma_m``."""

    vertices: Integer[np.ndarray, " V"]
    points_m: Num[np.ndarray, "T V 3"]
    sigma_m: Num[np.ndarray, "T V"]


@dataclass(frozen=True)
class Fit:
    """Result for T frames; frames without enough points are NaN and not valid.

    Attributes:
        rotations: relative to the parent; ``trans_m``: pelvis.
        betas, scale: of the body; with a shape per frame ``betas`` is the median of ``frame_betas``.
        corrections_m: detector's point minus the body's, in the axes of the joint that carries it most.
        joint_sigma_m: posterior deviation, root of the covariance's mean eigenvalue; it includes other bodies that
            explain a frame with few points (``multi_start``).
        turn_sigma_rad: posterior deviation of each joint's turn about its own axes.
        part_sigma_rad: of each part's orientation in the world.
        residual_m: distance between body and keypoint, NaN where there was none.
        iterations, converged: steps taken, and whether the last one gained less than the tolerance.
    """

    rotations: Num[np.ndarray, "T 24 3 3"]
    trans_m: Num[np.ndarray, "T 3"]
    betas: Num[np.ndarray, " B"]
    frame_betas: Num[np.ndarray, "T B"]
    scale: float
    corrections_m: Num[np.ndarray, "K 3"]
    valid: Bool[np.ndarray, " T"]
    joints_m: Num[np.ndarray, "T 24 3"]
    joint_sigma_m: Num[np.ndarray, "T 24"]
    turn_sigma_rad: Num[np.ndarray, "T 24 3"]
    part_sigma_rad: Num[np.ndarray, "T 24"]
    beta_sigma: Num[np.ndarray, " B"]
    residual_m: Num[np.ndarray, "T K"]
    iterations: int
    converged: bool


def fit(
    body: BodyModel,
    names: list[str],
    points_m: Num[np.ndarray, "T K 3"],
    sigma_m: Num[np.ndarray, "T K"],
    settings: FitSettings,
    surface: SurfacePoints | None = None,
) -> Fit:
    """The body that best fits ``points_m``, called ``names``, with deviations ``sigma_m``; NaN or inf is not seen.

    float64; about 2 ms a frame for 25 points, 10 with 200 points of the surface. Frames whose keypoints do not fix the
    body's position are left out (M06). Raises ValueError for other shapes, negative deviations and a ``vertex_weight``
    outside [0, 1].
    """
    check(names, points_m, sigma_m, settings, surface)
    if settings.shape == "per_frame":
        return _fit_each_frame(body, names, points_m, sigma_m, settings, surface)
    frames, count = points_m.shape[:2]
    seen = np.isfinite(points_m).all(-1) & np.isfinite(sigma_m)
    first = initial_pose(body, names, np.where(seen[..., None], points_m, 0.0), seen)
    valid = first.determined
    out = empty_fit(frames, count, body.shapes, valid)
    if not valid.any():
        return out
    evidence = merge_points(body, names, points_m[valid], sigma_m[valid], settings, surface_in_frames(surface, valid))
    priors = PriorWeights(
        settings.huber_units,
        settings.pose_weight,
        settings.limit_weight,
        settings.beta_weight,
        settings.correction_sigma_m,
        settings.free_scale,
    )
    problem = Problem(body, evidence, priors)
    state = FitState(first.local[valid], first.trans_m[valid], np.zeros(body.shapes), 0.0, np.zeros((count, 3)))
    state, equations, steps, converged = descend(problem, state, settings.iterations, settings.tolerance)
    spread, doubtful = None, multi_start.has_too_few_points(names, seen[valid])
    if doubtful.any():
        state, spread = multi_start.best_start(problem, state, doubtful, settings.iterations, settings.tolerance)
        equations = Equations(problem, state)
    residual = np.linalg.norm(evidence.model.points(state) - evidence.targets_m, axis=-1)[:, :count]
    out.rotations[valid], out.trans_m[valid], out.frame_betas[valid] = state.local, state.trans, state.betas
    joints, *sigmas, out.beta_sigma[:] = equations.posterior(state)
    if spread is not None:
        sigmas = [
            np.sqrt(s**2 + more) for s, more in zip(sigmas, (spread.joints_m2, spread.turns_rad2, spread.parts_rad2))
        ]
    out.joints_m[valid], out.joint_sigma_m[valid], out.turn_sigma_rad[valid], out.part_sigma_rad[valid] = (
        joints,
        *sigmas,
    )
    out.residual_m[valid] = np.where(seen[valid], residual, np.nan)
    scale = float(np.exp(state.log_scale))
    return replace(
        out, betas=state.betas, scale=scale, corrections_m=state.corrections, iterations=steps, converged=converged
    )


def check(
    names: list[str],
    points_m: Num[np.ndarray, "T K 3"],
    sigma_m: Num[np.ndarray, "T K"],
    settings: FitSettings,
    surface: SurfacePoints | None,
) -> None:
    """Raise ValueError, with the argument and its shape, for input that no fit can start from."""
    sizes = require("points_m", points_m, ("T", "K", 3), {"K": len(names)})
    require("sigma_m", sigma_m, ("T", "K"), sizes)
    if not 0 <= settings.vertex_weight <= 1:
        raise ValueError(
            f"vertex_weight must lie in [0, 1], not {settings.vertex_weight}: the "
            "surface counts at most as much as joints"
        )
    if surface is not None:
        sizes = require("surface.points_m", surface.points_m, ("T", "V", 3), sizes | {"V": len(surface.vertices)})
        require("surface.sigma_m", surface.sigma_m, ("T", "V"), sizes)
    if (np.asarray(sigma_m) < 0).any() or (surface is not None and (np.asarray(surface.sigma_m) < 0).any()):
        raise ValueError(f"sigma_m of shape {np.shape(sigma_m)} has negative deviations")
    if settings.shape not in ("shared", "per_frame"):
        raise ValueError(f"shape must be shared or per_frame, not {settings.shape!r}")


def empty_fit(frames: int, count: int, shapes: int, valid: Bool[np.ndarray, " T"]) -> Fit:
    """An empty fit of ``frames`` frames and ``count`` keypoints, in which nothing has been measured."""
    return Fit(
        rotations=np.full((frames, 24, 3, 3), np.nan),
        trans_m=np.full((frames, 3), np.nan),
        betas=np.zeros(shapes),
        frame_betas=np.full((frames, shapes), np.nan),
        scale=1.0,
        corrections_m=np.zeros((count, 3)),
        valid=valid,
        joints_m=np.full((frames, 24, 3), np.nan),
        joint_sigma_m=np.full((frames, 24), np.inf),
        turn_sigma_rad=np.full((frames, 24, 3), np.inf),
        part_sigma_rad=np.full((frames, 24), np.inf),
        beta_sigma=np.full(shapes, np.inf),
        residual_m=np.full((frames, count), np.nan),
        iterations=0,
        converged=False,
    )


def merge_points(
    body: BodyModel,
    names: list[str],
    points_m: Num[np.ndarray, "T K 3"],
    sigma_m: Num[np.ndarray, "T K"],
    settings: FitSettings,
    surface: SurfacePoints | None,
) -> PointEvidence:
    """Keypoints and surface points as one set; in a frame the surface weighs ``vertex_weight`` times its keypoints."""
    share, anchors = body.keypoint_anchors(names)
    targets, sigma = np.asarray(points_m, dtype=np.float64), np.asarray(sigma_m, dtype=np.float64)
    if surface is not None and settings.vertex_weight > 0:
        on_skin, skin_anchors = body.vertex_anchors(surface.vertices)
        share, anchors = np.concatenate([share, on_skin]), np.concatenate([anchors, skin_anchors])
        targets = np.concatenate([targets, surface.points_m], axis=1)
        sigma = np.concatenate([sigma, surface.sigma_m], axis=1)
    seen = np.isfinite(targets).all(-1) & np.isfinite(sigma)
    # NaN is replaced before the arithmetic, because a mask afterwards would come too late (M02).
    precision = np.where(seen, 1.0 / (np.where(seen, sigma, 0.0) ** 2 + settings.point_sigma_m**2), 0.0)
    counts = np.ones_like(precision)
    joints, skin = precision[:, : len(names)].sum(1), precision[:, len(names) :].sum(1)
    counts[:, len(names) :] = (settings.vertex_weight * joints / np.where(skin > 0, skin, 1.0))[:, None]
    ancestors = np.eye(24)
    for j, parent in enumerate(body.parents):
        if parent >= 0:
            ancestors[:, j] += ancestors[:, parent]
    return PointEvidence(
        PointModel(body, share, anchors, ancestors, len(names)),
        np.where(seen[..., None], targets, 0.0),
        precision,
        counts,
    )


def _fit_each_frame(
    body: BodyModel,
    names: list[str],
    points_m: np.ndarray,
    sigma_m: np.ndarray,
    settings: FitSettings,
    surface: SurfacePoints | None,
) -> Fit:
    """Fit every frame with its own shape and corrections (U39); their medians shift joints by a few mm."""
    frames = range(len(points_m))
    alone = replace(settings, shape="shared")
    fits = [
        fit(body, names, points_m[t : t + 1], sigma_m[t : t + 1], alone, surface_in_frames(surface, slice(t, t + 1)))
        for t in frames
    ]
    stacked: dict[str, Any] = {name: np.concatenate([getattr(f, name) for f in fits]) for name in PER_FRAME}
    known = [f for f in fits if f.valid.all()]
    out = replace(empty_fit(len(points_m), len(names), body.shapes, stacked["valid"]), **stacked)
    if not known:
        return out
    return replace(
        out,
        betas=np.median([f.betas for f in known], axis=0),
        scale=float(np.median([f.scale for f in known])),
        corrections_m=np.median([f.corrections_m for f in known], axis=0),
        beta_sigma=np.median([f.beta_sigma for f in known], axis=0),
        iterations=max(f.iterations for f in known),
        converged=all(f.converged for f in known),
    )


def surface_in_frames(surface: SurfacePoints | None, frames: Bool[np.ndarray, " T"] | slice) -> SurfacePoints | None:
    """The surface points of some frames."""
    return (
        None if surface is None else SurfacePoints(surface.vertices, surface.points_m[frames], surface.sigma_m[frames])
    )
