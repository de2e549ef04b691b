# SPDX-License-Identifier: Apache-2.0
"""Other bodies that explain a frame nearly as well, for a sigma that covers what few points cannot decide (M06).

With a shoulder, both hips or most points missing, a body seen from behind or upside down may fit the rest as well.
Around the least cost everything is well determined, so the deviations there would claim 24° where the body is 166°
wrong. Each such frame is also solved from the opposite sides. The best solution is used; the others widen its
deviations by their likelihood and distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.fitting import prior
from studiorecon.body.fitting.levenberg_marquardt import descend_per_frame
from studiorecon.body.fitting.point_model import FitState
from studiorecon.body.fitting.problem import Problem
from studiorecon.geometry import rotations

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# Fewer keypoints, or fewer of the trunk's four corners, count as few.
_POINTS, _CORNERS = 12, 3
_TRUNK = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
# Seen from behind, upside down, and both; axis-angles about the body's own axes (x to its left, y upwards).
_TURNS = ((0.0, np.pi, 0.0), (np.pi, 0.0, 0.0), (0.0, 0.0, np.pi))


@dataclass(frozen=True)
class Spread:
    """Variances to add for other solutions: mean squared distances from the best one, weighted by likelihood.

    They are of joints per coordinate, of each joint's turn about its own axes, and of a part's orientation in the
    world.
    """

    joints_m2: Num[np.ndarray, "F 24"]
    turns_rad2: Num[np.ndarray, "F 24 3"]
    parts_rad2: Num[np.ndarray, "F 24"]


def has_too_few_points(names: list[str], seen: Num[np.ndarray, "F K"]) -> Num[np.ndarray, " F"]:
    """Frames whose ``seen`` keypoints are too few to be sure which way the body faces."""
    corners = [k for k, name in enumerate(names) if name.removesuffix("_joint") in _TRUNK]
    return (seen.sum(1) < _POINTS) | (seen[:, corners].sum(1) < _CORNERS)


def best_start(
    problem: Problem, state: FitState, chosen: Bool[np.ndarray, " F"], iterations: int, tolerance: float
) -> tuple[FitState, Spread]:
    """The state of least cost from all start directions in the ``chosen`` frames, and the other solutions' variance.

    About 10 ms for each chosen frame. Shape and corrections stay.
    """
    part, first = problem.select_frames(chosen), state.select_frames(chosen)
    solutions, costs = [first], [part.costs(first)]
    for turn in _TURNS:
        local = np.tile(prior.mean_pose(), (len(first.trans), 1, 1, 1))
        local[:, 0] = first.local[:, 0] @ rotations.exp(np.array(turn))
        other = FitState(local, first.trans, first.betas, first.log_scale, first.corrections)
        other, cost, _ = descend_per_frame(part, other, part.costs(other), iterations, tolerance)
        solutions.append(other)
        costs.append(cost)
    winner = np.argmin(costs, axis=0)
    frames = np.arange(len(winner))
    best = FitState(
        np.array([s.local for s in solutions])[winner, frames],
        np.array([s.trans for s in solutions])[winner, frames],
        first.betas,
        first.log_scale,
        first.corrections,
    )
    likely = np.exp(np.min(costs, axis=0) - np.array(costs))
    likely /= likely.sum(0)
    at_best = part.skeleton.pose(best)
    joints, turns, parts = np.zeros((len(winner), 24)), np.zeros((len(winner), 24, 3)), np.zeros((len(winner), 24))
    for weight, other in zip(likely, solutions):
        posed = part.skeleton.pose(other)
        joints += weight[:, None] * ((posed.points - at_best.points) ** 2).mean(-1)
        turns += weight[:, None, None] * rotations.log(np.swapaxes(best.local, -1, -2) @ other.local) ** 2
        parts += weight[:, None] * rotations.angle(posed.world, at_best.world) ** 2
    spread = Spread(*(np.zeros((len(chosen), *a.shape[1:])) for a in (joints, turns, parts)))
    spread.joints_m2[chosen], spread.turns_rad2[chosen], spread.parts_rad2[chosen] = joints, turns, parts
    return state.replace_frames(chosen, best), spread
