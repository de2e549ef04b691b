# SPDX-License-Identifier: Apache-2.0
"""Pose and shape of a body from 3D keypoints over time: batched Levenberg-Marquardt with analytic derivatives.

One person, T frames, K keypoints: 24 rotations and a position per frame, one shape (and optionally one scale) for all, which
a Schur complement of the 75 × 75 blocks of the frames eliminates to (paper §fitting; numerics S06, M03-M07, U37-U39).
The cost is that of a maximum a posteriori estimate: residuals in standard deviations with a Huber bound, angles in
deviations of a pose prior, betas in deviations of the shape space. 25 points do not determine 24 rotations: without the
prior spine, collar and twist run away (21 → 34 mm at the surface for 10 mm of noise).

Derivatives: turning joint i by ω about world axes moves keypoint k by ω × D_ki, D_ki the sum over i's descendants j of
G_j(anchor_kj − share_kj J_j) + share_kj (J_j^posed − J_i^posed). All products of two such rows follow from Σ w D Dᵀ.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from studiorecon.body import prior
from studiorecon.body.basis import Basis, Linear, State
from studiorecon.body.model import BodyModel
from studiorecon.body.start import start
from studiorecon.geometry import rotations


@dataclass(frozen=True)
class FitSettings:
    """What the fit trusts.

    Attributes:
        iterations: most Levenberg-Marquardt steps; it ends earlier when a step gains less than ``tolerance`` of the cost.
        tolerance: relative gain below which it has converged.
        point_sigma_m: deviation between a detector's point and the body's from frame to frame, added to the triangulation's.
        correction_sigma_m: deviation of the constant part of that difference, one vector per keypoint, which is estimated:
            no detector's hip is the body's hip (numerics M07).
        huber_units: deviations beyond which a point pulls with constant force.
        pose_weight: multiplies the squared angle prior; 1 = the deviations of ``body/prior.py``.
        beta_weight: multiplies Σ β² in every frame (paper: λ_β = 10). Counted once per person instead, real footage bends the shape
            to 15 deviations, because a detector's habits repeat in every frame.
        free_scale: estimate one scale as well; only where lengths are not metres, since scale and β₀ are exchangeable.
    """

    iterations: int
    tolerance: float
    point_sigma_m: float
    correction_sigma_m: float
    huber_units: float
    pose_weight: float
    beta_weight: float
    free_scale: bool


@dataclass(frozen=True)
class Fit:
    """Result for T frames; frames without enough points are NaN and not valid.

    Attributes:
        rotations: (T, 24, 3, 3) relative to the parent, ``trans_m`` (T, 3) pelvis, ``betas`` (B,), ``scale`` of the body.
        corrections_m: (K, 3) detector's point minus the body's, in the axes of the joint that carries it most.
        valid: (T,) bool.
        joints_m: (T, 24, 3); ``joint_sigma_m``: (T, 24) posterior deviation, root of the covariance's mean eigenvalue.
        residual_m: (T, K) distance between body and keypoint, NaN where there was none.
        iterations: steps taken; ``converged``: whether the last one gained less than the tolerance.
    """

    rotations: np.ndarray
    trans_m: np.ndarray
    betas: np.ndarray
    scale: float
    corrections_m: np.ndarray
    valid: np.ndarray
    joints_m: np.ndarray
    joint_sigma_m: np.ndarray
    residual_m: np.ndarray
    iterations: int
    converged: bool


def fit(body: BodyModel, names: list[str], points_m: np.ndarray, sigma_m: np.ndarray, settings: FitSettings) -> Fit:
    """The body that explains ``points_m`` (T, K, 3) named ``names``, with deviations ``sigma_m`` (T, K); NaN or inf = not seen.

    float64; about 1 ms a frame for 25 points. Frames whose points do not fix the body's position are left out (M06).
    """
    frames, count = points_m.shape[:2]
    seen = np.isfinite(points_m).all(-1) & np.isfinite(sigma_m)
    problem_start = start(body, names, np.where(seen[..., None], points_m, 0.0), seen)
    valid = problem_start.determined
    out = Fit(
        rotations=np.full((frames, 24, 3, 3), np.nan),
        trans_m=np.full((frames, 3), np.nan),
        betas=np.zeros(body.shapes),
        scale=1.0,
        corrections_m=np.zeros((count, 3)),
        valid=valid,
        joints_m=np.full((frames, 24, 3), np.nan),
        joint_sigma_m=np.full((frames, 24), np.inf),
        residual_m=np.full((frames, count), np.nan),
        iterations=0,
        converged=False,
    )
    if not valid.any():
        return out
    problem = _Problem(body, names, points_m[valid], sigma_m[valid], seen[valid], settings)
    state = State(problem_start.local[valid], problem_start.trans_m[valid], np.zeros(body.shapes), 0.0, np.zeros((count, 3)))
    state, steps, converged = _descend(problem, state, settings)
    residual = np.linalg.norm(problem.linear(state).points - problem.targets, axis=-1)
    out.rotations[valid], out.trans_m[valid] = state.local, state.trans
    out.joints_m[valid], out.joint_sigma_m[valid] = problem.joints(state)
    out.residual_m[valid] = np.where(problem.seen, residual, np.nan)
    scale = float(np.exp(state.log_scale))
    return replace(out, betas=state.betas, scale=scale, corrections_m=state.corrections, iterations=steps, converged=converged)


def _descend(problem: _Problem, state: State, settings: FitSettings) -> tuple[State, int, bool]:
    """Levenberg-Marquardt with one damping for all frames; a step that raises the cost is not taken."""
    damping, cost = 1e-3, problem.cost(state)
    for step in range(1, settings.iterations + 1):
        normal = problem.normal(state)
        for _ in range(8):
            moved = problem.step(state, normal, damping)
            new_cost = problem.cost(moved)
            if new_cost < cost:
                break
            damping *= 8
        else:
            return state, step, True  # no direction gains: a minimum to rounding
        gain = (cost - new_cost) / cost
        state, cost, damping = moved, new_cost, max(damping / 5, 1e-7)
        if gain < settings.tolerance:
            return state, step, True
    return state, settings.iterations, False


class _Problem:
    """Targets and the body's keypoint basis; nothing here changes after construction."""

    def __init__(self, body: BodyModel, names: list[str], targets: np.ndarray, sigma: np.ndarray, seen: np.ndarray, settings: FitSettings):
        self.body, self.settings, self.seen = body, settings, seen
        self.targets = np.where(seen[..., None], targets, 0.0)
        variance = np.where(seen, sigma, 0.0) ** 2 + settings.point_sigma_m**2
        self.weights = np.where(seen, 1.0 / variance, 0.0)
        self.ancestors = np.eye(24)
        for j, parent in enumerate(body.parents):
            if parent >= 0:
                self.ancestors[:, j] += self.ancestors[:, parent]
        self.basis = Basis(body, *body.keypoint_basis(names), self.ancestors, True)
        self.skeleton = Basis(body, *body.keypoint_basis([f"{n}_joint" for n in body.names]), self.ancestors, False)
        self.precision = prior.precision() * settings.pose_weight  # (24, 3); 0 for the root
        # What is wrong with a detector's points is wrong in every frame, so the frames count as one for what they share.
        corrections = np.full(3 * len(names), settings.correction_sigma_m**-2.0)
        shapes = np.full(body.shapes, settings.beta_weight)
        # A fixed scale is a scale with an enormous prior: one code path, and it costs one column.
        self.shared_precision = len(targets) * np.concatenate([shapes, [1.0 if settings.free_scale else 1e12], corrections])

    def linear(self, state: State) -> Linear:
        return self.basis.linear(state)

    def _whitened(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        residual = points - self.targets
        return residual, np.sqrt(self.weights * np.einsum("fkx,fkx->fk", residual, residual))

    def cost(self, state: State) -> float:
        _, units = self._whitened(self.basis.points(state)[0])
        bound = self.settings.huber_units
        data = np.where(units < bound, 0.5 * units**2, bound * (units - 0.5 * bound)).sum()
        bend = prior.bend(state.local)
        return float(data + 0.5 * (self.precision * bend**2).sum() + 0.5 * (self.shared_precision * state.shared**2).sum())

    def normal(self, state: State) -> tuple[np.ndarray, ...]:
        """Normal matrices of the frames (F, 75, 75), coupling (F, 75, S), shared (S, S), and both right sides; and G."""
        linear = self.linear(state)
        residual, units = self._whitened(linear.points)
        # Weight of the Huber bound by its value, not per coordinate (T11).
        bound = self.settings.huber_units
        w = self.weights * np.where(units < bound, 1.0, bound / np.maximum(units, bound))
        frames, count, shapes = len(w), w.shape[1], linear.shaped.shape[-1]
        turned = linear.turned.reshape(frames, count, 72)
        right = np.concatenate([turned, linear.shaped.reshape(frames, count, -1), residual, np.ones((frames, count, 1))], axis=-1)
        products = np.swapaxes(turned * w[..., None], 1, 2) @ right
        matrix = np.zeros((frames, 75, 75))
        # Jᵀ J of two turns: [a]×ᵀ [b]× = (a·b) I − b aᵀ.
        dd = products[..., :72].reshape(frames, 24, 3, 24, 3)
        block = -np.swapaxes(dd, 2, 4)
        trace = np.einsum("fixjx->fij", dd)
        for axis in range(3):
            block[:, :, axis, :, axis] += trace
        matrix[:, :72, :72] = block.reshape(frames, 72, 72)
        matrix[:, 72:, :72] = -np.swapaxes(rotations.cross_matrix(products[..., -1].reshape(frames, 24, 3)), 1, 2).reshape(frames, 3, 72)
        matrix[:, :72, 72:] = np.swapaxes(matrix[:, 72:, :72], 1, 2)
        matrix[:, range(72, 75), range(72, 75)] = w.sum(1)[:, None]
        # Jᵀ v of a turn: D × v, from the antisymmetric part of Σ w D vᵀ.
        shaped = products[..., 72 : 72 + 3 * shapes].reshape(frames, 24, 3, 3, shapes)
        side = np.zeros((frames, 75))
        side[:, :72] = _antisymmetric(products[..., -4:-1].reshape(frames, 24, 3, 3, 1)).reshape(frames, 72)
        side[:, 72:] = np.einsum("fk,fkx->fx", w, residual)
        weighted_shape = linear.shaped * w[..., None, None]
        carried = linear.carried * w[..., None, None]
        coupling = np.zeros((frames, 75, len(self.shared_precision)))
        coupling[:, :72, :shapes] = _antisymmetric(shaped).reshape(frames, 72, shapes)
        coupling[:, 72:, :shapes] = weighted_shape.sum(1)
        # Corrections touch one point each: their products need no sum over points.
        coupling[:, :72, shapes:] = _crossed(linear.turned, carried).reshape(frames, 72, -1)
        coupling[:, 72:, shapes:] = np.swapaxes(carried, 1, 2).reshape(frames, 3, -1)
        shared_matrix = np.diag(self.shared_precision)
        flat = weighted_shape.reshape(-1, shapes)
        shared_matrix[:shapes, :shapes] += flat.T @ linear.shaped.reshape(-1, shapes)
        mixed = np.einsum("fkys,fkyx->skx", linear.shaped, carried, optimize=True).reshape(shapes, -1)
        shared_matrix[:shapes, shapes:] += mixed
        shared_matrix[shapes:, :shapes] += mixed.T
        own = np.repeat(w.sum(0), 3) * np.exp(2 * state.log_scale)
        shared_matrix[range(shapes, len(own) + shapes), range(shapes, len(own) + shapes)] += own
        shared_side = self.shared_precision * state.shared
        shared_side[:shapes] += flat.T @ residual.reshape(-1)
        shared_side[shapes:] += np.einsum("fkyx,fky->kx", carried, residual).reshape(-1)
        self._add_prior(state, linear.world, matrix, side)
        return matrix, coupling, shared_matrix, side, shared_side, linear.world

    def _add_prior(self, state: State, world: np.ndarray, matrix: np.ndarray, side: np.ndarray) -> None:
        bend = prior.bend(state.local)
        rows = prior.bend_derivative(bend) @ np.swapaxes(world, -1, -2)  # of world-axis turns
        weighted = np.swapaxes(rows, -1, -2) * self.precision[:, None, :]
        block = weighted @ rows
        for j in range(24):
            matrix[:, 3 * j : 3 * j + 3, 3 * j : 3 * j + 3] += block[:, j]
        side[:, :72] += (weighted @ bend[..., None]).reshape(len(side), 72)

    def step(self, state: State, normal: tuple[np.ndarray, ...], damping: float) -> State:
        matrix, coupling, shared_matrix, side, shared_side, world = normal
        damped = matrix.copy()
        diagonal = np.einsum("fii->fi", damped)
        diagonal += damping * (diagonal + 1.0)
        solved = np.linalg.solve(damped, np.concatenate([coupling, side[..., None]], axis=-1))
        by_shared, own = solved[..., :-1], solved[..., -1]
        reduced = shared_matrix * (1 + damping * np.eye(len(shared_matrix))) - np.tensordot(coupling, by_shared, ((0, 1), (0, 1)))
        shared = -np.linalg.solve(reduced, shared_side - np.einsum("fps,fp->s", coupling, own))
        change = -own - by_shared @ shared
        # World-axis turn ω of joint i is the turn Gᵀω about its own axes.
        turn = np.einsum("fjyx,fjy->fjx", world, change[:, :72].reshape(-1, 24, 3))
        return state.moved(turn, change[:, 72:], shared)

    def joints(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """(F, 24, 3) joints and (F, 24) posterior deviations, Laplace's approximation at the minimum."""
        matrix, coupling, shared_matrix, _, _, _ = self.normal(state)
        linear = self.skeleton.linear(state)
        frames = len(matrix)
        inverse = np.linalg.inv(matrix + 1e-9 * np.eye(75))
        by_shared = inverse @ coupling
        reduced = shared_matrix - np.tensordot(coupling, by_shared, ((0, 1), (0, 1)))
        rows = np.zeros((frames, 24, 3, 75))
        rows[..., :72] = -np.moveaxis(rotations.cross_matrix(linear.turned), 2, 3).reshape(frames, 24, 3, 72)
        rows[..., range(3), range(72, 75)] = 1.0
        own = np.einsum("fkxp,fkxp->fk", rows @ inverse[:, None], rows)
        through = -rows @ by_shared[:, None]
        through[..., : linear.shaped.shape[-1]] += linear.shaped
        shape = np.einsum("fkxs,fkxs->fk", through @ np.linalg.inv(reduced), through)
        return linear.points, np.sqrt((own + shape) / 3)


def _antisymmetric(products: np.ndarray) -> np.ndarray:
    """(F, 24, 3, S): Σ w D × v from Σ w D vᵀ (F, 24, 3, 3, S)."""
    x = products[:, :, 1, 2] - products[:, :, 2, 1]
    y = products[:, :, 2, 0] - products[:, :, 0, 2]
    z = products[:, :, 0, 1] - products[:, :, 1, 0]
    return np.stack([x, y, z], axis=2)


def _crossed(turned: np.ndarray, carried: np.ndarray) -> np.ndarray:
    """(F, 24, 3, K, 3): D_ki × the columns of carried_k, from (F, K, 24, 3) and (F, K, 3, 3)."""
    dx, dy, dz = np.moveaxis(np.swapaxes(turned, 1, 2), -1, 0)[..., None]  # (F, 24, K, 1) each
    cx, cy, cz = np.moveaxis(carried, 2, 0)[:, :, None]  # (F, 1, K, 3) each
    return np.stack([dy * cz - dz * cy, dz * cx - dx * cz, dx * cy - dy * cx], axis=2)
