# SPDX-License-Identifier: Apache-2.0
"""The factors, the solver and the intervals of an estimate of cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from studiorecon.estimate.factor import Factor
from studiorecon.estimate.factors.bones import bone_factors
from studiorecon.estimate.factors.edges import room_edges
from studiorecon.estimate.factors.feet import feet_on_floor
from studiorecon.estimate.factors.keypoints import Keypoints, keypoint_factor
from studiorecon.estimate.factors.lenses import known_lenses, similar_lenses
from studiorecon.estimate.intervals import camera_intervals
from studiorecon.estimate.solver import Solution, solve
from studiorecon.estimate.unknowns import LOG_FOCAL, PER_CAMERA, RADIAL, Unknowns
from studiorecon.geometry.distortion import distort

from tests.made.cameras import ring

ASPECT = np.array([1.0, 1.0, 1.1, 1.0])
POINTS_M = np.random.default_rng(1).uniform([-1, -1, 0], [1, 1, 2], (40, 3))
K1 = np.array([-0.3, -0.28, -0.31, 0.0])
EVERY = tuple(i.ravel() for i in np.meshgrid(np.arange(4), np.arange(40), indexing="ij"))


def start(points_m: np.ndarray = POINTS_M) -> Unknowns:
    return Unknowns.of(
        ring(), K1, points_m, bones=np.log([0.5, 0.4]), floor=np.array([0.02, -0.01, 0.1]), room=np.zeros(3)
    )


def pixels() -> np.ndarray:
    """(4, 40, 2) where distorting cameras see the points."""
    found = []
    for camera, k1 in zip(ring(), K1, strict=True):
        focal, principal = np.array(camera.focal_px), np.array(camera.principal_px)
        straight = (camera.project(POINTS_M)[0] - principal) / focal
        found.append(distort(straight, "opencv", np.array([k1])) * focal + principal)
    return np.array(found)


def seen(unknowns: Unknowns, aspect: np.ndarray = ASPECT, off_px: float = 0.0, sigma_px: float = 2.0) -> Keypoints:
    view, point = EVERY
    noise = np.random.default_rng(2).normal(0, off_px, (len(view), 2))
    return keypoint_factor(unknowns, view, point, pixels()[view, point] + noise, np.full(len(view), sigma_px), aspect)


def along_edges(unknowns: Unknowns) -> Factor:
    view, ends = np.array([0, 0, 1, 3]), np.random.default_rng(3).uniform(100, 600, (4, 4))
    return room_edges(unknowns, view, ends, np.array([0, 1, 2, 0]), np.eye(3), ASPECT)


FACTORS: dict[str, Callable[[Unknowns], Factor]] = {
    "keypoints": seen,
    "bones": lambda u: bone_factors(
        u, np.arange(6), np.arange(6, 12), np.arange(6) % 2, np.ones(6), np.array([0.5, 0.4])
    )[0],
    "usual lengths": lambda u: bone_factors(u, np.arange(2), np.arange(2), np.arange(2), np.ones(2), np.ones(2))[1],
    "feet": lambda u: feet_on_floor(u, np.arange(9), np.eye(3), np.ones(9)),
    "known lenses": lambda u: known_lenses(u, np.ones((4, 4)), np.ones((4, 4))),
    "alike lenses": lambda u: similar_lenses(u, ["a", "b", "a", "a"])[1],
    "edges": along_edges,
}


@pytest.mark.parametrize("name", FACTORS)
def test_derivatives_are_those_of_the_residuals(name: str) -> None:
    """Each factor's complex steps against central differences of what the solver evaluates after a step."""
    unknowns = start()
    factor = FACTORS[name](unknowns)
    slopes = factor.derivatives(unknowns, np.arange(factor.columns.shape[1]))
    rng = np.random.default_rng(0)
    for _ in range(4):
        step = rng.normal(0, 1e-5, len(unknowns.values))
        change = (factor.evaluate(unknowns.moved(step)) - factor.evaluate(unknowns.moved(-step))) / 2
        expected = np.einsum("mdk,mk->md", slopes, step[factor.columns])
        assert np.allclose(change, expected, rtol=1e-5, atol=1e-7 * np.abs(expected).max())


