# SPDX-License-Identifier: Apache-2.0
"""Fingers from 21 points of a hand over time, by the solver of the body.

The solver has 24 joints, and so has a hand here: the wrist with all of the hand's place and rotation, 15 finger joints,
5 tips, and 3 that nothing observes. Bones are the person's; one scale per hand stays free, because the body's shape is
of no finger's making. A finger that is not seen stays relaxed, and its deviation says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.fitting.fit import FitSettings, merge_points
from studiorecon.body.fitting.levenberg_marquardt import descend
from studiorecon.body.fitting.point_model import FitState
from studiorecon.body.fitting.prior import PosePrior, body_prior
from studiorecon.body.fitting.problem import PriorWeights, Problem
from studiorecon.body.fitting.start import swing
from studiorecon.body.hands import THUMB, finger_axes
from studiorecon.body.model import BodyModel
from studiorecon.body.skinning import forward_kinematics
from studiorecon.geometry import rotations
from studiorecon.geometry.smoothing import fill_rotations, fill_vectors
from studiorecon.keypoints.layouts import FINGER_NAMES, HAND_POINT_NAMES

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# Deviations of the twist, spread and flexion from the relaxed hand of a finger's three joints, and their limits; of
# healthy adults, radians. Only the root of a finger spreads; the thumb's root moves as a saddle does.
_DEVIATION = np.array([[0.05, 0.15, 0.5], [0.03, 0.03, 0.6], [0.03, 0.03, 0.4]])
_THUMB_DEVIATION = np.array([[0.2, 0.35, 0.35], [0.05, 0.1, 0.35], [0.03, 0.03, 0.45]])
_LOW = np.array([[-0.2, -0.45, -0.7], [-0.1, -0.1, -0.4], [-0.1, -0.1, -0.5]])
_HIGH = np.array([[0.2, 0.45, 1.5], [0.1, 0.1, 1.8], [0.1, 0.1, 1.3]])
_THUMB_LOW = np.array([[-0.5, -0.8, -0.7], [-0.2, -0.3, -0.6], [-0.1, -0.1, -0.7]])
_THUMB_HIGH = np.array([[0.5, 0.8, 0.9], [0.2, 0.3, 1.0], [0.1, 0.1, 1.4]])
_UNSEEN_RAD = 0.1  # of joints that move no point: any number, so that the equations have one solution
# Hands of equal bodies differ by a few per cent in length, but detectors draw curled hands up to a tenth too short: a
# looser scale follows the detector. Its points are 6 mm from the joints in each frame, and on average.
_SCALE_SIGMA, _POINT_SIGMA_M = 0.02, 0.006
# The palm's points, which start the fit: wrist and the roots of all fingers; three of them fix a hand.
_PALM = (0, 1, 5, 9, 13, 17)
_MIN_POINTS = 8
# An arm straighter than this (sine of the elbow's bend) has no plane in which it bends.
_STRAIGHT = 0.02
# A frame whose points are further off than half a palm's width (median) shows no hand of this person.
_MAX_FRAME_M = 0.04


@dataclass(frozen=True)
class HandFit:
    """One hand over T frames; frames without enough points are identity and not valid.

    Attributes:
        wrist, place_m: world rotations and places of the wrist joint.
        fingers: rotations relative to the parent, in SMPL-H's order.
        sigma_m: deviations of the wrist and the finger joints.
        residual_m: distance to the points, NaN where there was none.
        scale: length of the hand's bones relative to the body's.
    """

    valid: Bool[np.ndarray, " T"]
    wrist: Num[np.ndarray, "T 3 3"]
    place_m: Num[np.ndarray, "T 3"]
    fingers: Num[np.ndarray, "T 15 3 3"]
    sigma_m: Num[np.ndarray, "T 16"]
    residual_m: Num[np.ndarray, "T 21"]
    scale: float


def fit_hand(
    body: BodyModel,
    betas: Num[np.ndarray, " B"],
    side: int,
    points_m: Num[np.ndarray, "T 21 3"],
    sigma_m: Num[np.ndarray, "T 21"],
    settings: FitSettings,
) -> HandFit | None:
    """The left (0) or right (1) hand that best fits ``points_m``, NaN is not seen; None where no frame shows it."""
    hand, names = (
        _as_body(body.with_fingers, betas, side),
        [f"{n.removesuffix('_joint')}_joint" for n in HAND_POINT_NAMES[side]],
    )
    seen = np.isfinite(points_m).all(-1) & np.isfinite(sigma_m)
    rest = hand.keypoints(names, np.zeros((1, 72)), np.zeros(1), np.zeros((1, 3)))[0]
    palm = seen & np.isin(np.arange(21), _PALM)
    turn, shift, determined = rotations.kabsch(rest, np.where(seen[..., None], points_m, 0.0), palm)
    valid = determined & (palm.sum(1) >= 3) & (seen.sum(1) >= _MIN_POINTS)
    if not valid.any():
        return None
    options = replace(settings, point_sigma_m=_POINT_SIGMA_M, correction_sigma_m=_POINT_SIGMA_M, beta_weight=1.0)
    weights = PriorWeights(
        options.huber_units,
        options.pose_weight,
        options.limit_weight,
        options.beta_weight,
        options.correction_sigma_m,
        False,
    )
    evidence = merge_points(hand, names, points_m[valid], sigma_m[valid], options, None)
    problem = Problem(hand, evidence, weights, _prior(body, side))
    local = np.tile(np.eye(3), (valid.sum(), 24, 1, 1))
    local[:, 0] = turn[valid]
    state = FitState(local, shift[valid], np.zeros(1), 0.0, np.zeros((21, 3)))
    state, equations, _, _ = descend(problem, state, options.iterations, options.tolerance)
    _, joint_sigma, *_ = equations.posterior(state)
    found = HandFit(
        valid,
        np.tile(np.eye(3), (len(valid), 1, 1)),
        np.zeros((len(valid), 3)),
        np.tile(np.eye(3), (len(valid), 15, 1, 1)),
        np.full((len(valid), 16), np.inf),
        np.full((len(valid), 21), np.nan),
        1.0 + _SCALE_SIGMA * float(state.betas[0]),
    )
    found.wrist[valid], found.place_m[valid], found.fingers[valid] = (
        state.local[:, 0],
        state.trans,
        state.local[:, 1:16],
    )
    found.sigma_m[valid] = joint_sigma[:, :16]
    apart = np.linalg.norm(problem.model.points(state) - evidence.targets_m, axis=-1)
    found.residual_m[valid] = np.where(seen[valid], apart, np.nan)
    near = valid.copy()
    near[valid] = np.nanmedian(found.residual_m[valid], axis=1) <= _MAX_FRAME_M
    found.sigma_m[~near] = np.inf
    return replace(found, valid=near) if near.any() else None


def attach_hands(
    body: BodyModel,
    betas: Num[np.ndarray, " B"],
    local: Num[np.ndarray, "T 24 3 3"],
    trans_m: Num[np.ndarray, "T 3"],
    sigma_m: Num[np.ndarray, "T 24"],
    hands: Sequence[HandFit | None],
) -> tuple[Num[np.ndarray, "T 54 3 3"], Num[np.ndarray, "T 54"], Num[np.ndarray, " 2"]]:
    """The body's rotations and joints' deviations with those of the hands, and the hands' scales.

    Fingers come after the 24, wrists are turned, forearms twisted. A finger's joint is as unsure as its wrist and its
    place in the hand together.

    A hand fixes the twist between elbow and wrist, which the body's points do not see; both share it as their priors
    allow. Frames without a hand are interpolated; a hand that is None stays relaxed.
    """
    fingers, unsure = np.tile(np.eye(3), (len(local), 2, 15, 1, 1)), np.full((len(local), 2, 15), np.inf)
    local, looseness = local.copy(), 1 / body_prior().precision[18:22, 0]
    rest = body.rest_joints(betas)
    for side, hand in enumerate(hands):
        if hand is None:
            continue
        elbow, wrist, knuckles = 18 + side, 20 + side, 22 + side
        _reach(body, local, rest, trans_m, sigma_m[:, wrist], (13 + side, 16 + side, elbow, wrist), hand)
        world = forward_kinematics(local, rest, body.parents)[0][:, elbow]
        turned = np.swapaxes(world, -1, -2) @ hand.wrist
        arm = (rest[wrist] - rest[elbow]) / np.linalg.norm(rest[wrist] - rest[elbow])
        quaternion = rotations.to_quaternion(turned)
        twist = 2 * np.arctan2(quaternion[:, 1:] @ arm, quaternion[:, 0])
        twist[hand.valid] = np.unwrap((twist[hand.valid] + np.pi) % (2 * np.pi) - np.pi)
        share = looseness[side] / (looseness[side] + looseness[2 + side])
        forearm = rotations.exp(share * fill_vectors(twist, hand.valid)[:, None] * arm)
        local[:, elbow] = local[:, elbow] @ forearm
        local[:, wrist] = fill_rotations(np.swapaxes(forearm, -1, -2) @ turned, hand.valid)
        local[:, knuckles] = np.eye(3)
        fingers[:, side] = fill_rotations(hand.fingers, hand.valid)
        unsure[:, side] = np.hypot(hand.sigma_m[:, 1:], sigma_m[:, wrist, None])
    return (
        np.concatenate([local, fingers.reshape(len(local), 30, 3, 3)], axis=1),
        np.concatenate([sigma_m, unsure.reshape(len(local), 30)], axis=1),
        np.array([hand.scale if hand else 1.0 for hand in hands]),
    )


def _reach(
    body: BodyModel,
    local: np.ndarray,
    rest: np.ndarray,
    trans_m: np.ndarray,
    sigma_m: np.ndarray,
    arm: tuple[int, int, int, int],
    hand: HandFit,
) -> None:
    """Bend and swing the ``arm`` (collar to wrist) of ``local`` to a wrist between the body's and the hand's.

    Each weighs as its deviation says.
    """
    collar, shoulder, elbow, wrist = arm
    world, joints = forward_kinematics(local, rest, body.parents)
    upper, lower = joints[:, elbow] - joints[:, shoulder], joints[:, wrist] - joints[:, elbow]
    known = hand.valid & np.isfinite(sigma_m)
    trust = sigma_m[known] ** 2 / (sigma_m[known] ** 2 + hand.sigma_m[known, 0] ** 2)
    target = upper + lower
    target[known] += trust[:, None] * (hand.place_m - trans_m - joints[:, wrist])[known]
    # The elbow's angle that makes the arm as long as the target is far, then the arm's direction.
    a, b = np.linalg.norm(upper, axis=1), np.linalg.norm(lower, axis=1)
    wanted = np.arccos(np.clip((a**2 + b**2 - (target**2).sum(1)) / (2 * a * b), -1, 1))
    hinge = np.cross(upper, lower)
    sine = np.linalg.norm(hinge, axis=1)
    bent = np.pi - np.arctan2(sine, (upper * lower).sum(1))
    known &= sine > _STRAIGHT * a * b
    axis = np.where(known[:, None], hinge / np.maximum(sine, 1e-12)[:, None], [1.0, 0.0, 0.0])
    bend = rotations.exp(np.where(known, bent - wanted, 0.0)[:, None] * axis)
    reached = upper + (bend @ lower[..., None])[..., 0]
    swung = swing(reached, np.where(known[:, None], target, reached))
    for joint, above, turn in ((elbow, shoulder, bend), (shoulder, collar, swung)):
        turned = np.swapaxes(world[:, above], -1, -2) @ turn @ world[:, above] @ local[:, joint]
        local[known, joint] = turned[known]


def _as_body(body: BodyModel, betas: np.ndarray, side: int) -> BodyModel:
    """A hand as a body of 24 joints about its wrist, whose only beta is its scale; ``body`` has 54 joints."""
    tips = [name for name in HAND_POINT_NAMES[side] if name.endswith("4")]
    own = FINGER_NAMES[15 * side : 15 * side + 15]
    names = (HAND_POINT_NAMES[side][0].removesuffix("_joint"), *own, *tips, "unseen1", "unseen2", "unseen3")
    parents = [-1, *(j if j % 3 else 0 for j in range(15)), *(own.index(f"{tip[:-1]}3") + 1 for tip in tips), 0, 0, 0]
    rest = body.rest_joints(betas)
    at = dict(zip(body.names, rest))
    at |= dict(zip(tips, body.keypoints(tips, np.zeros((1, 162)), betas, rest[:1])[0]))
    joints = np.array([at.get(name, at[names[0]]) for name in names]) - at[names[0]]
    return replace(
        body,
        names=names,
        parents=np.array(parents),
        template_m=np.zeros((0, 3)),
        shape_directions=np.zeros((0, 3, 1)),
        joint_template_m=joints,
        joint_directions=_SCALE_SIGMA * joints[..., None],
        weights=np.zeros((0, 24), np.float32),
        pose_directions=None,
        keypoint_names=tuple(f"{name}_joint" for name in names),
        keypoint_vertices=np.zeros((24, 0)),
        keypoint_joints=np.eye(24),
    )


def _prior(body: BodyModel, side: int) -> PosePrior:
    """A relaxed hand: that of the body's rest pose."""
    order = np.where(np.arange(5)[:, None, None] == THUMB, 1, 0)
    deviation, low, high = (
        np.where(order, thumb, finger).reshape(15, 3)
        for finger, thumb in ((_DEVIATION, _THUMB_DEVIATION), (_LOW, _THUMB_LOW), (_HIGH, _THUMB_HIGH))
    )
    axes = np.tile(np.eye(3), (24, 1, 1))
    axes[1:16] = np.repeat(finger_axes(body)[side], 3, axis=0)

    def with_others(values: np.ndarray, wrist: float, others: float) -> np.ndarray:
        return np.concatenate([np.full((1, 3), wrist), values, np.full((8, 3), others)])

    return PosePrior(
        np.tile(np.eye(3), (24, 1, 1)),
        1 / with_others(deviation, np.inf, _UNSEEN_RAD) ** 2,
        with_others(low, -np.inf, -np.inf),
        with_others(high, np.inf, np.inf),
        axes,
    )
