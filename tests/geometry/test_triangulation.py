# SPDX-License-Identifier: Apache-2.0
"""Properties of triangulation, ray distances and grouping."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.geometry.camera_motion import move_camera, remove_drift
from studiorecon.geometry.rotations import exp
from studiorecon.geometry.triangulation import triangulate
from studiorecon.keypoints.correspondence import ray_distances, track_groups

from tests.made.cameras import LIMITS, look_at, ring, seen

RNG = np.random.default_rng
ONES = np.ones


def cloud(count: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-0.5, 0.5, (count, 3)) + np.array([0, 0, 1])


def test_the_given_sigma_is_the_error_that_occurs():
    points = cloud(2000, RNG(1))
    found = triangulate(seen(ring(), points, 1.0, RNG(2)), ONES((4, 2000)), ring(), LIMITS, noise_px=1.0)
    error = np.linalg.norm(found.points_m - points, axis=-1)
    assert np.sqrt((error**2).mean()) == pytest.approx(float(np.median(found.sigma_m)), rel=0.15)


def test_no_points_are_no_points():
    found = triangulate(np.zeros((4, 0, 2)), np.zeros((4, 0)), ring(), LIMITS)
    assert found.points_m.shape == (0, 3)
    assert found.sigma_m.shape == (0,)


def test_ray_distance_is_the_gap_and_rays_that_meet_behind_are_infinitely_far():
    origin, other = np.zeros(3), np.array([2.0, 0, 0.1])
    ahead = ray_distances(origin, np.array([[1.0, 0, 0]]), other, np.array([[0, 1.0, 0]]) * -1)
    assert not np.isfinite(ahead[0])  # passes at range 0 of the second ray
    meets = ray_distances(origin, np.array([[1.0, 0, 0]]), np.array([2.0, -1.0, 0.1]), np.array([[0, 1.0, 0]]))
    assert meets[0] == pytest.approx(0.1)
    behind = ray_distances(origin, np.array([[-1.0, 0, 0]]), np.array([2.0, -1.0, 0.1]), np.array([[0, 1.0, 0]]))
    assert not np.isfinite(behind[0])


def test_removing_drift_takes_a_common_similarity_off_exactly():
    cameras = [*ring(3), look_at("d", np.array([0.5, 3.0, 2.5]), [0, 0, 1])]
    rotation = exp(np.array([0.02, -0.05, 0.1]))
    drifted = [
        move_camera(c, c.camera_from_world[:3, :3] @ rotation.T, 1.1 * rotation @ c.centre_m + [0.1, 0.2, -0.3])
        for c in cameras
    ]
    for camera, truth in zip(remove_drift(drifted, cameras)[0], cameras):
        assert np.abs(camera.camera_from_world - truth.camera_from_world).max() < 1e-9


def test_a_person_in_hundreds_of_short_tracks_is_grouped_in_a_moment():
    """One person whom four detectors lose all the time: 240 tracks; growing groups from every pair anew took
    minutes."""
    view, start = np.repeat(np.arange(4), 60), np.tile(np.arange(60), 4)
    meets = np.abs(start[:, None] - start[None]) <= 1
    distance = np.where(meets & (view[:, None] != view[None]), 0.05, np.nan)
    groups = track_groups(distance, view, meets & ((view[:, None] != view) | (start[:, None] == start)), 0.25)
    assert [len(g) for g in groups] == [240]
