# SPDX-License-Identifier: Apache-2.0
"""The cost of a body that explains 3D points over time, and its normal equations; ``elimination`` solves them.

Unknown per frame are 24 turns and a shift (75 numbers); shared by all frames are the betas, a log scale and the
keypoints' corrections. Turning joint i by ω about world axes moves point k by ω × D_ki, D_ki the sum over i's
descendants j of G_j(anchor_kj − share_kj J_j) + share_kj (J_j^posed − J_i^posed). A point's correction is in the axes
of the joint that carries it most; ``normal_equations`` computes a point's terms. Turns are ordered by axis, then joint:
row 24 a + j.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.body.fitting.point_model import FitState, PointModel
from studiorecon.body.fitting.prior import LIMIT_SIGMA_RAD, PosePrior, body_prior
from studiorecon.body.model import BodyModel

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

FRAME_UNKNOWNS = 75
"""What a frame has for itself: the turns of 24 joints and a shift."""


@dataclass(frozen=True)
class PointEvidence:
    """Points to fit: N detector's keypoints, which have corrections, then surface points, which have none.

    Attributes:
        model: the same points on the body.
        targets_m, precision: positions, and inverse variance of a coordinate, 0 = not seen.
        share: weight of a point (surface points less than 1, U33).
    """

    model: PointModel
    targets_m: Num[np.ndarray, "F K 3"]
    precision: Num[np.ndarray, "F K"]
    share: Num[np.ndarray, "F K"]


@dataclass(frozen=True)
class PriorWeights:
    """Weights and deviations of the priors, and the Huber bound; see ``fitting.FitSettings``."""

    huber_units: float
    pose_weight: float
    limit_weight: float
    beta_weight: float
    correction_sigma_m: float
    free_scale: bool


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations at a state: H, rows of C and then the gradient, the shared part, and G."""

    frame_blocks: Num[np.ndarray, "F 75 75"]
    coupling: Num[np.ndarray, "F S+1 75"]
    shared_block: Num[np.ndarray, "S S"]
    shared_side: Num[np.ndarray, " S"]
    world: Num[np.ndarray, "F 24 3 3"]

    def local_turns(self, change: Num[np.ndarray, "F 75"]) -> Num[np.ndarray, "F 24 3"]:
        """Turns about the joints' own axes; a turn ω of a joint about world axes is Gᵀω about its own."""
        return np.einsum("fjyx,fyj->fjx", self.world, change[:, :72].reshape(-1, 3, 24))


