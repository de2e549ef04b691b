# SPDX-License-Identifier: Apache-2.0
"""What must hold for any input of the geometry: inverses, symmetries, and answers that move with the world."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from studiorecon.estimate.factors.keypoints import keypoint_factor
from studiorecon.estimate.solver import solve
from studiorecon.estimate.unknowns import LOG_FOCAL, PER_CAMERA, Unknowns
from studiorecon.geometry import rotations, smoothing
from studiorecon.geometry.camera_path import axis_miss_rad, gaps_around, interpolate_cameras, order_around, scene_centre
from studiorecon.geometry.triangulation import triangulate
from studiorecon.scene.camera import Camera
from studiorecon.survey import coverage

from tests.made.cameras import LIMITS, look_at, ring, seen
from tests.properties.moved_worlds import FEW, MANY, World, level_worlds, numbers, turns, worlds

UNEVEN = [
    look_at(f"c{i}", np.array([r * np.cos(a), r * np.sin(a), h]), [0.1, -0.2, 1.0])
    for i, (a, r, h) in enumerate([(0.1, 3.5, 1.4), (1.4, 4.2, 1.9), (3.3, 3.0, 1.6), (4.6, 4.5, 2.2)])
]


def widest_deg(cameras: list[Camera]) -> float:
    return float(np.degrees(max(gap.rad for gap in gaps_around(cameras))))


def cloud(seed: int, count: int = 12) -> np.ndarray:
    return np.random.default_rng(seed).uniform([-0.8, -0.8, 0.1], [0.8, 0.8, 1.9], (count, 3))


@MANY
@given(turns(), turns(), numbers(0, 1))
def test_slerp_of_equals_stays_and_runs_the_same_both_ways(a: np.ndarray, b: np.ndarray, share: float) -> None:
    np.testing.assert_allclose(rotations.slerp(a, a, share), a, atol=1e-12)
    assume(rotations.angle(a, b) < np.pi - 1e-3)
    np.testing.assert_allclose(rotations.slerp(a, b, share), rotations.slerp(b, a, 1 - share), atol=1e-9)
    assert rotations.angle(a, rotations.slerp(a, b, share)) == pytest.approx(share * rotations.angle(a, b), abs=1e-7)


@FEW
@given(worlds(), st.integers(0, 1000), st.permutations(range(4)), st.sampled_from(["robust", "huber", "dlt"]))
def test_triangulated_points_move_with_the_world_whatever_the_order_of_views(
    world: World, seed: int, order: list, solver: str
) -> None:
    rng = np.random.default_rng(seed)
    pixels = seen(UNEVEN, cloud(seed), 1.0, rng)
    pixels[rng.integers(4), :4] += 150
    here = triangulate(pixels, np.ones(pixels.shape[:2]), UNEVEN, LIMITS, solver=solver)
    cameras = [world.camera(UNEVEN[i]) for i in order]
    there = triangulate(pixels[order], np.ones(pixels.shape[:2]), cameras, LIMITS, solver=solver)
    np.testing.assert_array_equal(here.valid, there.valid)
    np.testing.assert_array_equal(here.inliers[order], there.inliers)
    np.testing.assert_allclose(there.points_m[here.valid], world.points(here.points_m)[here.valid], atol=2e-6)
    expected = world.scale**2 * world.rotation @ here.covariance_m2[here.valid] @ world.rotation.T
    np.testing.assert_allclose(there.covariance_m2[here.valid], expected, rtol=1e-4, atol=1e-10)


@FEW
@given(st.integers(0, 1000), st.integers(0, 4), st.sampled_from(["robust", "huber", "dlt"]))
def test_a_view_that_shows_nothing_changes_nothing(seed: int, place: int, solver: str) -> None:
    pixels = seen(UNEVEN, cloud(seed), 1.0, np.random.default_rng(seed))
    alone = triangulate(pixels, np.ones(pixels.shape[:2]), UNEVEN, LIMITS, solver=solver)
    blind = look_at("blind", np.array([1.0, -5.0, 2.5]), [0, 0, 1])
    cameras = [*UNEVEN[:place], blind, *UNEVEN[place:]]
    more = np.insert(pixels, place, np.nan, axis=0)
    confidence = np.ones(more.shape[:2])
    with_blind = triangulate(more, confidence, cameras, LIMITS, solver=solver)
    np.testing.assert_allclose(with_blind.points_m, alone.points_m, atol=1e-9)
    np.testing.assert_array_equal(with_blind.valid, alone.valid)
    np.testing.assert_array_equal(np.delete(with_blind.inliers, place, axis=0), alone.inliers)


@FEW
@given(worlds(), st.integers(0, 100))
def test_adjusted_cameras_move_with_the_world(world: World, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = cloud(seed, 30)
    pixels = seen(UNEVEN, points, 0.5, rng)
    start = [World(rotations.exp(0.004 * rng.normal(size=3)), 0.01 * rng.normal(size=3)).camera(c) for c in UNEVEN]
    view, point = (i.ravel() for i in np.meshgrid(np.arange(4), np.arange(30), indexing="ij"))
    shown = []
    for cameras, points_m in ((start, points), ([world.camera(c) for c in start], world.points(points))):
        unknowns = Unknowns.of(cameras, np.zeros(4), points_m)
        factor = keypoint_factor(unknowns, view, point, pixels[view, point], np.ones(120), np.ones(4))
        free = np.ones(len(unknowns.values), bool)
        numbers = free[: 4 * PER_CAMERA].reshape(4, PER_CAMERA)
        numbers[0], numbers[:, LOG_FOCAL:] = False, False
        shown.append(factor.evaluate(solve(unknowns, [factor], free, 60).unknowns))
    # The scale is open, so residuals are compared.
    np.testing.assert_allclose(shown[0], shown[1], atol=1e-2)


@FEW
@given(level_worlds(), st.sampled_from(["slerp", "look_at"]), numbers(0, 1))
def test_a_path_moves_with_the_world(world: World, turning: str, clearance: float) -> None:
    moved = [world.camera(c) for c in UNEVEN]
    centre = scene_centre(UNEVEN)
    np.testing.assert_allclose(scene_centre(moved), world.points(centre), atol=1e-8)
    order, gap = order_around(UNEVEN, centre, closed=True)
    other_order, other_gap = order_around(moved, world.points(centre), closed=True)
    assert order == other_order
    assert gap == pytest.approx(other_gap, abs=1e-9)
    options = {"rotations": turning, "clearance": clearance}
    here, bent = interpolate_cameras(UNEVEN[0], UNEVEN[1], 9, centre, **options)
    there, other_bent = interpolate_cameras(moved[0], moved[1], 9, world.points(centre), **options)
    assert bent == other_bent
    for one, other in zip(here, there):
        np.testing.assert_allclose(world.camera(one).camera_from_world, other.camera_from_world, atol=1e-7)
        assert axis_miss_rad(one, centre) == pytest.approx(axis_miss_rad(other, world.points(centre)), abs=1e-7)


@FEW
@given(level_worlds(scaled=True), st.permutations(range(4)))
def test_what_the_survey_measures_does_not_depend_on_the_world(world: World, order: list[int]) -> None:
    points, depths = cloud(3, 200), [np.full(c.hw, 30.0, np.float32) for c in UNEVEN]
    moved = [world.camera(UNEVEN[i]) for i in order]
    here = coverage.visible_points(points, UNEVEN, depths, 0.05)
    there = coverage.visible_points(world.points(points), moved, [d * np.float32(world.scale) for d in depths], 0.05)
    assert (here[order] != there).mean() < 0.01
    sides = coverage.has_parallax(points, UNEVEN, here, 2.0)
    other_sides = coverage.has_parallax(world.points(points), moved, here[order], 2.0)
    np.testing.assert_array_equal(sides, other_sides)
    # A faint pull towards the mean place keeps parallel axes solvable; it is in no unit and moves the centre by
    # millimetres.
    # Where axes miss each other, the scene's centre is drawn a little towards three metres ahead, whatever the scale.
    assert widest_deg(moved) == pytest.approx(widest_deg(UNEVEN), abs=1e-2)
    assert coverage.mean_pair_deg(moved) == pytest.approx(coverage.mean_pair_deg(UNEVEN), abs=1e-6)


def test_four_on_a_ring_are_ninety_apart_and_120_on_average() -> None:
    """U55, U56."""
    assert widest_deg(ring(4)) == pytest.approx(90)
    assert coverage.mean_pair_deg(ring(4)) == pytest.approx(120)
    assert coverage.mean_pair_deg(ring(1)) == 0


@FEW
@given(turns(), turns(), st.integers(0, 100), numbers(0.2, 1), numbers(0, 2))
def test_smoothing_turns_with_body_and_world_and_keeps_constants(
    world: np.ndarray, body: np.ndarray, seed: int, alpha: float, sigma: float
) -> None:
    rng = np.random.default_rng(seed)
    steps = rotations.exp(0.1 * rng.normal(size=(20, 3)))
    motion = np.stack([np.linalg.multi_dot([*steps[: i + 1], np.eye(3)]) for i in range(20)])
    there = smoothing.smooth_rotations(world @ motion @ body, alpha, sigma)
    np.testing.assert_allclose(there, world @ smoothing.smooth_rotations(motion, alpha, sigma) @ body, atol=1e-6)
    still = np.tile(world, (20, 1, 1))
    np.testing.assert_allclose(smoothing.smooth_rotations(still, alpha, sigma), still, atol=1e-12)
    places = rng.normal(size=(20, 3))
    turned = smoothing.smooth_vectors(places @ world.T + 5.0, alpha, sigma)
    np.testing.assert_allclose(turned, smoothing.smooth_vectors(places, alpha, sigma) @ world.T + 5.0, atol=1e-12)
