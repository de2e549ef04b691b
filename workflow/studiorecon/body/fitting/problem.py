# SPDX-License-Identifier: Apache-2.0
"""The cost of a body that should explain 3D points over time, its normal equations, their solution and what they leave
unknown.

Unknown per frame are 24 turns and a shift (75 numbers), shared by all frames the betas, a log scale and the keypoints'
corrections. Turning joint i by ω about world axes moves point k by ω × D_ki, D_ki the sum over i's descendants j of
G_j(anchor_kj − share_kj J_j) + share_kj (J_j^posed − J_i^posed). A point's correction is in the axes of the joint that
carries it most; what a point adds to the equations is in ``assembly``.

The 75 × 75 blocks of the frames are factored by Cholesky; H⁻¹ C is never formed, only L⁻¹ C, whose product with itself
is what the shared unknowns lose by the elimination (Schur complement). Turns are ordered by axis, then joint: row 24 a
+ j.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.body.fitting import prior
from studiorecon.body.fitting.basis import Basis, State
from studiorecon.body.model import BodyModel

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# Frames handled at once: their rows (0.7 MB for 25 points) then stay in the cache.
_CHUNK = 12
_OWN = 75


@dataclass(frozen=True)
class PointEvidence:
    """Points to explain: N detector's keypoints, which have corrections, then surface points, which have none.

    Attributes:
        basis: the same points on the body.
        targets_m: (F, K, 3), any number where not seen; ``precision``: (F, K) inverse variance of a coordinate, 0 = not
            seen.
        share: (F, K) how often a point counts (surface points less than once, U33).
    """

    basis: Basis
    targets_m: Num[np.ndarray, "F K 3"]
    precision: Num[np.ndarray, "F K"]
    share: Num[np.ndarray, "F K"]


@dataclass(frozen=True)
class Pulls:
    """What draws the body besides the points, see ``fitting.FitSettings``: weights and deviations, and the Huber
    bound."""

    huber_units: float
    pose_weight: float
    limit_weight: float
    beta_weight: float
    correction_sigma_m: float
    free_scale: bool


@dataclass(frozen=True)
class Normal:
    """Normal equations at a state: H, rows of C and then the gradient, what is shared, and G."""

    own: Num[np.ndarray, "F 75 75"]
    rows: Num[np.ndarray, "F S+1 75"]
    shared: Num[np.ndarray, "S S"]
    shared_side: Num[np.ndarray, " S"]
    world: Num[np.ndarray, "F 24 3 3"]


class Problem:
    """Nothing here changes after construction."""

    def __init__(self, body: BodyModel, evidence: PointEvidence, pulls: Pulls) -> None:
        self.evidence, self.pulls, self.basis = evidence, pulls, evidence.basis
        self.precision = prior.precision() * pulls.pose_weight  # (24, 3); 0 for the root
        self.limit_precision = pulls.limit_weight / prior.LIMIT_SIGMA_RAD**2
        share, anchors = body.keypoint_basis([f"{n}_joint" for n in body.names])
        self.skeleton = Basis(body, share, anchors, self.basis.ancestors, 0)
        # What is wrong with a detector's points is wrong in every frame, so the frames count as one for what they
        # share.
        corrections = np.full(3 * self.basis.corrected, pulls.correction_sigma_m**-2.0)
        # A fixed scale is a scale with an enormous prior: one code path, and it costs one column.
        alone = np.concatenate(
            [np.full(body.shapes, pulls.beta_weight), [1.0 if pulls.free_scale else 1e12], corrections]
        )
        self.shared_precision = len(evidence.targets_m) * alone

    def only(self, frames: Bool[np.ndarray, " F"]) -> Problem:
        """The same problem in some frames."""
        part, given = copy.copy(self), self.evidence
        part.evidence = PointEvidence(self.basis, given.targets_m[frames], given.precision[frames], given.share[frames])
        return part

    def costs(self, state: State) -> Num[np.ndarray, " F"]:
        """(F,) half the sum of squares in deviations that each frame adds, points beyond the Huber bound linearly."""
        residual = self.basis.points(state) - self.evidence.targets_m
        units = np.sqrt(self.evidence.precision * np.einsum("fkx,fkx->fk", residual, residual))
        bound = self.pulls.huber_units
        data = self.evidence.share * np.where(units < bound, 0.5 * units**2, bound * (units - 0.5 * bound))
        bend = prior.bend(state.local)
        pull = self.precision * bend**2 + self.limit_precision * prior.excess(bend) ** 2
        return data.sum(1) + 0.5 * pull.sum((1, 2))

    def shared_cost(self, state: State) -> float:
        """What the shared unknowns cost by themselves; the whole cost is this and all ``costs``."""
        return float(0.5 * (self.shared_precision * state.shared**2).sum())

    def normal(self, state: State) -> Normal:
        """Gauss-Newton's normal equations; a point's Huber weight follows from its distance, not per coordinate
        (T11)."""
        return self._normal(state, np.diag(self.shared_precision), self.shared_precision * state.shared)

    def own(self, state: State) -> Normal:
        """Normal equations of what every frame has for itself, at a fraction of the cost; H, the gradient (F, 1, 75)
        and G."""
        return self._normal(state, np.zeros((0, 0)), np.zeros(0))

    def _normal(self, state: State, shared: np.ndarray, shared_side: np.ndarray) -> Normal:
        # Loaded here: most that reads about bodies fits none.
        from studiorecon.body.fitting.normal_equations import add_points

        points, world, joints, offsets = self.basis.placed(state)
        residual = points - self.evidence.targets_m
        units = np.sqrt(self.evidence.precision * np.einsum("fkx,fkx->fk", residual, residual))
        bound = self.pulls.huber_units
        weight = (
            self.evidence.share
            * self.evidence.precision
            * np.where(units < bound, 1.0, bound / np.maximum(units, bound))
        )
        own, rows = np.zeros((len(world), _OWN, _OWN)), np.zeros((len(world), len(shared) + 1, _OWN))
        both = np.stack([residual, points - state.trans[:, None]])
        placed = world, joints, offsets, float(np.exp(state.log_scale))
        add_points(self.basis.skeleton, self.basis.compiled, placed, weight, both, own, rows, shared, shared_side)
        self._add_prior(state, world, own, rows[:, -1])
        return Normal(own, rows, shared, shared_side, world)

    def _add_prior(self, state: State, world: np.ndarray, own: np.ndarray, side: np.ndarray) -> None:
        bend = prior.bend(state.local)
        beyond = prior.excess(bend)
        rows = prior.bend_derivative(bend) @ np.swapaxes(world, -1, -2)  # of world-axis turns
        curvature = self.precision + self.limit_precision * (beyond != 0)
        block = np.swapaxes(rows, -1, -2) @ (curvature[..., None] * rows)
        pull = np.swapaxes(rows, -1, -2) @ (self.precision * bend + self.limit_precision * beyond)[..., None]
        joints = np.arange(24)
        for a in range(3):
            side[:, 24 * a : 24 * a + 24] += pull[:, :, a, 0]
            for b in range(3):
                own[:, 24 * a + joints, 24 * b + joints] += block[:, :, a, b]

    def step(self, state: State, normal: Normal, damping: Num[np.ndarray, " F"]) -> State | None:
        """The Gauss-Newton step, frames damped by ``damping`` (F,), or None where the equations are not positive
        definite.

        In single precision where that suffices: a step of 1e-4 of its length beside the best is as good, and the cost
        decides.
        """
        factors = self._factored(normal, damping, 1.0, np.float32) or self._factored(normal, damping, 1.0, np.float64)
        if factors is None:
            return None
        lower, solved, product = factors
        reduced = normal.shared * (1 + np.median(damping) * np.eye(len(normal.shared))) - product[:-1, :-1]
        shared = -np.linalg.solve(reduced, normal.shared_side - product[:-1, -1])
        half = -(solved[:, -1] + np.einsum("fsp,s->fp", solved[:, :-1], shared))
        solve = scipy.linalg.blas.strsv if lower.dtype == np.float32 else scipy.linalg.blas.dtrsv
        change = np.stack([solve(one.T, rest, lower=1, trans=1) for one, rest in zip(lower, half.astype(lower.dtype))])
        return self._moved(state, normal, change, shared)

    def own_step(self, state: State, normal: Normal, damping: Num[np.ndarray, " F"]) -> State:
        """The same with all that frames share held fixed."""
        blocks = normal.own.copy()
        diagonal = np.einsum("fii->fi", blocks)
        diagonal += damping[:, None] * (diagonal + 1.0)
        sides = zip(blocks, normal.rows[:, -1])
        change = -np.stack(
            [scipy.linalg.lapack.dposv(block.T, side, lower=1, overwrite_a=1)[1] for block, side in sides]
        )
        return self._moved(state, normal, change, np.zeros(len(self.shared_precision)))

    @staticmethod
    def _moved(state: State, normal: Normal, change: np.ndarray, shared: np.ndarray) -> State:
        # World-axis turn ω of joint i is the turn Gᵀω about its own axes.
        turn = np.einsum("fjyx,fyj->fjx", normal.world, change[:, :72].reshape(-1, 3, 24))
        return state.moved(turn, change[:, 72:], shared)

    @staticmethod
    def _factored(
        normal: Normal, damping: np.ndarray | float, floor: float, dtype: type
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Factors L of H, transposed (F, 75, 75), rows of L⁻¹[C g] (F, S + 1, 75), and Σ [C g]ᵀ H⁻¹ [C g] (S + 1, S +
        1)."""
        lower: np.ndarray = normal.own.astype(dtype)
        solved: np.ndarray = normal.rows.astype(dtype)
        diagonal = np.einsum("fii->fi", lower)
        diagonal += np.reshape(damping, (-1, 1)) * (diagonal + floor)
        lapack, blas = scipy.linalg.lapack, scipy.linalg.blas
        factor, divide, square = (
            (lapack.spotrf, blas.strsm, blas.ssyrk) if dtype is np.float32 else (lapack.dpotrf, blas.dtrsm, blas.dsyrk)
        )
        product = np.zeros((solved.shape[1],) * 2)
        for start in range(0, len(lower), _CHUNK):
            part: np.ndarray = np.zeros(product.shape, dtype, order="F")
            for f in range(start, min(start + _CHUNK, len(lower))):
                # LAPACK reads columns: a transposed row-major array passes without a copy and is overwritten.
                _, info = factor(lower[f].T, lower=1, clean=0, overwrite_a=1)
                if info != 0:
                    return None
                divide(1.0, lower[f].T, solved[f].T, lower=1, overwrite_b=1)
                square(1.0, solved[f].T, beta=1.0, c=part, trans=1, lower=1, overwrite_c=1)
            product += part
        return lower, solved, np.tril(product) + np.tril(product, -1).T

    def posterior(
        self, state: State, normal: Normal
    ) -> tuple[
        Num[np.ndarray, "F 24 3"],
        Num[np.ndarray, "F 24"],
        Num[np.ndarray, "F 24 3"],
        Num[np.ndarray, "F 24"],
        Num[np.ndarray, " B"],
    ]:
        """Joints and Laplace's deviations: of joints, turns, parts and betas, from the last normal equations.

        A joint's is the root of its covariance's mean eigenvalue. A turn's is about the joint's own axes, a part's the
        angle of its orientation in the world (all turns above it and their correlation), both for the shape found.
        Raises FloatingPointError when even a little added weight does not make the equations definite: numbers that are
        not finite came in.
        """
        factors = self._factored(normal, 0.0, 0.0, np.float64)
        if (
            factors is None
        ):  # no prior and an unobserved joint: the least that makes it definite makes its deviation enormous
            factors = self._factored(normal, 1e-9, 1.0, np.float64)
        if factors is None:
            raise FloatingPointError("the normal equations of the fit are not positive definite")
        lower, solved, product = factors
        linear = self.skeleton.linear(state)
        # Σ a a′ over the columns of this is what the shared unknowns leave of the joints' covariance.
        spread = np.linalg.inv(np.linalg.cholesky(normal.shared - product[:-1, :-1])).T
        frames, shapes = len(lower), linear.shaped.shape[-1]
        variance, turns, parts = np.empty((frames, 72)), np.empty((frames, 24, 3, 3)), np.empty((frames, 24))
        for start in range(0, frames, _CHUNK):
            some = slice(start, start + _CHUNK)
            roots = np.tril([scipy.linalg.lapack.dtrtri(one.T, lower=1)[0] for one in lower[some]])  # L⁻¹
            by_axis = roots[..., :72].reshape(-1, _OWN, 3, 24)
            per_joint = np.moveaxis(by_axis, -1, 1)  # (F, 24, 75, 3)
            turns[some] = np.swapaxes(per_joint, -1, -2) @ per_joint
            parts[some] = ((by_axis.reshape(-1, 3 * _OWN, 24) @ self.basis.ancestors) ** 2).sum(1)
            rows = np.zeros((len(roots), 3, 24, _OWN))
            rows[:, range(3), :, range(72, 75)] = 1.0
            for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # component a of ω × D is ω_b D_c − ω_c D_b
                rows[:, a, :, 24 * b : 24 * b + 24] = linear.turned[some, :, :, c]
                rows[:, a, :, 24 * c : 24 * c + 24] = -linear.turned[some, :, :, b]
            half = rows.reshape(-1, 72, _OWN) @ np.swapaxes(roots, 1, 2)
            through = half @ np.swapaxes(solved[some, :-1], 1, 2)
            through[..., :shapes] -= np.swapaxes(linear.shaped[some], 1, 2).reshape(-1, 72, shapes)
            variance[some] = np.einsum("frp,frp->fr", half, half) + ((through @ spread) ** 2).sum(-1)
        joint_variance = variance.reshape(frames, 3, 24).mean(1)
        turn_variance = np.einsum("fjyx,fjyz,fjzx->fjx", normal.world, turns, normal.world, optimize=True)
        betas = np.sqrt((spread**2).sum(1)[: shapes - 1])
        return linear.points, np.sqrt(joint_variance), np.sqrt(turn_variance), np.sqrt(parts), betas
