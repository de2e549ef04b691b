# SPDX-License-Identifier: Apache-2.0
"""Points of the body as functions of pose, position, shape and scale, with derivatives, without the mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.body.skinning import forward_kinematics
from studiorecon.geometry import rotations

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer, Num


@dataclass(frozen=True)
class FitState:
    local: Num[np.ndarray, "F 24 3 3"]
    trans: Num[np.ndarray, "F 3"]
    betas: Num[np.ndarray, " B"]
    log_scale: float
    # Metres, detector's point minus the body's, in the axes of the joint that carries it most.
    corrections: Num[np.ndarray, "C 3"]

    @property
    def shared(self) -> Num[np.ndarray, " S"]:
        """The unknowns shared by all frames: betas, log scale, corrections."""
        return np.concatenate([self.betas, [self.log_scale], self.corrections.reshape(-1)])

    def select_frames(self, frames: Bool[np.ndarray, " F"] | slice) -> FitState:
        """The state of some frames."""
        return FitState(self.local[frames], self.trans[frames], self.betas, self.log_scale, self.corrections)

    def replace_frames(
        self, frames: Bool[np.ndarray, " F"] | Integer[np.ndarray, " part"] | slice, part: FitState
    ) -> FitState:
        """The state with ``frames`` replaced by those of ``part``; shared unknowns stay."""
        local, trans = self.local.copy(), self.trans.copy()
        local[frames], trans[frames] = part.local, part.trans
        return FitState(local, trans, self.betas, self.log_scale, self.corrections)

    def add_step(
        self, local_turn: Num[np.ndarray, "F 24 3"], shift: Num[np.ndarray, "F 3"], shared: Num[np.ndarray, " S"]
    ) -> FitState:
        """The state after small turns about the joints' own axes, shifts, and a change of the shared unknowns."""
        count = len(self.betas)
        return FitState(
            self.local @ rotations.exp(local_turn),
            self.trans + shift,
            self.betas + shared[:count],
            self.log_scale + float(shared[count]),
            self.corrections + shared[count + 1 :].reshape(-1, 3),
        )


@dataclass(frozen=True)
class PosedPoints:
    """Points in a pose, and the terms of their derivatives."""

    points: Num[np.ndarray, "F K 3"]
    parts: Num[np.ndarray, "F 24 K 3"]  # each joint's contribution, about the pelvis and unscaled
    world: Num[np.ndarray, "F 24 3 3"]
    joints: Num[np.ndarray, "F 24 3"]  # about the pelvis and unscaled


@dataclass(frozen=True)
class PointDerivatives:
    """Posed points and their derivatives."""

    points: Num[np.ndarray, "F K 3"]
    by_turn: Num[np.ndarray, "F K 24 3"]  # D; the memory's order is (F, K, 3, 24)
    by_shape: Num[np.ndarray, "F K 3 B+1"]  # by betas and log scale
    world: Num[np.ndarray, "F 24 3 3"]


