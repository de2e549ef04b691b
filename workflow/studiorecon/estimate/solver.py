# SPDX-License-Identifier: Apache-2.0
"""The unknowns of most posterior probability, by damped Gauss-Newton on sparse normal equations, and their covariance.

SuperLU factorises: points meet few cameras, so the matrix is an arrow, and a step costs about as much as its
derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

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


@dataclass(frozen=True)
class Solution:
    """The estimate.

    Attributes:
        unknowns: of most posterior probability.
        information: (F, F) sparse normal matrix of the free unknowns there.
        free: which unknowns were free.
        cost: twice the negative log posterior, up to a constant.
    """

    unknowns: Unknowns
    information: Any
    free: Bool[np.ndarray, " U"]
    cost: float

    def covariance(self, first: int) -> Num[np.ndarray, "first first"]:
        """Covariance of the ``first`` unknowns, 0 where they were fixed; undetermined directions are large."""
        chosen = np.flatnonzero(self.free[:first])
        sides = np.zeros((self.information.shape[0], len(chosen)))
        sides[np.arange(len(chosen)), np.arange(len(chosen))] = 1.0
        found = np.zeros((first, first))
        found[np.ix_(chosen, chosen)] = _factorise(self.information).solve(sides)[: len(chosen)]
        return (found + found.T) / 2


def solve(
    unknowns: Unknowns, factors: Sequence[Factor], free: Bool[np.ndarray, " U"], iterations: int = 30
) -> Solution:
    """The estimate by ``factors`` from ``unknowns`` on; unknowns that are not ``free`` keep their values."""
    damping, cost = _DAMPING, _cost(unknowns, factors)
    information, side = _normal_equations(unknowns, factors, free)
    for _ in range(iterations):
        damped = information + damping * sparse.diags_array(information.diagonal() + _UNDETERMINED)
        step = np.zeros(len(unknowns.values))
        step[free] = -_factorise(damped).solve(side)
        trial = unknowns.moved(step)
        new_cost = _cost(trial, factors)
        if not new_cost < cost:
            damping *= 10
            if damping > _MAX_DAMPING:
                break
            continue
        converged = cost - new_cost < _CONVERGED_SHARE * max(cost, 1.0)
        unknowns, cost, damping = trial, new_cost, max(damping / 5, 1e-9)
        information, side = _normal_equations(unknowns, factors, free)
        if converged:
            break
    return Solution(unknowns, information, np.asarray(free), cost)


def _cost(unknowns: Unknowns, factors: Sequence[Factor]) -> float:
    cost = sum(f.cost(f.evaluate(unknowns)) for f in factors)
    return cost if np.isfinite(cost) else np.inf


def _normal_equations(
    unknowns: Unknowns, factors: Sequence[Factor], free: np.ndarray
) -> tuple[Any, Num[np.ndarray, " F"]]:
    """Sparse JᵀWJ and JᵀWr of the free unknowns."""
    place = np.full(len(free), -1)
    place[free] = np.arange(int(free.sum()))
    rows, columns, entries, sides, at = [], [], [], [], 0
    for factor in factors:
        off = factor.evaluate(unknowns)
        if not len(off):
            continue
        root = np.sqrt(factor.weights(off))
        slopes = factor.derivatives(unknowns) * root[:, None, None]
        count, numbers = slopes.shape[:2]
        row = at + np.arange(count * numbers).reshape(count, numbers, 1)
        column = np.broadcast_to(place[factor.columns][:, None], slopes.shape)
        kept = column >= 0
        rows.append(np.broadcast_to(row, slopes.shape)[kept])
        columns.append(column[kept])
        entries.append(slopes[kept])
        sides.append((off * root[:, None]).ravel())
        at += count * numbers
    jacobian = sparse.csr_array(
        (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))), shape=(at, int(free.sum()))
    )
    normal = (jacobian.T @ jacobian).tocsc()
    normal = normal + _UNDETERMINED * sparse.eye_array(normal.shape[0], format="csc")
    return normal, jacobian.T @ np.concatenate(sides)


def _factorise(matrix: Any) -> Any:
    return splu(
        sparse.csc_array(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
