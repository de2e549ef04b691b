# SPDX-License-Identifier: Apache-2.0
"""Linear blend skinning of Gaussians: means, orientations and SH into a pose, and gradients back from it.

The mean follows the blended matrix exactly. Orientation and view dependence follow its polar rotation, because a blend
of rotations is not a rotation (L05, U44). A collapsed blend (a half-half twist of 180°) has no polar factor; there the
bone with the largest weight decides (L04).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

MAX_SH_DEGREE = 2  # rotating degree 3 would need Wigner matrices; the paper's humans use degree 2


class Posing:
    """Buffers for posing the same N Gaussians many times; each row of ``weights`` sums to 1."""

    def __init__(self, bones: Integer[np.ndarray, "N K"], weights: Num[np.ndarray, "N K"]) -> None:
        count = len(bones)
        self.bones = np.ascontiguousarray(bones, np.uint8)
        self.weights = np.ascontiguousarray(weights, np.float32)
        self.linear, self.turn = np.empty((count, 3, 3)), np.empty((count, 3, 3))
        self._turn_quaternions = np.empty((count, 4))

    def out(
        self,
        means_m: Num[np.ndarray, "N 3"],
        quaternions: Num[np.ndarray, "N 4"],
        sh: Num[np.ndarray, "N C 3"],
        world_from_rest: Num[np.ndarray, "B 4 4"],
    ) -> tuple[Num[np.ndarray, "N 3"], Num[np.ndarray, "N 4"], Num[np.ndarray, "N C 3"]]:
        """Posed means, quaternions and SH, float32, for the bones' transforms."""
        from studiorecon.body.avatar import kernels

        posed = np.empty_like(means_m), np.empty_like(quaternions), np.empty_like(sh)
        transforms = np.ascontiguousarray(world_from_rest, np.float64)
        kept = self.linear, self.turn, self._turn_quaternions
        kernels.pose_gaussians(self.bones, self.weights, transforms, means_m, quaternions, sh, *kept, *posed)
        return posed

    def back(
        self,
        grad_means: Num[np.ndarray, "N 3"],
        grad_quaternions: Num[np.ndarray, "N 4"],
        grad_sh: Num[np.ndarray, "N C 3"],
    ) -> tuple[Num[np.ndarray, "N 3"], Num[np.ndarray, "N 4"], Num[np.ndarray, "N C 3"]]:
        """Gradients at the canonical Gaussians, for the pose of the last ``out``."""
        from studiorecon.body.avatar import kernels

        canonical = np.empty_like(grad_means), np.empty_like(grad_quaternions), np.empty_like(grad_sh)
        kept = self.linear, self.turn, self._turn_quaternions
        kernels.pull_back_gradients(grad_means, grad_quaternions, grad_sh, *kept, *canonical)
        return canonical

    def wrenches(
        self,
        means_m: Num[np.ndarray, "N 3"],
        grad_means: Num[np.ndarray, "N 3"],
        world_from_rest: Num[np.ndarray, "B 4 4"],
    ) -> tuple[Num[np.ndarray, "B 3"], Num[np.ndarray, "B 3"]]:
        """Force and torque on every bone; see ``bone_wrenches``."""
        from studiorecon.body.avatar import kernels

        force, torque = np.zeros((len(world_from_rest), 3)), np.zeros((len(world_from_rest), 3))
        transforms = np.ascontiguousarray(world_from_rest, np.float64)
        kernels.bone_wrenches(means_m, grad_means, self.bones, self.weights, transforms, force, torque)
        return force, torque
