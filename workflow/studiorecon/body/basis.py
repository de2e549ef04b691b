# SPDX-License-Identifier: Apache-2.0
"""Keypoints and joints as functions of pose, position, shape and scale, with their derivatives, without the mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.body.skinning import forward_kinematics
from studiorecon.geometry import rotations


@dataclass(frozen=True)
class State:
    local: np.ndarray  # (F, 24, 3, 3)
    trans: np.ndarray  # (F, 3)
    betas: np.ndarray  # (B,)
    log_scale: float
    corrections: np.ndarray  # (K, 3) metres, detector's point minus the body's, in the axes of the joint that carries it most

    @property
    def shared(self) -> np.ndarray:
        """(S,) what all frames share: betas, log scale, corrections."""
        return np.concatenate([self.betas, [self.log_scale], self.corrections.reshape(-1)])

    def moved(self, local_turn: np.ndarray, shift: np.ndarray, shared: np.ndarray) -> State:
        """The state after small turns (F, 24, 3) about the joints' own axes, shifts (F, 3) and a change (S,) of what is shared."""
        count = len(self.betas)
        return State(
            self.local @ rotations.exp(local_turn),
            self.trans + shift,
            self.betas + shared[:count],
            self.log_scale + float(shared[count]),
            self.corrections + shared[count + 1 :].reshape(-1, 3),
        )


@dataclass(frozen=True)
class Linear:
    """Posed keypoints and what their derivatives are made of."""

    points: np.ndarray  # (F, K, 3)
    turned: np.ndarray  # (F, K, 24, 3): D
    shaped: np.ndarray  # (F, K, 3, B + 1): by betas and log scale
    carried: np.ndarray  # (F, K, 3, 3): each point by its own correction
    world: np.ndarray  # (F, 24, 3, 3)


class Basis:
    """Keypoints (or joints) as a function of the state, with derivatives; see ``BodyModel.keypoint_basis``.

    ``corrected`` says whether the state's corrections belong to these points (they do not belong to the joints).
    """

    def __init__(self, body: BodyModel, share: np.ndarray, anchors: np.ndarray, ancestors: np.ndarray, corrected: bool) -> None:
        self.corrected = corrected
        self.carrier = share.argmax(1)  # (K,)
        self.body, self.share, self.ancestors = body, share, ancestors
        skeleton = np.concatenate([body.joint_template_m[..., None], body.joint_directions], axis=-1)
        # (24, K, 3, 1 + B): what each joint's rotation acts on, as a function of (1, betas).
        self.offsets = np.moveaxis(anchors - share[:, :, None, None] * skeleton, 0, 1)
        self.subtree_share = ancestors @ share.T  # (24, K)
        bones = body.joint_directions - body.joint_directions[np.maximum(body.parents, 0)]
        self.bone_directions = bones

    def points(self, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Points (F, K, 3), their parts per joint (F, 24, K, 3), G, and posed joints about the pelvis, unscaled."""
        world, joints = forward_kinematics(state.local, self.body.rest_joints(state.betas), self.body.parents)
        offsets = self.offsets @ np.append(1.0, state.betas)  # (24, K, 3)
        if self.corrected:
            offsets[self.carrier, range(len(self.carrier))] += state.corrections
        parts = offsets @ np.swapaxes(world, -1, -2) + self.share.T[..., None] * joints[:, :, None]
        points = np.exp(state.log_scale) * parts.sum(1) + state.trans[:, None]
        return points, parts, world, joints

    def linear(self, state: State) -> Linear:
        points, parts, world, joints = self.points(state)
        frames, _, count, _ = parts.shape
        scale = np.exp(state.log_scale)
        below = (self.ancestors @ parts.reshape(frames, 24, -1)).reshape(parts.shape)
        turned = scale * np.swapaxes(below - self.subtree_share[..., None] * joints[:, :, None], 1, 2)
        shapes = self.body.shapes
        moved = np.zeros((frames, 24, 3, shapes))
        for j, parent in enumerate(self.body.parents):
            if parent >= 0:
                moved[:, j] = moved[:, parent] + world[:, parent] @ self.bone_directions[j]
        by_turn = np.swapaxes(world, 1, 2).reshape(frames, 3, 72) @ np.swapaxes(self.offsets[..., 1:], 1, 2).reshape(72, count * shapes)
        by_shape = np.swapaxes(by_turn.reshape(frames, 3, count, shapes), 1, 2)
        by_shape = by_shape + (self.share @ moved.reshape(frames, 24, -1)).reshape(frames, count, 3, shapes)
        by_scale = (points - state.trans[:, None])[..., None]
        # Each correction moves its own point only, by its joint's rotation.
        carried = scale * world[:, self.carrier] if self.corrected else np.zeros((frames, 0, 3, 3))
        return Linear(points, turned, np.concatenate([scale * by_shape, by_scale], axis=-1), carried, world)
