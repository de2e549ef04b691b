# SPDX-License-Identifier: Apache-2.0
"""Similarity of two postures: joint by joint for monocular bodies, else by limb directions from the detector's guess.

The guess is in metres, in axes along the ray to the person. Rotated with that ray and with the camera it gives the
directions of limbs, shoulders and face, left and right distinguished. It does not give the person's distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.people.association.affinity import AssociationLimits
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

_LIMBS = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
# Points that are averaged for either end of a direction.
_DIRECTIONS = (
    *(((f"{side}_{a}",), (f"{side}_{b}",)) for side in ("left", "right") for a, b in _LIMBS),
    (("right_shoulder",), ("left_shoulder",)),
    (("right_hip",), ("left_hip",)),
    (("left_hip", "right_hip"), ("left_shoulder", "right_shoulder")),
    (("left_ear", "right_ear"), ("nose",)),
)
_NEEDED = {name for ends in _DIRECTIONS for end in ends for name in end}


@dataclass(frozen=True)
class Postures:
    """Postures of one camera's D detections, NaN where unknown.

    Attributes:
        joints: (D, 23, 3, 3) rotations of the monocular body's joints, or its axis-angles (D, 23, 3) as they are given.
        limbs: directions of limbs in the world.
    """

    joints: Float[np.ndarray, "D ..."]
    limbs: Float[np.ndarray, "D 12 3"]

    @staticmethod
    def of(found: Detections, camera: Camera, limits: AssociationLimits) -> Postures:
        """The postures of the detections of ``camera``."""
        joints = np.full((len(found.frame), 23, 3), np.nan) if found.body_pose is None else found.body_pose
        if limits.pose_distance == "angle":
            known = np.isfinite(joints).all((1, 2))
            matrices = rotations.exp(np.where(known[:, None, None], joints, 0.0))
            joints = np.where(known[:, None, None, None], matrices, np.nan)
        return Postures(joints, limb_directions(found, camera))

    @property
    def known(self) -> bool:
        """Whether any detection has a posture."""
        return bool(np.isfinite(self.joints).any() or np.isfinite(self.limbs).any())


def posture_differences_rad(
    first: Postures,
    i: Integer[np.ndarray, " ..."],
    second: Postures,
    j: Integer[np.ndarray, " ..."],
    limits: AssociationLimits,
) -> Float[np.ndarray, " ..."]:
    """Angle between the postures of detections ``i`` of one camera and ``j`` of another, broadcast: of body joints
    where both have bodies, else of limb directions; NaN where neither is known."""
    differences = joint_differences_rad if limits.pose_distance == "angle" else parameter_differences_rad
    joints = differences(first.joints[i], second.joints[j])
    return np.where(np.isfinite(joints), joints, limb_differences_rad(first.limbs[i], second.limbs[j]))


def joint_differences_rad(
    first: Float[np.ndarray, "... J 3 3"], second: Float[np.ndarray, "... J 3 3"]
) -> Float[np.ndarray, " ..."]:
    """Mean angle between body rotations (…, J, 3, 3) and (…, J, 3, 3), broadcast, without the root (A06-A08)."""
    return rotations.angle(first, second).mean(-1)


def parameter_differences_rad(
    first: Float[np.ndarray, "... J 3"], second: Float[np.ndarray, "... J 3"]
) -> Float[np.ndarray, " ..."]:
    """‖θa − θb‖ of axis-angles (…, J, 3) and (…, J, 3), broadcast, over √J (paper, Eq. 1).

    As large as the mean angle where all joints differ equally, and larger where one axis-angle goes round the other
    way.
    """
    return np.linalg.norm(first - second, axis=(-2, -1)) / np.sqrt(first.shape[-2])


def limb_differences_rad(
    first: Float[np.ndarray, "... 12 3"], second: Float[np.ndarray, "... 12 3"]
) -> Float[np.ndarray, " ..."]:
    """Mean angle between limb directions (…, 12, 3) and (…, 12, 3), broadcast; NaN where either has none."""
    sine = np.linalg.norm(np.cross(first, second), axis=-1)
    return np.arctan2(sine, (first * second).sum(-1)).mean(-1)


def limb_directions(found: Detections, camera: Camera) -> Float[np.ndarray, "D 12 3"]:
    """Unit directions of limbs in the world; NaN for detections without a guess."""
    names = LAYOUTS[found.layout].keypoints
    if found.points_m is None or not set(names) >= _NEEDED:
        return np.full((len(found.frame), len(_DIRECTIONS), 3), np.nan)
    middles = [[found.points_m[:, [names.index(name) for name in end]].mean(1) for end in ends] for ends in _DIRECTIONS]
    along = np.stack([to - start for start, to in middles], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        along = along / np.linalg.norm(along, axis=-1, keepdims=True)
    return along @ np.swapaxes(_world_from_guess(found, camera), -1, -2)


def _world_from_guess(found: Detections, camera: Camera) -> np.ndarray:
    """(D, 3, 3) rotation of the guess's axes, which point at the person, into the world's."""
    seen = found.keypoints[..., 2:] > 0
    count = seen.sum(1)
    middle = np.where(seen, found.keypoints[..., :2], 0.0).sum(1) / np.maximum(count, 1)
    focal, principal = camera.intrinsics[[0, 1], [0, 1]], camera.intrinsics[:2, 2]
    ray = np.column_stack([(middle - principal) / focal, np.ones(len(middle))])
    ray[count[:, 0] == 0] = [0.0, 0.0, 1.0]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    axis = np.column_stack([-ray[:, 1], ray[:, 0], np.zeros(len(ray))])  # z × ray
    sine = np.linalg.norm(axis, axis=1)
    turned = axis * (np.arctan2(sine, ray[:, 2]) / np.maximum(sine, 1e-12))[:, None]
    return camera.world_from_camera[:3, :3] @ rotations.exp(turned)