class Problem:
    """The cost and its derivatives; immutable after construction."""

    def __init__(
        self, body: BodyModel, evidence: PointEvidence, priors: PriorWeights, pose: PosePrior | None = None
    ) -> None:
        self.evidence, self.priors, self.model = evidence, priors, evidence.model
        self.pose = pose or body_prior()
        self.precision = self.pose.precision * priors.pose_weight  # (24, 3); 0 for the root
        self.limit_precision = priors.limit_weight / LIMIT_SIGMA_RAD**2
        share, anchors = body.keypoint_anchors([f"{n}_joint" for n in body.names])
        self.skeleton = PointModel(body, share, anchors, self.model.ancestors, 0)
        # A detector's bias is the same in every frame, so the frames count as one for the shared corrections.
        corrections = np.full(3 * self.model.corrected, priors.correction_sigma_m**-2.0)
        # A fixed scale is a scale with an enormous prior: one code path at the price of one column.
        alone = np.concatenate(
            [np.full(body.shapes, priors.beta_weight), [1.0 if priors.free_scale else 1e12], corrections]
        )
        self.shared_precision = len(evidence.targets_m) * alone

    def select_frames(self, frames: Bool[np.ndarray, " F"] | slice) -> Problem:
        """The same problem in some frames."""
        part, given = copy.copy(self), self.evidence
        part.evidence = PointEvidence(self.model, given.targets_m[frames], given.precision[frames], given.share[frames])
        return part

    def costs(self, state: FitState) -> Num[np.ndarray, " F"]:
        """Half the sum of squares in deviations that each frame adds, points beyond the Huber bound linearly."""
        residual = self.model.points(state) - self.evidence.targets_m
        units = np.sqrt(self.evidence.precision * np.einsum("fkx,fkx->fk", residual, residual))
        bound = self.priors.huber_units
        data = self.evidence.share * np.where(units < bound, 0.5 * units**2, bound * (units - 0.5 * bound))
        bend = self.pose.bend(state.local)
        pull = self.precision * bend**2 + self.limit_precision * self.pose.beyond_limits(bend) ** 2
        return data.sum(1) + 0.5 * pull.sum((1, 2))

    def shared_cost(self, state: FitState) -> float:
        """Cost of the shared unknowns' priors; the whole cost is this and all ``costs``."""
        return float(0.5 * (self.shared_precision * state.shared**2).sum())

    def frame_equations(self, state: FitState) -> NormalEquations:
        """Normal equations of each frame's own unknowns, in a fraction of the time: H, the gradient and G."""
        return self.normal_equations(state, np.zeros((0, 0)), np.zeros(0))

    def normal_equations(
        self, state: FitState, shared: Num[np.ndarray, "S S"], shared_side: Num[np.ndarray, " S"]
    ) -> NormalEquations:
        """Gauss-Newton's normal equations of the points and each frame's prior; adds to ``shared``, ``shared_side``.

        A point's Huber weight follows from its distance, not per coordinate (T11).
        """
        # Loaded here: most modules that import bodies do not fit any.
        from studiorecon.body.fitting.normal_equations import add_points

        points, world, joints, offsets = self.model.evaluate(state)
        residual = points - self.evidence.targets_m
        units = np.sqrt(self.evidence.precision * np.einsum("fkx,fkx->fk", residual, residual))
        bound = self.priors.huber_units
        weight = (
            self.evidence.share
            * self.evidence.precision
            * np.where(units < bound, 1.0, bound / np.maximum(units, bound))
        )
        own, rows = (
            np.zeros((len(world), FRAME_UNKNOWNS, FRAME_UNKNOWNS)),
            np.zeros((len(world), len(shared) + 1, FRAME_UNKNOWNS)),
        )
        both = np.stack([residual, points - state.trans[:, None]])
        placed = world, joints, offsets, float(np.exp(state.log_scale))
        add_points(self.model.skeleton, self.model.compiled, placed, weight, both, own, rows, shared, shared_side)
        self._add_prior(state, world, own, rows[:, -1])
        return NormalEquations(own, rows, shared, shared_side, world)

    def _add_prior(self, state: FitState, world: np.ndarray, own: np.ndarray, side: np.ndarray) -> None:
        bend = self.pose.bend(state.local)
        beyond = self.pose.beyond_limits(bend)
        rows = self.pose.bend_derivative(bend) @ np.swapaxes(world, -1, -2)  # of world-axis turns
        curvature = self.precision + self.limit_precision * (beyond != 0)
        block = np.swapaxes(rows, -1, -2) @ (curvature[..., None] * rows)
        pull = np.swapaxes(rows, -1, -2) @ (self.precision * bend + self.limit_precision * beyond)[..., None]
        joints = np.arange(24)
        for a in range(3):
            side[:, 24 * a : 24 * a + 24] += pull[:, :, a, 0]
            for b in range(3):
                own[:, 24 * a + joints, 24 * b + joints] += block[:, :, a, b]

    def step_frames(self, state: FitState, normal: NormalEquations, damping: Num[np.ndarray, " F"]) -> FitState:
        """The state after a step with the shared unknowns fixed."""
        blocks = normal.frame_blocks.copy()
        diagonal = np.einsum("fii->fi", blocks)
        diagonal += damping[:, None] * (diagonal + 1.0)
        sides = zip(blocks, normal.coupling[:, -1])
        change = -np.stack(
            [scipy.linalg.lapack.dposv(block.T, side, lower=1, overwrite_a=1)[1] for block, side in sides]
        )
        return state.add_step(normal.local_turns(change), change[:, 72:], np.zeros(len(self.shared_precision)))