class PointModel:
    """K points as a function of the state, with derivatives; see ``BodyModel.keypoint_anchors``.

    Corrections belong to the first ``corrected`` points; ``carrier`` is the joint that carries a point most.
    """

    def __init__(
        self,
        body: BodyModel,
        share: Num[np.ndarray, "K 24"],
        anchors: Num[np.ndarray, "K 24 3 1+B"],
        ancestors: Num[np.ndarray, "24 24"],
        corrected: int,
    ) -> None:
        self.corrected = corrected
        self.carrier = share.argmax(1)
        self.body, self.share, self.ancestors = body, share, ancestors
        skeleton = np.concatenate([body.joint_template_m[..., None], body.joint_directions], axis=-1)
        # (24, K, 3, 1 + B): the vectors that each joint's rotation turns, as a function of (1, betas).
        self.offsets = np.moveaxis(anchors - share[:, :, None, None] * skeleton, 0, 1)
        # (72, K · B): the same by the betas only, laid out for one product with all joints' rotations.
        self.shape_offsets = np.ascontiguousarray(np.swapaxes(self.offsets[..., 1:], 1, 2)).reshape(72, -1)
        self.subtree_share = np.ascontiguousarray((ancestors @ share.T).T)  # (K, 24)
        self.bone_directions = body.joint_directions - body.joint_directions[np.maximum(body.parents, 0)]
        carried = (share != 0) | (self.offsets != 0).any((2, 3)).T
        parents = np.asarray(body.parents, dtype=np.int64)
        # Inputs of ``normal_equations.add_points``.
        self.skeleton = parents, np.ascontiguousarray(self.bone_directions)
        self.compiled = (
            np.ascontiguousarray(share),
            self.subtree_share,
            _joint_lists(carried),
            _joint_lists((carried @ ancestors.T) > 0),
            np.ascontiguousarray(self.offsets[..., 1:]),
            self.carrier,
            corrected,
        )

    def points(self, state: FitState) -> Num[np.ndarray, "F K 3"]:
        """The points in the state's pose."""
        return self.evaluate(state)[0]

    def evaluate(
        self, state: FitState
    ) -> tuple[
        Num[np.ndarray, "F K 3"], Num[np.ndarray, "F 24 3 3"], Num[np.ndarray, "F 24 3"], Num[np.ndarray, "24 K 3"]
    ]:
        """The points, world rotations and joints as in ``PosedPoints``, and offsets."""
        world, joints = forward_kinematics(
            np.ascontiguousarray(state.local), self.body.rest_joints(state.betas), self.body.parents
        )
        offsets = self._offsets(state)
        rows = np.swapaxes(world, 1, 2).reshape(-1, 72)  # (3 F, 24 · 3): row x of all joints' rotations
        points = (rows @ np.swapaxes(offsets, 1, 2).reshape(72, -1)).reshape(len(world), 3, -1)
        return (
            np.exp(state.log_scale) * (np.swapaxes(points, 1, 2) + self.share @ joints) + state.trans[:, None],
            world,
            joints,
            offsets,
        )

    def pose(self, state: FitState) -> PosedPoints:
        """The points in the state's pose, with the terms of their derivatives."""
        world, joints = forward_kinematics(state.local, self.body.rest_joints(state.betas), self.body.parents)
        parts = self._offsets(state) @ np.swapaxes(world, -1, -2)
        parts += self.share.T[..., None] * joints[:, :, None]
        points = np.exp(state.log_scale) * parts.sum(1) + state.trans[:, None]
        return PosedPoints(points, parts, world, joints)

    def _offsets(self, state: FitState) -> np.ndarray:
        """(24, K, 3) the vectors that each joint's rotation turns."""
        offsets = self.offsets @ np.append(1.0, state.betas)
        own = self.carrier[: self.corrected]
        offsets[own, range(len(own))] += state.corrections[: len(own)]
        return offsets

    def linearise(self, state: FitState) -> PointDerivatives:
        """The points and their derivatives."""
        posed = self.pose(state)
        return PointDerivatives(
            posed.points, self.derivatives_by_turn(state, posed), self.derivatives_by_shape(state, posed), posed.world
        )

    def derivatives_by_turn(self, state: FitState, posed: PosedPoints) -> Num[np.ndarray, "F K 24 3"]:
        """Derivatives by turns, see ``PointDerivatives``."""
        frames = len(posed.world)
        turned = (
            np.swapaxes(posed.parts.reshape(frames, 24, -1), 1, 2) @ self.ancestors.T
        )  # (F, 3K, 24), sums over each subtree
        turned = turned.reshape(frames, len(self.share), 3, 24)
        turned -= self.subtree_share[:, None] * np.swapaxes(posed.joints, 1, 2)[:, None]
        turned *= np.exp(state.log_scale)
        return np.swapaxes(turned, 2, 3)

    def derivatives_by_shape(self, state: FitState, posed: PosedPoints) -> Num[np.ndarray, "F K 3 B+1"]:
        """(F, K, 3, B + 1) derivatives by betas and log scale."""
        world, count, shapes = posed.world, len(self.share), self.body.shapes
        frames = len(world)
        moved = np.zeros((frames, 24, 3, shapes))
        for j, parent in enumerate(self.body.parents):
            if parent >= 0:
                moved[:, j] = moved[:, parent] + world[:, parent] @ self.bone_directions[j]
        by_turn = np.swapaxes(world, 1, 2).reshape(frames * 3, 72) @ self.shape_offsets
        shaped = np.empty((frames, count, 3, shapes + 1))
        shaped[..., :-1] = np.swapaxes(by_turn.reshape(frames, 3, count, shapes), 1, 2)
        shaped[..., :-1] += (self.share @ moved.reshape(frames, 24, -1)).reshape(frames, count, 3, shapes)
        shaped[..., :-1] *= np.exp(state.log_scale)
        shaped[..., -1] = posed.points - state.trans[:, None]
        return shaped


def _joint_lists(chosen: np.ndarray) -> np.ndarray:
    """(K, 25) the numbers of the joints ``chosen`` (K, 24), ascending, then −1."""
    ordered = np.sort(np.where(chosen, np.arange(24), 24), axis=1)
    return np.append(np.where(ordered < 24, ordered, -1), np.full((len(chosen), 1), -1), axis=1)
