# SPDX-License-Identifier: Apache-2.0
"""The fingers of a body file, and the body with 54 joints that they make of one with 24."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.keypoints.layouts import FINGER_NAMES, HAND_POINT_NAMES

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

    from studiorecon.body.model import BodyModel


@dataclass(frozen=True)
class Fingers:
    """What turns a body of 24 joints into one whose fingers move.

    Attributes:
        template_m, directions: rest joints, and metres per unit of beta, in the order of ``FINGER_NAMES``.
        vertices, joints, shares: vertices on fingers, the joints of each, and their shares of the hand's weight.
        tips: vertices whose mean is the tip of each finger, left hand first, fingers in the joints' order.
    """

    template_m: Num[np.ndarray, "30 3"]
    directions: Num[np.ndarray, "30 3 B"]
    vertices: Integer[np.ndarray, " N"]
    joints: Integer[np.ndarray, "N 3"]
    shares: Num[np.ndarray, "N 3"]
    tips: Integer[np.ndarray, "10 M"]


def add_fingers(body: BodyModel, own: Fingers) -> BodyModel:
    """The body with 30 finger joints after its own, whose skin is taken from the hands'; see ``with_fingers``."""
    names, first = body.names + FINGER_NAMES, len(body.names)
    parents = [
        first + j - 1 if j % 3 else body.names.index(f"{n.split('_')[0]}_hand") for j, n in enumerate(FINGER_NAMES)
    ]
    weights: np.ndarray = np.zeros((body.vertex_count, len(names)), np.float32)
    weights[:, :first] = body.weights
    hands = np.array([body.names.index(f"{side}_hand") for side in ("left", "right")])
    moved = body.weights[own.vertices][:, hands].sum(1)
    weights[np.ix_(own.vertices, hands)] = 0.0
    for k in range(own.joints.shape[1]):
        weights[own.vertices, first + own.joints[:, k]] = moved * own.shares[:, k]
    points = [point for side in HAND_POINT_NAMES for point in side[1:]]
    on_vertices = np.zeros((len(points), body.vertex_count))
    on_joints = np.zeros((len(body.keypoint_names) + len(points), len(names)))
    on_joints[: len(body.keypoint_names), :first] = body.keypoint_joints
    for k, point in enumerate(points):
        if point in FINGER_NAMES:
            on_joints[len(body.keypoint_names) + k, names.index(point)] = 1.0
        else:
            tip = own.tips[FINGER_NAMES.index(f"{point[:-1]}3") // 3]
            on_vertices[k, tip] = 1 / len(tip)
    return replace(
        body,
        names=names,
        parents=np.append(body.parents, parents),
        joint_template_m=np.concatenate([body.joint_template_m, own.template_m]),
        joint_directions=np.concatenate([body.joint_directions, own.directions]),
        weights=weights,
        keypoint_names=(*body.keypoint_names, *points),
        keypoint_vertices=np.concatenate([body.keypoint_vertices, on_vertices]),
        keypoint_joints=on_joints,
        fingers=None,
    )
