# SPDX-License-Identifier: Apache-2.0
"""Fingers from points: accuracy, fingers that no camera sees, wrists, files, and Gaussians that follow."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.body.fitting import fit as fitting
from studiorecon.body.fitting.hands import attach_hands, fit_hand
from studiorecon.body.hands import posed_skeleton, scale_hands
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person, write_person
from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import HAND_POINT_NAMES
from studiorecon.scene.people import Person
from studiorecon.studio.hand_motion import finger_poses

FRAMES = 20
SETTINGS = fitting.FitSettings(30, 1e-4, 0.008, 0.015, 3.0, 1.0, 1.0, 1.0, 0.0, "shared", False)


@pytest.fixture(scope="module")
def body(root: Path) -> BodyModel:
    return BodyModel.load(root / "resources/body.npz")


@pytest.fixture(scope="module")
def person(body: BodyModel) -> Person:
    """Someone with small hands who turns the forearms, the wrists and all fingers."""
    times_s = np.arange(FRAMES) / 15
    poses = np.zeros((FRAMES, 72))
    for joint, most in ((18, 0.6), (19, -0.6), (20, 0.4), (21, -0.4)):
        poses[:, 3 * joint] = most * np.sin(times_s)
        poses[:, 3 * joint + 2] = 0.3 * np.cos(times_s)
    scale, fingers = np.array([0.97, 0.97]), finger_poses(body, 3, times_s)
    joints = scale_hands(body, scale).joints(np.concatenate([poses, fingers], 1), np.zeros(10), np.zeros((FRAMES, 3)))
    sure, valid = np.zeros((FRAMES, 24)), np.ones(FRAMES, bool)
    about = poses, np.zeros((FRAMES, 3)), np.zeros(10), joints[:, :24], valid, sure, True
    hands = {"hand_poses": fingers, "hand_joints": joints[:, 24:], "hand_scale": scale}
    return Person("p0", body.identity, 15.0, *about, hand_sigma=np.zeros((FRAMES, 30)), **hands)


def points_of(person: Person, body: BodyModel, side: int) -> np.ndarray:
    skeleton, poses = posed_skeleton(person, body)
    return skeleton.keypoints(HAND_POINT_NAMES[side], poses, person.betas, person.trans)


@pytest.mark.parametrize("side", [0, 1])
def test_noisy_points_give_fingers_wrist_and_size(body: BodyModel, person: Person, side: int) -> None:
    noise = np.random.default_rng(side).normal(0, 0.006, (FRAMES, 21, 3))
    hand = fit_hand(
        body, person.betas, side, points_of(person, body, side) + noise, np.full((FRAMES, 21), 0.006), SETTINGS
    )
    assert hand is not None
    assert hand.valid.all()
    assert 0.96 < hand.scale < 0.998
    skeleton, poses = posed_skeleton(person, body)
    true = rotations.exp(poses.reshape(FRAMES, 54, 3))
    world = true[:, 16 + side] @ true[:, 18 + side] @ true[:, 20 + side]
    assert np.degrees(np.median(rotations.angle(hand.wrist, world))) < 8
    fitted = poses.copy().reshape(FRAMES, 54, 3)
    fitted[:, 24 + 15 * side : 39 + 15 * side] = rotations.log(hand.fingers)
    joints = skeleton.joints(fitted.reshape(FRAMES, -1), person.betas, person.trans)[:, 24:]
    apart_mm = 1000 * np.linalg.norm(joints - person.hand_joints, axis=-1)[:, 15 * side : 15 * side + 15]
    assert np.median(apart_mm) < 6


def test_a_finger_that_is_not_seen_stays_within_limits_and_is_less_sure(body: BodyModel, person: Person) -> None:
    points = points_of(person, body, 0)
    points[:, [6, 7, 8]] = np.nan
    points[:3] = np.nan
    hand = fit_hand(body, person.betas, 0, points, np.full((FRAMES, 21), 0.003), SETTINGS)
    assert hand is not None
    assert hand.valid.tolist() == [False] * 3 + [True] * (FRAMES - 3)
    assert (hand.sigma_m[3:, 2] > 2 * hand.sigma_m[3:, 5]).all()
    assert np.isinf(hand.sigma_m[:3]).all()
    assert rotations.angle(hand.fingers[3:, 1], np.eye(3)).max() < 0.3


def test_points_of_something_else_are_no_hand(body: BodyModel, person: Person) -> None:
    scattered = np.random.default_rng(0).normal(0, 0.3, (FRAMES, 21, 3))
    assert fit_hand(body, person.betas, 0, scattered, np.full((FRAMES, 21), 0.003), SETTINGS) is None
    assert fit_hand(body, person.betas, 0, scattered * np.nan, np.full((FRAMES, 21), np.inf), SETTINGS) is None


def test_attached_hands_turn_forearms_and_leave_the_arms_where_they_were(body: BodyModel, person: Person) -> None:
    hands = [
        fit_hand(body, person.betas, s, points_of(person, body, s), np.full((FRAMES, 21), 0.002), SETTINGS)
        for s in (0, 1)
    ]
    hands[1] = replace(hands[1], valid=hands[1].valid & (np.arange(FRAMES) != 7))
    local = rotations.exp(person.poses.reshape(FRAMES, 24, 3))
    untwisted = local.copy()
    untwisted[:, 18:22] = rotations.exp(person.poses.reshape(FRAMES, 24, 3)[:, 18:22] * [0, 1, 1])
    whole, sigma_m, scale = attach_hands(body, person.betas, untwisted, person.trans, person.sigma, hands)
    skeleton = scale_hands(body, scale)
    joints = skeleton.joints(rotations.log(whole).reshape(FRAMES, -1), person.betas, person.trans)
    before = body.joints(rotations.log(untwisted).reshape(FRAMES, -1), person.betas, person.trans)
    assert np.abs(joints[:, :22] - before[:, :22]).max() < 1e-9
    wrists = [20] * 15 + [21] * 15
    in_hand = np.linalg.norm(
        joints[:, 24:] - joints[:, wrists] - person.hand_joints + person.joints[:, wrists], axis=-1
    )
    assert np.median(in_hand) < 0.008
    assert in_hand[7].max() < 0.03
    assert sigma_m.shape == (FRAMES, 54)
    turns = rotations.angle(whole[:, 18], untwisted[:, 18])
    assert turns.max() > 0.2


def test_a_person_with_fingers_is_read_back(body: BodyModel, person: Person, tmp_path: Path) -> None:
    write_person(tmp_path / "p0.npz", person)
    back = read_person(tmp_path / "p0.npz")
    for name in ("hand_poses", "hand_joints", "hand_sigma", "hand_scale", "poses"):
        np.testing.assert_array_equal(getattr(back, name), getattr(person, name))
    write_person(
        tmp_path / "p0.npz", replace(person, hand_poses=None, hand_joints=None, hand_sigma=None, hand_scale=None)
    )
    with np.load(tmp_path / "p0.npz") as plain:
        assert not [name for name in plain if name.startswith("hand")]
