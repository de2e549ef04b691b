# SPDX-License-Identifier: Apache-2.0
"""A world that leans is told by the people who stand in it."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.geometry.camera_motion import move_camera
from studiorecon.geometry.rotations import exp
from studiorecon.rig.correspondences import make_observations
from studiorecon.rig.gravity import check_tilt, people_tilt
from studiorecon.scene.camera import Camera

from tests.made.cameras import LIMITS, detect, ring, walk


def leaning(cameras: list[Camera], degrees: float) -> list[Camera]:
    """The same cameras in a world that is turned about x by so much."""
    turn = exp(np.radians([degrees, 0.0, 0.0]))
    return [move_camera(c, c.camera_from_world[:3, :3] @ turn.T, turn @ c.centre_m) for c in cameras]


@pytest.mark.parametrize("degrees", [0.0, 8.0, 20.0, 90.0, 180.0])
def test_people_tell_by_how_much_the_world_leans(degrees: float, caplog: pytest.LogCaptureFixture) -> None:
    cameras = ring()
    people = [
        walk(np.array([0.5, -1.0, 0]), np.array([0, 0.05, 0]), 40),
        walk(np.array([-0.7, 0.2, 0]), np.zeros(3), 40),
    ]
    found = detect(cameras, people, 2.0, np.random.default_rng(0))
    leant = leaning(cameras, degrees)
    seen, _ = make_observations(found, leant, np.arange(40), 0.25)
    caplog.set_level("INFO")
    tilt = check_tilt(leant, seen, LIMITS)
    assert tilt == pytest.approx(degrees, abs=1.5)
    warned = "from the world's vertical" in caplog.text
    assert warned == (degrees > 12)


def test_too_few_bodies_say_nothing() -> None:
    points = walk(np.zeros(3), np.zeros(3), 5)
    group, frame, keypoint = (i.ravel() for i in np.indices((1, 5, 12)))
    assert people_tilt(points.reshape(-1, 3), group, frame, keypoint) is None
