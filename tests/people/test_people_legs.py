# SPDX-License-Identifier: Apache-2.0
"""Somebody at a table, whose legs no camera shows: the body sits, its feet stand on the floor, and what is guessed is
marked."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.body.fitting import prior
from studiorecon.body.model import BodyModel
from studiorecon.configuration import settings as settings_module
from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import JOINT_NAMES, LAYOUTS
from studiorecon.people import fit
from studiorecon.people.fitting.legs import bend_hidden_legs
from studiorecon.people.fitting.points import Points

FRAMES = 12
LEGS = [JOINT_NAMES.index(f"{s}_{j}") for s in ("left", "right") for j in ("knee", "ankle", "foot")]


def posed(body: BodyModel, pelvis_m: float, bend: float, hidden: tuple[str, ...]) -> tuple[Points, np.ndarray]:
    """Keypoints of somebody upright with hips and knees bent by ``bend``, those of ``hidden`` unknown; and the true
    joints."""
    pose = rotations.log(prior.mean_pose()).reshape(24, 3).copy()
    for side in ("left", "right"):
        pose[JOINT_NAMES.index(f"{side}_hip")] = [-bend, 0, 0]
        pose[JOINT_NAMES.index(f"{side}_knee")] = [bend, 0, 0]
    pose[0] = [np.pi / 2, 0, 0]
    poses, trans = np.tile(pose.reshape(1, 72), (FRAMES, 1)), np.tile([0.3, 0.2, pelvis_m], (FRAMES, 1))
    names = [n for n in LAYOUTS["body_25"].keypoints if n in body.keypoint_names]
    points = body.keypoints(names, poses, np.zeros(10), trans) + np.random.default_rng(0).normal(
        0, 0.01, (FRAMES, len(names), 3)
    )
    unseen = [i for i, n in enumerate(names) if any(part in n for part in hidden)]
    sigma = np.full(points.shape[:2], 0.01)
    points[:, unseen], sigma[:, unseen] = np.nan, np.inf
    return Points(names, points, sigma, np.full(FRAMES, 4)), body.joints(poses, np.zeros(10), trans)


@pytest.mark.parametrize(
    "hidden", [("knee", "ankle", "toe", "heel"), ("hip", "knee", "ankle", "toe", "heel")], ids=["legs", "hips too"]
)
def test_unseen_legs_of_somebody_who_sits_are_bent_and_marked(root, default_settings, capsys, hidden) -> None:
    body = BodyModel.load(root / "resources" / "body.npz")
    settings = settings_module.load(fit.Settings, default_settings("people"), "people")
    points, true = posed(body, 0.48, np.pi / 2, hidden)
    person, _ = fit.fit_person("p0", points, body, 30.0, settings)
    assert person.valid.all()
    assert (
        np.linalg.norm(person.joints - true, axis=-1)[:, LEGS].mean() < 0.12
    )  # straight legs: 0.3 to 0.6 m, through the floor
    assert person.joints[..., 2].min() > -0.1
    arms = [JOINT_NAMES.index(f"{s}_{j}") for s in ("left", "right") for j in ("shoulder", "elbow", "wrist")]
    assert person.sigma[:, LEGS].min() > 5 * person.sigma[:, arms].max()
    assert "the legs in 12 frames" in capsys.readouterr().out


def test_legs_that_are_seen_or_reach_the_floor_stay_as_they_are(root) -> None:
    body = BodyModel.load(root / "resources" / "body.npz")
    local = np.tile(rotations.exp(np.eye(24, 3) * [[np.pi / 2], *[[0.0]] * 23]), (3, 1, 1, 1))
    standing, sunk = np.tile([0, 0, 0.95], (3, 1)), np.tile([0, 0, 0.5], (3, 1))
    names, unknown = ["left_knee", "right_knee"], np.full((3, 2, 3), np.nan)
    assert not bend_hidden_legs(local, standing, np.zeros(10), names, unknown, body)[1].any()
    seen = np.where(np.arange(2)[:, None] == 0, 0.1, unknown)
    bent_local, bent = bend_hidden_legs(local, sunk, np.zeros(10), names, seen, body)
    assert bent.tolist() == [[False, True]] * 3
    left = [JOINT_NAMES.index(f"left_{j}") for j in ("hip", "knee", "ankle", "foot")]
    np.testing.assert_array_equal(bent_local[:, left], local[:, left])
