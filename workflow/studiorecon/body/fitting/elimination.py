# SPDX-License-Identifier: Apache-2.0
"""Solves the normal equations of a body over time: the steps, and the uncertainty that the points leave.

The 75 × 75 blocks of the frames are factored by Cholesky. H⁻¹ C is never formed, only L⁻¹ C; its product with itself is
the Schur complement's reduction of the shared unknowns. A frame's equations and factors take 0.2 MB, so long films form
them block by block, and again once the shared unknowns are known.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.body.fitting.point_model import FitState
from studiorecon.body.fitting.problem import FRAME_UNKNOWNS, NormalEquations, Problem

if TYPE_CHECKING:
    from jaxtyping import Num

# Frames handled at once: their rows (0.7 MB for 25 points) then stay in the cache.
_CHUNK = 12
# Frames whose equations are in memory at once; those of half a minute at 30 frames per second are formed only once.
_BLOCK = 75 * _CHUNK

_Factored = tuple[slice, NormalEquations, np.ndarray, np.ndarray, np.ndarray]


def blocks(frames: int) -> list[slice]:
    """Slices of the frames whose equations are in memory at once."""
    return [slice(start, start + _BLOCK) for start in range(0, frames, _BLOCK)]


class Equations:
    """Gauss-Newton's equations of a problem at a state."""

    def __init__(self, problem: Problem, state: FitState) -> None:
        self.state, self._problem = state, problem
        self._blocks = blocks(len(state.trans))
        self._only: NormalEquations | None = None

    def step(self, damping: Num[np.ndarray, " F"]) -> FitState | None:
        """The state after a step, frames damped by ``damping``; None where the equations are not positive definite.

        In single precision where that suffices: a step may be off by 1e-4 of its length, and the cost decides.
        """
        try:
            product, normal, again = self._eliminated(damping, 1.0, (np.float32, np.float64))
        except np.linalg.LinAlgError:
            return None
        reduced = normal.shared_block * (1 + np.median(damping) * np.eye(len(normal.shared_block))) - product[:-1, :-1]
        shared = -np.linalg.solve(reduced, normal.shared_side - product[:-1, -1])
        frames = len(self.state.trans)
        turns, shifts = np.empty((frames, 24, 3)), np.empty((frames, 3))
        for some, block, lower, solved, _ in again:
            half = -(solved[:, -1] + np.einsum("fsp,s->fp", solved[:, :-1], shared))
            solve = scipy.linalg.blas.strsv if lower.dtype == np.float32 else scipy.linalg.blas.dtrsv
            change = np.stack(
                [solve(one.T, rest, lower=1, trans=1) for one, rest in zip(lower, half.astype(lower.dtype))]
            )
            turns[some], shifts[some] = block.local_turns(change), change[:, 72:]
        return self.state.add_step(turns, shifts, shared)

    def posterior(
        self, state: FitState
    ) -> tuple[
        Num[np.ndarray, "F 24 3"],
        Num[np.ndarray, "F 24"],
        Num[np.ndarray, "F 24 3"],
        Num[np.ndarray, "F 24"],
        Num[np.ndarray, " B"],
    ]:
        """Joints at ``state``, after the last step, and Laplace's deviations of joints, turns, parts and betas.

        A joint's is the root of its covariance's mean eigenvalue. A turn's is about the joint's own axes. A part's is
        the angle of its orientation in the world, from all turns above it. Turns and parts are for the estimated shape.
        Raises FloatingPointError when even a little added weight does not make the equations definite, for input that
        is not finite.
        """
        nothing = np.zeros(len(self.state.trans))
        try:
            product, normal, again = self._eliminated(nothing, 0.0, (np.float64,))
        except np.linalg.LinAlgError:
            # Without a prior, an unobserved joint is singular: the smallest weight that makes it definite gives an
            # enormous deviation.
            try:
                product, normal, again = self._eliminated(nothing + 1e-9, 1.0, (np.float64,))
            except np.linalg.LinAlgError as error:
                raise FloatingPointError("the normal equations of the fit are not positive definite") from error
        # Σ a a′ over the columns of this is the shared unknowns' part of the joints' covariance.
        spread = np.linalg.inv(np.linalg.cholesky(normal.shared_block - product[:-1, :-1])).T
        found = [self._deviations(state.select_frames(block[0]), *block[1:4], spread) for block in again]
        joints, sigmas, turns, parts = (np.concatenate(part) for part in zip(*found))
        betas = np.sqrt((spread**2).sum(1)[: len(state.betas)])
        return joints, sigmas, turns, parts, betas

    def _eliminated(
        self, damping: np.ndarray, floor: float, kinds: tuple[type, ...]
    ) -> tuple[np.ndarray, NormalEquations, Iterable[_Factored]]:
        """Σ [C g]ᵀ H⁻¹ [C g] (S + 1, S + 1) over all blocks, the last block's equations, and all blocks factored again.

        The last block's equations hold all shared terms. Raises LinAlgError where a block is not positive definite.
        """
        once = list(self._factored(damping, floor, kinds)) if len(self._blocks) == 1 else None
        product = np.zeros((len(self._problem.shared_precision) + 1,) * 2)
        for block in once or self._factored(damping, floor, kinds):
            product += block[-1]
        return product, block[1], once or self._factored(damping, floor, kinds)

    def _factored(self, damping: np.ndarray, floor: float, kinds: tuple[type, ...]) -> Iterator[_Factored]:
        """Yields frames, equations and ``_factors`` block by block."""
        precision = self._problem.shared_precision
        shared, side = np.diag(precision), precision * self.state.shared
        for some in self._blocks:
            normal = self._only or self._problem.select_frames(some).normal_equations(
                self.state.select_frames(some), shared, side
            )
            self._only = normal if len(self._blocks) == 1 else None
            for kind in kinds:
                if (factors := _factors(normal, damping[some], floor, kind)) is not None:
                    yield some, normal, *factors
                    break
            else:
                raise np.linalg.LinAlgError

    def _deviations(
        self, state: FitState, normal: NormalEquations, lower: np.ndarray, solved: np.ndarray, spread: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Joints, and deviations of joints, turns and parts, in some frames."""
        linear = self._problem.skeleton.linearise(state)
        frames, shapes = len(lower), linear.by_shape.shape[-1]
        variance, turns, parts = np.empty((frames, 72)), np.empty((frames, 24, 3, 3)), np.empty((frames, 24))
        for start in range(0, frames, _CHUNK):
            few = slice(start, start + _CHUNK)
            roots = np.tril([scipy.linalg.lapack.dtrtri(one.T, lower=1)[0] for one in lower[few]])  # L⁻¹
            by_axis = roots[..., :72].reshape(-1, FRAME_UNKNOWNS, 3, 24)
            per_joint = np.moveaxis(by_axis, -1, 1)  # (F, 24, 75, 3)
            turns[few] = np.swapaxes(per_joint, -1, -2) @ per_joint
            parts[few] = ((by_axis.reshape(-1, 3 * FRAME_UNKNOWNS, 24) @ self._problem.model.ancestors) ** 2).sum(1)
            rows = np.zeros((len(roots), 3, 24, FRAME_UNKNOWNS))
            rows[:, range(3), :, range(72, 75)] = 1.0
            for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # component a of ω × D is ω_b D_c − ω_c D_b
                rows[:, a, :, 24 * b : 24 * b + 24] = linear.by_turn[few, :, :, c]
                rows[:, a, :, 24 * c : 24 * c + 24] = -linear.by_turn[few, :, :, b]
            half = rows.reshape(-1, 72, FRAME_UNKNOWNS) @ np.swapaxes(roots, 1, 2)
            through = half @ np.swapaxes(solved[few, :-1], 1, 2)
            through[..., :shapes] -= np.swapaxes(linear.by_shape[few], 1, 2).reshape(-1, 72, shapes)
            variance[few] = np.einsum("frp,frp->fr", half, half) + ((through @ spread) ** 2).sum(-1)
        joint_variance = variance.reshape(frames, 3, 24).mean(1)
        turn_variance = np.einsum("fjyx,fjyz,fjzx->fjx", normal.world, turns, normal.world, optimize=True)
        return linear.points, np.sqrt(joint_variance), np.sqrt(turn_variance), np.sqrt(parts)


def _factors(
    normal: NormalEquations, damping: np.ndarray, floor: float, kind: type
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Factors L of H, transposed, rows of L⁻¹[C g], and Σ [C g]ᵀ H⁻¹ [C g]; None where H is not positive definite."""
    lower: np.ndarray = normal.frame_blocks.astype(kind)
    solved: np.ndarray = normal.coupling.astype(kind)
    diagonal = np.einsum("fii->fi", lower)
    diagonal += damping[:, None] * (diagonal + floor)
    lapack, blas = scipy.linalg.lapack, scipy.linalg.blas
    factor, divide, square = (
        (lapack.spotrf, blas.strsm, blas.ssyrk) if kind is np.float32 else (lapack.dpotrf, blas.dtrsm, blas.dsyrk)
    )
    product = np.zeros((solved.shape[1],) * 2)
    for start in range(0, len(lower), _CHUNK):
        part: np.ndarray = np.zeros(product.shape, kind, order="F")
        for f in range(start, min(start + _CHUNK, len(lower))):
            # LAPACK reads columns: a transposed row-major array passes without a copy and is overwritten.
            _, info = factor(lower[f].T, lower=1, clean=0, overwrite_a=1)
            if info != 0:
                return None
            divide(1.0, lower[f].T, solved[f].T, lower=1, overwrite_b=1)
            square(1.0, solved[f].T, beta=1.0, c=part, trans=1, lower=1, overwrite_c=1)
        product += part
    return lower, solved, np.tril(product) + np.tril(product, -1).T
