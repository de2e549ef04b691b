# SPDX-License-Identifier: Apache-2.0
"""Similarity of two postures: joint by joint for monocular bodies, else by limb directions from the detector's guess.

The guess is in metres, in axes along the ray to the person. Rotated with that ray and with the camera it gives the
directions of limbs, shoulders and face, left and right distinguished. It does not give the person's distance.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float

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


def joint_differences_rad(
    first: Float[np.ndarray, "... J 3"], second: Float[np.ndarray, "... J 3"]
) -> Float[np.ndarray, " ..."]:
    """Mean angle between the rotations of body joints, axis-angles, without the root (A06-A08); NaN where unknown."""
    return rotations.angle(rotations.exp(first), rotations.exp(second)).mean(-1)


def parameter_differences_rad(
    first: Float[np.ndarray, "... J 3"], second: Float[np.ndarray, "... J 3"]
) -> Float[np.ndarray, " ..."]:
    """‖θa − θb‖ of axis-angles over √J (paper, Eq. 1).

    As large as the mean angle where all joints differ equally, and larger where one axis-angle goes round the other
    way.
    """
    return np.linalg.norm(first - second, axis=(-2, -1)) / np.sqrt(first.shape[-2])


def limb_differences_rad(
    first: Float[np.ndarray, "... 12 3"], second: Float[np.ndarray, "... 12 3"]
) -> Float[np.ndarray, " ..."]:
    """Mean angle between limb directions, broadcast; NaN where either has none."""
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
    # The guess's z axis points at the middle of what is seen of the person.
    seen = found.keypoints[..., 2:] > 0
    pixels = np.where(seen, found.keypoints[..., :2], 0.0).sum(1) / np.maximum(seen.sum(1), 1)
    rays = np.column_stack([(pixels - camera.principal_px) / camera.focal_px, np.ones(len(pixels))])
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    camera_from_guess = np.array([rotations.turn_to_z(ray).T for ray in rays]).reshape(-1, 3, 3)
    return along @ np.swapaxes(camera.world_from_camera[:3, :3] @ camera_from_guess, -1, -2)