def estimated(off_px: float) -> Solution:
    """Cameras and lenses from a start that is wrong, with the first camera's pose and the points' scale held."""
    unknowns = start(POINTS_M + np.random.default_rng(4).normal(0, 0.05, POINTS_M.shape))
    ones = np.ones(4)
    factors = [seen(unknowns, ones, off_px, max(off_px, 0.1))]
    free = np.ones(len(unknowns.values), bool)
    free[unknowns.starts["bones"] :] = False
    free[:6] = False
    free[PER_CAMERA + 3 : PER_CAMERA + 4] = False
    wrong = np.zeros(len(unknowns.values))
    for v in range(1, 4):
        wrong[v * PER_CAMERA : v * PER_CAMERA + 3] = np.radians(2.0)
        wrong[v * PER_CAMERA + LOG_FOCAL], wrong[v * PER_CAMERA + RADIAL] = 0.1, 0.1
    return solve(unknowns.moved(wrong), factors, free)


def test_exact_pixels_give_exact_lenses_and_poses() -> None:
    found = estimated(0.0).unknowns
    truth = start()
    assert np.abs(found.of_cameras[:, RADIAL] - K1).max() < 1e-4
    assert np.abs(found.of_cameras[:, LOG_FOCAL] - truth.of_cameras[:, LOG_FOCAL]).max() < 1e-4
    assert np.abs(found.rotations - truth.rotations).max() < 1e-4


def test_what_was_held_stays_and_has_no_covariance() -> None:
    solution = estimated(1.0)
    assert np.array_equal(solution.unknowns.rotations[0], start().rotations[0])
    covariance = solution.covariance(4 * PER_CAMERA)
    assert not covariance[:6].any()
    assert (np.diag(covariance)[PER_CAMERA : PER_CAMERA + 3] > 0).all()


def test_intervals_grow_with_the_noise_and_hold_the_truth() -> None:
    little, much = (camera_intervals(estimated(off_px)) for off_px in (1.0, 4.0))
    assert much.between_deg > 2 * little.between_deg
    off = estimated(4.0).unknowns.of_cameras[:, RADIAL] - K1
    assert (np.abs(off) < 4 * much.radial).all()


def test_one_gross_error_moves_a_heavy_tailed_estimate_little() -> None:
    """A joint 500 px off, among 40 that are right."""
    unknowns = start()
    factor = seen(unknowns, np.ones(4))
    moved = factor.pixels.copy()
    moved[0] += 500.0
    wrong = replace(factor, pixels=moved)
    free = np.zeros(len(unknowns.values), bool)
    free[LOG_FOCAL] = True
    change = [solve(unknowns, [f], free).unknowns.values[LOG_FOCAL] for f in (factor, wrong)]
    assert abs(change[0] - change[1]) < 1e-3


def test_cameras_of_one_make_share_a_focal_length_unless_the_evidence_is_clear() -> None:
    """Two say 1.00 and one says 1.02, to 2 %: they agree; one that says 2.0 is let go."""
    unknowns = start()
    for last, drawn in ((0.02, True), (0.7, False)):
        expected = np.zeros((4, 4))
        expected[:, 0] = np.array([0.0, 0.0, last, 0.0]) + np.log(1000)
        sigma = np.full((4, 4), 0.02)
        factors = [known_lenses(unknowns, expected, sigma), *similar_lenses(unknowns, ["a", "a", "a", "b"])]
        free = np.zeros(len(unknowns.values), bool)
        free[[v * PER_CAMERA + LOG_FOCAL for v in range(4)]] = True
        apart = np.zeros(len(unknowns.values))
        apart[free] = expected[:, 0] - np.log(1000)
        focal = solve(unknowns.moved(apart), factors, free).unknowns.of_cameras[:, LOG_FOCAL] - np.log(1000)
        assert (abs(focal[2] - focal[0]) < 0.6 * last) == drawn
        assert abs(focal[3]) < 1e-6
