# SPDX-License-Identifier: Apache-2.0
"""The unknowns of most posterior probability, by damped Gauss-Newton, and their covariance.

A body's points of one moment, and a board's pose, meet no other body's: they are a small block each, and are eliminated
from the normal equations (Schur complement), which leaves the cameras and what they share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from studiorecon.estimate.factor import Factor
from studiorecon.estimate.unknowns import Unknowns

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# A step that lowers the cost by less than this share ends the search.
_CONVERGED_SHARE = 1e-6
# Shares of the diagonal: at first, and from where no step would move anything.
_DAMPING = 1e-4
_MAX_DAMPING = 1e6
# Added to the diagonal: directions that no factor determines (the world's place) do not move.
_UNDETERMINED = 1e-9
# Groups of unknowns that are eliminated.
_ELIMINATED = "points", "boards"


@dataclass(frozen=True)
class Solution:
    """The estimate.

    Attributes:
        unknowns: of most posterior probability.
        information: (S, S) of the free unknowns that were not eliminated, cameras first.
        free: which unknowns were free.
        cost: twice the negative log posterior, up to a constant.
    """

    unknowns: Unknowns
    information: Num[np.ndarray, "S S"]
    free: Bool[np.ndarray, " U"]
    cost: float

    def covariance(self, first: int) -> Num[np.ndarray, "first first"]:
        """Covariance of the ``first`` unknowns, 0 where they were fixed; undetermined directions are large."""
        chosen = np.flatnonzero(self.free[:first])
        found = np.zeros((first, first))
        count, unit = len(chosen), 1 / np.sqrt(np.diag(self.information))
        inverse = np.linalg.inv(self.information * unit[:, None] * unit) * unit[:, None] * unit
        found[np.ix_(chosen, chosen)] = inverse[:count, :count]
        return (found + found.T) / 2


def solve(
    unknowns: Unknowns, factors: Sequence[Factor], free: Bool[np.ndarray, " U"], iterations: int = 30
) -> Solution:
    """The estimate by ``factors`` from ``unknowns`` on; unknowns that are not ``free`` keep their values."""
    layout = _Layout(unknowns, factors, free)
    damping, cost = _DAMPING, _cost(unknowns, factors)
    equations = layout.equations(unknowns)
    for _ in range(iterations):
        trial = unknowns.moved(layout.step(equations, damping))
        new_cost = _cost(trial, factors)
        if not new_cost < cost:
            damping *= 10
            if damping > _MAX_DAMPING:
                break
            continue
        converged = cost - new_cost < _CONVERGED_SHARE * max(cost, 1.0)
        unknowns, cost, damping = trial, new_cost, max(damping / 5, 1e-9)
        equations = layout.equations(unknowns)
        if converged:
            break
    return Solution(unknowns, equations.reduced(0.0)[0], np.asarray(free), cost)


def _cost(unknowns: Unknowns, factors: Sequence[Factor]) -> float:
    cost = sum(f.cost(f.evaluate(unknowns)) for f in factors)
    return cost if np.isfinite(cost) else np.inf


@dataclass(frozen=True)
class _Equations:
    """JᵀWJ and JᵀWr: S shared unknowns, and B eliminated blocks of at most W unknowns, padded by ones on their
    diagonal."""

    shared: Num[np.ndarray, "S S"]
    mixed: Num[np.ndarray, "B W S"]
    blocks: Num[np.ndarray, "B W W"]
    shared_side: Num[np.ndarray, " S"]
    block_side: Num[np.ndarray, "B W"]

    def reduced(self, damping: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The damped equations of the shared unknowns, (S, S) and (S,), and the blocks' solutions (B, W, S + 1) of
        ``mixed`` and ``block_side``."""
        shared, blocks = self.shared.copy(), self.blocks.copy()
        for matrix in (shared, blocks):
            diagonal = np.einsum("...ii->...i", matrix)
            diagonal += damping * diagonal + _UNDETERMINED
        solved = np.linalg.solve(blocks, np.concatenate([self.mixed, self.block_side[..., None]], axis=2))
        taken = self.mixed.reshape(-1, len(shared)).T @ solved.reshape(-1, len(shared) + 1)
        return shared - taken[:, :-1], self.shared_side - taken[:, -1], solved


