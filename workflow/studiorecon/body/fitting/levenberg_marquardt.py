# SPDX-License-Identifier: Apache-2.0
"""Levenberg-Marquardt over many frames that share a shape, with one damping per frame.

Outliers keep single frames busy long after shape and corrections have converged. With one damping for all, all frames
would wait for them: 30 steps where 5 suffice. So a frame that a step makes worse keeps its pose and is damped more. The
few frames that have not converged continue with the shape fixed, before all move together again. No step raises the
cost.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.fitting.elimination import Equations, blocks
from studiorecon.body.fitting.point_model import FitState
from studiorecon.body.fitting.problem import Problem

if TYPE_CHECKING:
    from jaxtyping import Num

# First, least and most damping, its factors after a refused and a taken step, and trials of one step.
_DAMPING, _MIN_DAMPING, _MAX_DAMPING, _MORE, _LESS, _TRIALS = 1e-3, 1e-7, 1e3, 8.0, 5.0, 8
# A frame that gains more than this share in a step has not converged; at most that share of the frames continues
# separately.
_BUSY, _FEW = 0.01, 0.3


def descend(
    problem: Problem, state: FitState, iterations: int, tolerance: float
) -> tuple[FitState, Equations, int, bool]:
    """The state of least cost within ``iterations`` steps, last equations, number of steps, and whether they converged.

    Converged: a step of all unknowns gains less than ``tolerance`` of the cost, or nothing.
    """
    costs, damping = problem.costs(state), np.full(len(state.trans), _DAMPING)
    for step in range(1, iterations + 1):
        equations = Equations(problem, state)
        whole = costs.sum() + problem.shared_cost(state)
        for _ in range(_TRIALS):
            moved = equations.step(damping)
            if moved is not None:
                moved, new_costs, refused = _reject_worse_steps(problem, state, moved, costs)
                gain = whole - new_costs.sum() - problem.shared_cost(moved)
                if gain > 0:
                    break
            damping = damping * _MORE
        else:
            return state, equations, step, True  # no direction gains: a minimum to rounding
        busy = refused | (costs - new_costs > _BUSY * costs)
        state, costs = moved, new_costs
        damping = np.where(refused, damping * _MORE, np.maximum(damping / _LESS, _MIN_DAMPING))
        if gain < tolerance * whole:
            return state, equations, step, True
        if 0 < busy.sum() <= _FEW * len(busy):
            part, costs[busy], damping[busy] = descend_per_frame(
                problem.select_frames(busy),
                state.select_frames(busy),
                costs[busy],
                iterations,
                tolerance,
                damping[busy],
            )
            state = state.replace_frames(busy, part)
    return state, equations, iterations, False


def _reject_worse_steps(
    problem: Problem, state: FitState, moved: FitState, costs: np.ndarray
) -> tuple[FitState, np.ndarray, np.ndarray]:
    """``moved``, with old poses of frames where those are better with the new shape; costs, and which frames."""
    new_costs = problem.costs(moved)
    worse = new_costs > costs
    if worse.any():
        old = FitState(state.local[worse], state.trans[worse], moved.betas, moved.log_scale, moved.corrections)
        held_costs = problem.select_frames(worse).costs(old)
        better = held_costs < new_costs[worse]
        worse[worse] = better
        new_costs[worse] = held_costs[better]
        moved = moved.replace_frames(
            worse, FitState(old.local[better], old.trans[better], moved.betas, moved.log_scale, moved.corrections)
        )
    return moved, new_costs, worse


def descend_per_frame(
    problem: Problem,
    state: FitState,
    costs: Num[np.ndarray, " F"],
    iterations: int,
    tolerance: float,
    damping: Num[np.ndarray, " F"] | None = None,
) -> tuple[FitState, Num[np.ndarray, " F"], Num[np.ndarray, " F"]]:
    """State, costs and damping after every frame is solved with the shared unknowns fixed, until none gains.

    ``costs`` are those of ``state``; ``damping`` is the start value, by default that of ``descend``.
    """
    costs, damping = costs.copy(), np.full(len(costs), _DAMPING) if damping is None else damping.copy()
    for some in blocks(len(costs)):
        part, costs[some], damping[some] = _descend_block(
            problem.select_frames(some), state.select_frames(some), costs[some], iterations, tolerance, damping[some]
        )
        state = state.replace_frames(some, part)
    return state, costs, damping


def _descend_block(
    problem: Problem, state: FitState, costs: np.ndarray, iterations: int, tolerance: float, damping: np.ndarray
) -> tuple[FitState, np.ndarray, np.ndarray]:
    busy = np.ones(len(costs), dtype=bool)
    for _ in range(iterations):
        part, old = problem.select_frames(busy), state.select_frames(busy)
        moved = part.step_frames(old, part.frame_equations(old), damping[busy])
        new_costs = part.costs(moved)
        before = costs[busy]
        better = new_costs < before
        at = np.flatnonzero(busy)
        state = state.replace_frames(at[better], moved.select_frames(better))
        costs[at[better]] = new_costs[better]
        damping[at] = np.where(better, np.maximum(damping[at] / _LESS, _MIN_DAMPING), damping[at] * _MORE)
        # A frame has converged when a step gains little, or when none gains however short it is.
        busy[at] = np.where(better, before - new_costs > tolerance * before, damping[at] < _MAX_DAMPING)
        if not busy.any():
            break
    return state, costs, damping
