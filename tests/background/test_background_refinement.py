# SPDX-License-Identifier: Apache-2.0
"""background: where the half-trained room is looked at from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.background.refinement import Refinement, refinement_cameras
from studiorecon.errors import UserError
from studiorecon.geometry.camera_path import interpolate_cameras, scene_centre
from studiorecon.scene.camera import Camera

from tests.made.background import cameras, capture, settings

__all__ = ["cameras", "capture", "settings"]  # fixtures

ROUND = Refinement(40, 0.5, 0.15, 0.7)


def heights_m(made: list[Camera]) -> np.ndarray:
    return np.array([camera.centre_m[2] for camera in made])


def test_the_papers_views_lie_between_the_synthesized_ones(cameras: list[Camera]) -> None:
    """U53, appendix: 240 poses interpolated between 481, ±15 % of the radius up and down, the pitch made up for."""
    middle = scene_centre(cameras)
    path = []
    for one, other in zip(cameras, [*cameras[1:], cameras[0]]):
        path += interpolate_cameras(one, other, 13, middle, rotations="slerp", clearance=0.0)[0]
    letter = replace(ROUND, views=24)
    made, level = (refinement_cameras(cameras, path, settings) for settings in (letter, replace(letter, height=0.0)))
    assert len(made) == 24
    radius_m = np.median([np.linalg.norm((c.centre_m - middle)[:2]) for c in cameras])
    rise_m = heights_m(made) - heights_m(level)
    assert 0.13 * radius_m < np.abs(rise_m).max() <= 0.15 * radius_m
    assert (rise_m > 0).any()
    assert (rise_m < 0).any()
    np.testing.assert_allclose(level[0].camera_from_world, path[0].camera_from_world, atol=1e-9)
    np.testing.assert_allclose(level[-1].camera_from_world, path[-1].camera_from_world, atol=1e-9)
    for raised, straight, up_m in zip(made, level, rise_m):
        # On the chords of the path, not on a ring about the middle.
        np.testing.assert_allclose(raised.centre_m[:2], straight.centre_m[:2], atol=1e-9)
        turn = straight.rotation_camera_from_world @ raised.world_from_camera[:3, :3]
        np.testing.assert_allclose(turn[:, 0], [1, 0, 0], atol=1e-9)
        assert np.arctan2(turn[1, 2], turn[2, 2]) == pytest.approx(np.arctan2(up_m, radius_m), abs=1e-9)
        assert (raised.forward[2] < straight.forward[2]) == (up_m > 1e-9)
    assert min(np.linalg.norm((c.centre_m - middle)[:2]) for c in level) < 0.9 * radius_m
    with pytest.raises(UserError, match="there are 0"):
        refinement_cameras(cameras, [], letter)
