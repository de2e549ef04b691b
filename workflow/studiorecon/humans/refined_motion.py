# SPDX-License-Identifier: Apache-2.0
"""The person's motion during training: joint rotations per frame, moved by image gradients.

The paper refines SMPL poses jointly with the Gaussians under a temporal smoothness term (appendix D, weight 50). Turns
are on SO(3): each step multiplies a small rotation from the left, so nothing wraps or needs an Euler angle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numba
import numpy as np

from studiorecon.body.skinning import world_from_rest
from studiorecon.geometry import rotations

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Shaped

FIRST_DECAY, SECOND_DECAY = 0.9, 0.99
# Joints whose turn moves almost no surface, or is invisible in pictures: they keep the fitted pose.
FIXED_JOINTS = (10, 11, 15, *range(22, 54))
"""Feet (toes), head, hands and fingers."""

_STORED = {
    "local": "local",
    "trans_m": "trans_m",
    "turn_first": "_first",
    "turn_second": "_second",
    "turn_steps": "_steps",
}


class RefinedMotion:
    """Local joint rotations (joint 0's in the world) and pelvis positions of T frames, with Adam's state per frame."""

    def __init__(
        self,
        poses: Float[np.ndarray, "T 3*J"],
        trans_m: Float[np.ndarray, "T 3"],
        rest_joints_m: Float[np.ndarray, "J 3"],
        parents: Integer[np.ndarray, " J"],
        held: Sequence[int] = FIXED_JOINTS,
    ) -> None:
        self.held = [joint for joint in held if joint < len(parents)]
        self.local = rotations.exp(np.asarray(poses, np.float64).reshape(len(poses), -1, 3))
        self.trans_m = np.asarray(trans_m, np.float64).copy()
        self.rest_joints_m, self.parents = rest_joints_m, parents
        self._joints = count = len(parents)
        self._subtree = np.eye(count, dtype=bool)
        for joint in range(count - 1, 0, -1):
            self._subtree[parents[joint]] |= self._subtree[joint]
        self._first, self._second = (np.zeros((len(self.local), count + 1, 3)) for _ in range(2))
        self._steps = np.zeros(len(self.local), np.int64)

    def arrays(self) -> dict[str, Shaped[np.ndarray, " ..."]]:
        """Rotations, positions and Adam's state, for a checkpoint."""
        return {name: getattr(self, attribute) for name, attribute in _STORED.items()}

    def resume(self, held: Mapping[str, Shaped[np.ndarray, " ..."]]) -> None:
        """Restore ``arrays``, in place."""
        for name, attribute in _STORED.items():
            getattr(self, attribute)[...] = held[name]

    @property
    def poses(self) -> Float[np.ndarray, "T 3*J"]:
        """Axis-angle."""
        return rotations.log(self.local).reshape(len(self.local), -1)

    def transforms(self, frame: int) -> Float[np.ndarray, "J 4 4"]:
        """World_from_rest of one frame."""
        world, joints = self._posed(frame)
        return world_from_rest(world, joints, self.rest_joints_m)[0]

    def _posed(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """World rotations (1, J, 3, 3) and joints (1, J, 3) of one frame."""
        world, joints = np.empty((1, self._joints, 3, 3)), np.empty((1, self._joints, 3))
        _down_the_tree(self.local[frame], self.rest_joints_m, self.parents, self.trans_m[frame], world[0], joints[0])
        return world, joints

    def gradient(
        self, frame: int, force: Float[np.ndarray, "J 3"], torque: Float[np.ndarray, "J 3"]
    ) -> Float[np.ndarray, "J+1 3"]:
        """Gradient by the turn of every joint in its parent's axes and, last, by the pelvis position
        (``bone_wrenches``)."""
        world, joints = (whole[0] for whole in self._posed(frame))
        total_force, total_torque = self._subtree @ force, self._subtree @ torque
        in_world = total_torque - np.cross(joints, total_force)
        gradient = np.zeros((self._joints + 1, 3))
        gradient[0] = in_world[0]
        gradient[1:-1] = np.einsum("jab,ja->jb", world[self.parents[1:]], in_world[1:])
        gradient[-1] = total_force[0]
        return gradient

    def smoothness_gradient(self, frame: int, weight: float) -> Float[np.ndarray, "J+1 3"]:
        """Gradient of weight · mean(squared geodesic first difference) + the same of translation in metres (U51)."""
        gradient = np.zeros((self._joints + 1, 3))
        for other in (frame - 1, frame + 1):
            if 0 <= other < len(self.local):
                # d|log(R_oᵀ exp(ω) R)|²/dω = 2 log(R R_oᵀ): the turn from the neighbour, in the parent's axes.
                turn = rotations.log(self.local[frame] @ np.swapaxes(self.local[other], -1, -2))
                gradient[:-1] += 2 * weight * turn / self._joints
                gradient[-1] += 2 * weight * (self.trans_m[frame] - self.trans_m[other])
        return gradient

    def step(self, frame: int, gradient: Float[np.ndarray, "J+1 3"], rate: float) -> None:
        """Do one step of Adam on one frame: ``rate`` radians per joint, metres for the pelvis; others stay (O04)."""
        gradient = np.where(np.isfinite(gradient), gradient, 0.0)
        gradient[self.held] = 0.0
        self._steps[frame] += 1
        first, second = self._first[frame], self._second[frame]
        first += (1 - FIRST_DECAY) * (gradient - first)
        second += (1 - SECOND_DECAY) * (gradient**2 - second)
        count = self._steps[frame]
        change = -rate * (first / (1 - FIRST_DECAY**count)) / (np.sqrt(second / (1 - SECOND_DECAY**count)) + 1e-12)
        self.local[frame] = rotations.project_to_so3(rotations.exp(change[:-1]) @ self.local[frame])
        self.trans_m[frame] += change[-1]


@numba.njit(cache=True)
def _down_the_tree(local, rest_joints_m, parents, root_m, world, joints):
    """``body.skinning.forward_kinematics`` of one frame: in Python it takes longer than posing all Gaussians."""
    for joint in range(len(local)):
        parent = parents[joint]
        for r in range(3):
            reach = root_m[r] if parent < 0 else joints[parent, r]
            for k in range(3):
                if parent < 0:
                    world[joint, r, k] = local[joint, r, k]
                    continue
                reach += world[parent, r, k] * (rest_joints_m[joint, k] - rest_joints_m[parent, k])
                world[joint, r, k] = (
                    world[parent, r, 0] * local[joint, 0, k]
                    + world[parent, r, 1] * local[joint, 1, k]
                    + world[parent, r, 2] * local[joint, 2, k]
                )
            joints[joint, r] = reach
