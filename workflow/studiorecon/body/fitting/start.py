# SPDX-License-Identifier: Apache-2.0
"""Initial pose of a fit: the pelvis in closed form from the torso's points, then each limb swung to its next point.

A gradient does not turn a body that faces the wrong way (M05), so nothing here is iterative.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.fitting import prior
from studiorecon.body.model import BodyModel
from studiorecon.body.skinning import forward_kinematics
from studiorecon.geometry import rotations

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# Points that move with the trunk, by the detector's and SMPL's names; then joint, its point, the next point down the
# limb.
_TORSO = ("shoulder", "hip", "shoulder_joint", "hip_joint")
_TORSO_MIDDLE = ("neck", "mid_hip", "upper_neck", "neck_joint", "pelvis_joint", "spine3_joint")
_SWINGS = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
# With fewer points than this, more stays unknown than known even with the prior.
_MIN_POINTS = 6
_FAR_M = 0.3


@dataclass(frozen=True)
class Start:
    """Local rotations, the pelvis in metres, and the frames in which they are determined."""

    local: Num[np.ndarray, "T 24 3 3"]
    trans_m: Num[np.ndarray, "T 3"]
    determined: Bool[np.ndarray, " T"]


def initial_pose(
    body: BodyModel, names: list[str], points_m: Num[np.ndarray, "T K 3"], seen: Bool[np.ndarray, "T K"]
) -> Start:
    """An initial pose of the mean shape from the ``seen`` keypoints; undetermined frames keep the relaxed pose."""
    frames = len(points_m)
    at = {n: k for k, n in enumerate(names)}
    local = np.tile(prior.mean_pose(), (frames, 1, 1, 1))
    share, anchors = body.keypoint_anchors(names)
    on_body = share, anchors[..., 0]
    relaxed = _keypoints_about_pelvis(body, on_body, local[:1])[0]
    torso = [k for n, k in at.items() if n in _TORSO_MIDDLE or n.partition("_")[2] in _TORSO]
    in_torso = np.zeros(len(names), dtype=bool)
    in_torso[torso] = True
    roots = [rotations.kabsch(relaxed, points_m, chosen) for chosen in (seen & in_torso, seen)]
    # Limbs bias the second root; the first is unreliable where only shoulders and neck are seen. The nearer body wins
    # per frame.
    best, misfit = Start(local, np.zeros((frames, 3)), np.zeros(frames, dtype=bool)), np.full(frames, np.inf)
    for turn, shift, determined in roots:
        swung = local.copy()
        swung[:, 0] = turn
        _swing_limbs(body, at, points_m, seen, swung)
        # Bounded, so that outliers do not decide.
        apart = np.minimum(
            np.linalg.norm(_keypoints_about_pelvis(body, on_body, swung) + shift[:, None] - points_m, axis=-1), _FAR_M
        )
        apart = np.where(seen, apart, 0.0).sum(1) / np.maximum(seen.sum(1), 1)
        better = determined & (apart < misfit)
        misfit = np.where(better, apart, misfit)
        best = Start(
            np.where(better[:, None, None, None], swung, best.local),
            np.where(better[:, None], shift, best.trans_m),
            best.determined | better,
        )
    return Start(best.local, best.trans_m, best.determined & (seen.sum(1) >= _MIN_POINTS))


def _keypoints_about_pelvis(body: BodyModel, on_body: tuple[np.ndarray, np.ndarray], local: np.ndarray) -> np.ndarray:
    """(T, K, 3) keypoints of the mean shape about its pelvis, from their shares (K, 24) and anchors (K, 24, 3)."""
    share, anchors = on_body
    rest = body.rest_joints(np.zeros(1))
    world, joints = forward_kinematics(local, rest, body.parents)
    return (np.swapaxes(anchors - share[..., None] * rest, 0, 1) @ np.swapaxes(world, -1, -2)).sum(1) + share @ joints


def _swing_limbs(
    body: BodyModel, at: dict[str, int], points_m: np.ndarray, seen: np.ndarray, local: np.ndarray
) -> None:
    """Turn hips, knees, shoulders and elbows of ``local`` so that each bone points at the next keypoint."""
    rest = body.rest_joints(np.zeros(1))
    for suffix in ("", "_joint"):
        for upper, lower in _SWINGS:
            for side in ("left_", "right_"):
                joint, child = body.names.index(side + upper), body.names.index(side + lower)
                own, following = at.get(f"{side}{upper}{suffix}"), at.get(f"{side}{lower}{suffix}")
                if own is None or following is None:
                    continue
                world = _world_rotation(local, body.parents, joint)
                target = points_m[:, following] - points_m[:, own]
                bone = world @ (rest[child] - rest[joint])
                known = seen[:, own] & seen[:, following] & (np.linalg.norm(target, axis=-1) > 1e-6)
                swung = np.swapaxes(world, -1, -2) @ swing(bone, np.where(known[:, None], target, bone)) @ world
                local[:, joint] = local[:, joint] @ swung


def _world_rotation(local: np.ndarray, parents: np.ndarray, joint: int) -> np.ndarray:
    """(T, 3, 3) world rotation of one joint: the product down its chain only."""
    world = local[:, joint]
    while parents[joint] >= 0:
        joint = int(parents[joint])
        world = local[:, joint] @ world
    return world


def swing(a: Num[np.ndarray, "T 3"], b: Num[np.ndarray, "T 3"]) -> Num[np.ndarray, "T 3 3"]:
    """Smallest rotations that take directions a to b; opposite directions turn about any perpendicular."""
    a, b = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (a, b))
    axis = np.cross(a, b)
    sine = np.linalg.norm(axis, axis=-1)
    # The coordinate axis least along a is never parallel to it.
    other = np.cross(a, np.eye(3)[np.argmin(np.abs(a), axis=-1)])
    opposite = (sine < 1e-9)[:, None]
    axis = np.where(
        opposite, other / np.linalg.norm(other, axis=-1, keepdims=True), axis / np.where(opposite, 1.0, sine[:, None])
    )
    return rotations.exp(axis * np.arctan2(sine, np.einsum("ti,ti->t", a, b))[:, None])
