# SPDX-License-Identifier: Apache-2.0
"""How fingers bend: the axes of their joints, and a person's skeleton with fingers where it has them.

Angles of a finger joint are about three axes of its rest pose: its bone (twist), the back of the hand (spread, towards
the thumb) and the knuckle (flexion, towards the palm). The right hand's angles are the mirrored left hand's.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.scene.people import Person

if TYPE_CHECKING:
    from jaxtyping import Num

THUMB = 4
"""Place of the thumb among a hand's five fingers in SMPL-H's order."""


def posed_skeleton(person: Person, body: BodyModel) -> tuple[BodyModel, Num[np.ndarray, "T 3*J"]]:
    """The body with its poses: 24 joints, or 54 where the person has fingers."""
    if person.hand_poses is None:
        return body, person.poses
    assert person.hand_scale is not None
    return scale_hands(body, person.hand_scale), np.concatenate([person.poses, person.hand_poses], axis=1)


def scale_hands(body: BodyModel, scales: Num[np.ndarray, " 2"]) -> BodyModel:
    """The body of 54 joints whose left and right hand are ``scales`` times as large about the wrists."""
    whole = body.with_fingers
    parts = {
        "joints": [whole.joint_template_m.copy(), whole.joint_directions.copy()],
        "surface": [whole.template_m.copy(), whole.shape_directions.copy()],
    }
    for side, scale in enumerate(scales):
        wrist, own = 20 + side, [20 + side, 22 + side, *range(24 + 15 * side, 39 + 15 * side)]
        of_joints = np.isin(np.arange(len(whole.names)), own).astype(np.float64)
        longer = (scale - 1) * of_joints, (scale - 1) * whole.weights[:, own].sum(1, dtype=np.float64)
        # Template and directions alike: lengths are linear in both.
        for factor, arrays in zip(longer, parts.values()):
            for array, joints in zip(arrays, (whole.joint_template_m, whole.joint_directions)):
                array += factor.reshape(-1, *(1,) * (array.ndim - 1)) * (array - joints[wrist])
    (joint_template, joint_directions), (template, directions) = parts.values()
    return replace(
        whole,
        joint_template_m=joint_template,
        joint_directions=joint_directions,
        template_m=template,
        shape_directions=directions,
    )


def finger_axes(body: BodyModel) -> Num[np.ndarray, "2 5 3 3"]:
    """Twist, spread and flexion axes, as columns, of every finger of the left and the right hand.

    Fingers curl towards the palm, which faces down in the T-pose; the thumb curls across it to the little finger.
    """
    whole = body.with_fingers
    joints = whole.joint_template_m[24:39].reshape(5, 3, 3)
    bones = joints[:, 2] - joints[:, 0]
    towards = np.tile([0.0, -1.0, 0.0], (5, 1))
    towards[THUMB] = joints[2, 0] - joints[THUMB, 2]
    twist = bones / np.linalg.norm(bones, axis=1, keepdims=True)
    flexion = np.cross(twist, towards)
    flexion /= np.linalg.norm(flexion, axis=1, keepdims=True)
    left = np.stack([twist, np.cross(flexion, twist), flexion], axis=-1)
    return np.stack([left, np.diag([1.0, -1.0, -1.0]) @ left])