class _Layout:
    """Where the derivatives of all factors belong in the normal equations."""

    def __init__(self, unknowns: Unknowns, factors: Sequence[Factor], free: Bool[np.ndarray, " U"]) -> None:
        self.factors, self.count, count = factors, len(free), len(free)
        own = np.zeros(count, bool)
        ends = [*list(unknowns.starts.values())[1:], count]
        for (name, first), end in zip(unknowns.starts.items(), ends, strict=True):
            own[first:end] = name in _ELIMINATED
        own &= free
        self.shared, self.own = np.flatnonzero(free & ~own), np.flatnonzero(own)
        place = np.full(count, -1)
        place[self.own] = np.arange(len(self.own))
        pairs = [np.stack([f.columns[:, :-1], f.columns[:, 1:]], axis=-1).reshape(-1, 2) for f in factors]
        first, second = place[np.concatenate(pairs)[own[np.concatenate(pairs)].all(1)]].T
        linked = coo_array((np.ones(len(first)), (first, second)), shape=2 * (len(self.own),))
        self.blocks, self.block = connected_components(linked, directed=False)
        order, sizes = np.argsort(self.block, kind="stable"), np.bincount(self.block, minlength=self.blocks)
        self.row = np.empty(len(self.own), int)
        self.row[order] = np.arange(len(order)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        self.width = int(sizes.max(initial=0))
        # The last place takes what is fixed.
        of_shared, of_own = np.full(count, len(self.shared)), np.full(count, self.blocks * self.width)
        of_shared[self.shared] = np.arange(len(self.shared))
        of_own[self.own] = self.block * self.width + self.row
        self.parts = [
            _Part(f.columns, free, own, of_shared, of_own, self.width, len(self.shared), self.blocks * self.width**2)
            for f in factors
        ]

    def equations(self, unknowns: Unknowns) -> _Equations:
        """The normal equations at ``unknowns``."""
        count, rows = len(self.shared) + 1, self.blocks * self.width + 1
        shared, mixed, blocks = (
            np.zeros(count * count),
            np.zeros(rows * count),
            np.zeros((rows + 1) * max(self.width, 1)),
        )
        shared_side, block_side = np.zeros(count), np.zeros(rows)
        for factor, part in zip(self.factors, self.parts, strict=True):
            off = factor.evaluate(unknowns)
            if not len(off):
                continue
            root = np.sqrt(factor.weights(off))[:, None]
            # Of what is fixed none is needed.
            slopes = factor.derivatives(unknowns, np.concatenate([part.common, part.alone])) * root[..., None]
            common, alone, off = slopes[:, :, : len(part.common)], slopes[:, :, len(part.common) :], off * root
            for total, places, values in (
                (shared, part.in_shared, np.swapaxes(common, 1, 2) @ common),
                (mixed, part.in_mixed, np.swapaxes(alone, 1, 2) @ common),
                (blocks, part.in_blocks, np.swapaxes(alone, 1, 2) @ alone),
                (shared_side, part.of_common, np.einsum("mdk,md->mk", common, off)),
                (block_side, part.of_alone, np.einsum("mdk,md->mk", alone, off)),
            ):
                total += np.bincount(places.reshape(-1), values.reshape(-1), len(total))
        padded = blocks[: (rows - 1) * self.width].reshape(self.blocks, self.width, self.width)
        empty = np.ones((self.blocks, self.width))
        empty[self.block, self.row] = 0.0
        np.einsum("bii->bi", padded)[:] += empty
        return _Equations(
            shared.reshape(count, count)[:-1, :-1],
            mixed.reshape(rows, count)[:-1, :-1].reshape(self.blocks, self.width, count - 1),
            padded,
            shared_side[:-1],
            block_side[:-1].reshape(self.blocks, self.width),
        )

    def step(self, equations: _Equations, damping: float) -> Num[np.ndarray, " U"]:
        """The damped step of all unknowns."""
        matrix, side, solved = equations.reduced(damping)
        # Columns of radians, metres and pixels differ by powers of ten: solved with a unit diagonal.
        unit = 1 / np.sqrt(np.diag(matrix))
        of_shared = -np.linalg.solve(matrix * unit[:, None] * unit, side * unit) * unit
        of_blocks = -solved[..., -1] - solved[..., :-1] @ of_shared
        step = np.zeros(self.count)
        step[self.shared], step[self.own] = of_shared, of_blocks[self.block, self.row]
        return step


class _Part:
    """Places of one factor's products of derivatives in the normal equations."""

    def __init__(
        self,
        columns: np.ndarray,
        free: np.ndarray,
        own: np.ndarray,
        of_shared: np.ndarray,
        of_own: np.ndarray,
        width: int,
        shared: int,
        nowhere: int,
    ) -> None:
        self.common = np.flatnonzero((free & ~own)[columns].any(0))
        self.alone = np.flatnonzero(own[columns].any(0))
        self.of_common, self.of_alone = of_shared[columns[:, self.common]], of_own[columns[:, self.alone]]
        self.in_shared = self.of_common[:, :, None] * (shared + 1) + self.of_common[:, None]
        self.in_mixed = self.of_alone[:, :, None] * (shared + 1) + self.of_common[:, None]
        within = self.of_alone[:, :, None] * width + (self.of_alone % max(width, 1))[:, None]
        self.in_blocks = np.where(own[columns[:, self.alone]][:, None], within, nowhere)
