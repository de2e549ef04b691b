# SPDX-License-Identifier: Apache-2.0
"""Hard cases T01 to T16 of triangulation: four cameras on a ring of 4 m, f = 1000."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from studiorecon.geometry import triangulation_kernels as kernels
from studiorecon.geometry.triangulation import TriangulatedPoints, _rig, triangulate

from tests.made.cameras import LIMITS, arc, look_at, ring, seen

CENTRE = np.array([[0.0, 0.0, 1.0]])


SOLVERS = ["robust", "huber", "dlt"]


def solve(pixels: np.ndarray, cameras: list, solver: str = "robust", **changed: float) -> TriangulatedPoints:
    return triangulate(
        pixels, np.ones(pixels.shape[:2]), cameras, replace(LIMITS, **changed), noise_px=1.0, solver=solver
    )


def with_outliers(
    views: int, outliers: int, count: int, seed: int, spread_m: float = 0.5
) -> tuple[np.ndarray, np.ndarray, list]:
    """Truth (N, 3), pixels (V, N, 2) with 1 px noise and ``outliers`` views off by 200 px in a random direction,
    cameras."""
    rng = np.random.default_rng(seed)
    cameras = ring(views)
    points = rng.uniform(-spread_m, spread_m, (count, 3)) + np.array([0, 0, 1])
    pixels = seen(cameras, points, 1.0, rng)
    for n in range(count):
        which = rng.choice(views, outliers, replace=False)
        angles = rng.uniform(0, 2 * np.pi, outliers)
        pixels[which, n] += 200 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return points, pixels, cameras


# T01 naive: parallel rays give (NaN, NaN, -inf), disparities of 1e-6 px a point 1e9 m away.
@pytest.mark.parametrize("disparity_px", [0.0, 1e-6, -1e-6], ids=["T01-parallel", "T01-just-before", "T01-just-behind"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_parallel_rays_are_undetermined(disparity_px, solver):
    cameras = [look_at(f"c{i}", np.array([-4.0, y, 1.0]), [0, y, 1]) for i, y in enumerate((-0.5, 0.5))]
    assert not solve(np.array([[[640.0, 352.0]], [[640.0 + disparity_px, 352.0]]]), cameras, solver).valid[0]


# T02 naive: 1 px noise on the baseline of opposite cameras: median 6 m, p90 34 m.
@pytest.mark.parametrize("off_m", [pytest.param(0.0, id="T02-on-baseline"), pytest.param(0.3, id="T02-beside")])
@pytest.mark.parametrize("solver", SOLVERS)
def test_opposite_cameras_say_when_they_cannot_know(off_m, solver):
    cameras = [look_at("a", np.array([4.0, 0, 1]), [0, 0, 1]), look_at("b", np.array([-4.0, 0, 1]), [0, 0, 1])]
    truth = np.tile([0.0, off_m, 1.0], (300, 1))
    found = solve(seen(cameras, truth, 1.0, np.random.default_rng(0)), cameras, solver)
    error = np.linalg.norm(found.points_m - truth, axis=-1)
    if off_m == 0:
        assert not found.valid.any()
    else:
        assert found.valid.mean() > 0.95
        assert np.nanmedian(error) < 0.04
        assert np.sqrt(np.nanmean(error**2)) == pytest.approx(float(np.nanmedian(found.sigma_m[found.valid])), rel=0.35)


# T03 naive: two singular values near 1e-13, answer 5 m away.
@pytest.mark.parametrize("noise_px", [pytest.param(0.0, id="T03-exact"), pytest.param(3.0, id="T03-noisy")])
@pytest.mark.parametrize("solver", SOLVERS)
def test_three_views_from_one_place_are_undetermined(noise_px, solver):
    place = np.array([4.0, 0.0, 1.5])
    cameras = [look_at(f"c{i}", place, [0, 0.2 * i, 1]) for i in range(3)]
    assert not solve(
        seen(cameras, np.tile(CENTRE, (50, 1)), noise_px, np.random.default_rng(0)), cameras, solver
    ).valid.any()


# T04 naive: "SVD did not converge", for the whole batch.
@pytest.mark.parametrize("poison", [np.nan, np.inf], ids=["T04-nan", "T04-inf"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_one_view_that_is_not_a_number_leaves_the_other_three(poison, solver):
    _, pixels, cameras = with_outliers(4, 0, 20, 0)
    clean = solve(pixels[1:], cameras[1:], solver)
    pixels[0, :10] = poison
    found = solve(pixels, cameras, solver)
    assert found.valid.all()
    assert np.abs(found.points_m[:10] - clean.points_m[:10]).max() < 1e-9


# T05 naive: all weights 0 give the world's origin, one view a point 18 m away with positive depth.
@pytest.mark.parametrize("views", [0, 1], ids=["T05-no-view", "T05-one-view"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_fewer_than_two_views_are_undetermined(views, solver):
    pixels, confidence = seen(ring(), CENTRE), np.zeros((4, 1))
    confidence[:views] = 1.0
    found = triangulate(pixels, confidence, ring(), LIMITS, solver=solver)
    assert not found.valid[0]
    assert np.isnan(found.points_m).all()
    assert np.isinf(found.sigma_m).all()


@pytest.mark.parametrize("solver", SOLVERS)
def test_t05_a_weight_of_two_is_a_view_counted_twice(solver):  # naive: rows times w instead of √w count it four times
    _, pixels, cameras = with_outliers(4, 0, 50, 9)
    confidence = np.ones((4, 50))
    confidence[1] = 2.0
    twice = solve(pixels[[0, 1, 1, 2, 3]], [cameras[i] for i in (0, 1, 1, 2, 3)], solver)
    once = triangulate(pixels, confidence, cameras, LIMITS, noise_px=1.0, solver=solver)
    assert np.abs(once.points_m - twice.points_m).max() < 1e-7
    assert np.abs(once.points_m - solve(pixels, cameras, solver).points_m).max() > 1e-5


@pytest.mark.parametrize("solver", SOLVERS)
def test_t06_diverging_rays_are_undetermined(solver):  # T06 naive: residual 3e-13 px, depth -10 m in both cameras
    cameras = arc(20.0)
    behind = np.array([[14.0, 0.0, 1.0]])  # the rays' backward extensions meet there
    pixels = np.stack([(c.intrinsics @ (c.camera_from_world[:3] @ np.append(behind[0], 1)))[None] for c in cameras])
    pixels = pixels[..., :2] / pixels[..., 2:]
    assert not solve(pixels, cameras, solver).valid[0]


def test_t07_one_wrong_view_of_four_is_left_out():  # T07 naive: DLT 37 cm, Huber x10 1.4 cm with p95 24
    truth, pixels, cameras = with_outliers(4, 1, 1000, 1)
    found = solve(pixels, cameras)
    error = np.linalg.norm(found.points_m - truth, axis=-1)
    assert found.verified.mean() > 0.98
    assert np.nanmedian(error) < 0.005
    assert np.nanquantile(error, 0.95) < 0.0095


def test_t08_two_wrong_views_of_four_are_mostly_left_out_and_said_to_be_unverified():  # naive, Huber: 17 cm, p95 1.15 m
    # People-sized stage, ±1 m: 5 % is what two right views cannot tell, mostly opposite ones with the point between
    # them (T02).
    truth, pixels, cameras = with_outliers(4, 2, 6000, 2, spread_m=1.0)
    found = solve(pixels, cameras)
    error = np.linalg.norm(np.nan_to_num(found.points_m, nan=99.0) - truth, axis=-1)
    assert np.median(error) < 0.0067
    assert (error < 0.03).mean() > 0.945
    assert (error[found.sigma_m < 0.03] < 0.03).mean() > 0.965
    assert (~found.verified).mean() > 0.95


@pytest.mark.parametrize("outliers", [8, 9], ids=["T09-8", "T09-9"])
def test_eight_and_nine_wrong_views_of_ten_are_undetermined(
    outliers,
):  # naive: Huber 31 and 48 cm, pair search 0.8 cm and 1.19 m
    _, pixels, cameras = with_outliers(10, outliers, 1000, 3)
    assert solve(pixels, cameras).valid.mean() < 0.01


def test_t09_half_of_ten_views_suffice():
    truth, pixels, cameras = with_outliers(10, 5, 500, 3)
    found = solve(pixels, cameras)
    assert found.verified.mean() > 0.99
    assert np.nanquantile(np.linalg.norm(found.points_m - truth, axis=-1), 0.95) < 0.01


@pytest.mark.parametrize("outliers", [1, 2], ids=["T10-one", "T10-two"])
def test_outliers_do_not_pull_on_a_good_start(
    outliers,
):  # T10 naive: Huber with outliers kept 0.55 -> 1.34 and 0.66 -> 4.3 cm
    truth, pixels, cameras = with_outliers(4, outliers, 600, 4)
    found = solve(pixels, cameras)
    good = found.valid & (np.linalg.norm(np.nan_to_num(found.points_m) - truth, axis=-1) < 0.03)
    alone = np.stack(
        [
            solve(np.where(found.inliers[:, n : n + 1, None], pixels[:, n : n + 1], np.nan), cameras).points_m[0]
            for n in np.flatnonzero(good)[:100]
        ]
    )
    assert np.abs(alone - found.points_m[good][:100]).max() < 1e-4
    error, kept = (
        np.nanmedian(np.linalg.norm(f.points_m - truth, axis=-1)) for f in (found, solve(pixels, cameras, "huber"))
    )
    assert error < (0.0055 if outliers == 1 else 0.0070)
    assert error < kept


def huber_norm(point: np.ndarray, pixels: np.ndarray, cameras: list, delta_px: float) -> float:
    """Σ ρ(‖r‖) with ρ(r) = r²/2 inside delta and delta (r − delta/2) outside, r the length of the two-dimensional
    residual."""
    r = np.array([np.linalg.norm(c.project(point)[0] - p) for c, p in zip(cameras, pixels)])
    return float(np.where(r <= delta_px, r**2 / 2, delta_px * (r - delta_px / 2)).sum())


def test_t11_huber_is_that_of_the_residuals_length():
    # Naive, `least_squares(loss="huber")` on flattened residuals: (3, 3) with delta 3 costs 9.0 instead of 8.23; 2.1
    # instead of 1.4 cm.
    camera = look_at("c", np.array([4.0, 0, 1]), [0, 0, 1])
    rig = _rig([camera], np.array([3.0]))
    cost = kernels._normal(
        rig,
        camera.project(CENTRE)[0][None] + 3.0,
        np.ones((1, 1)),
        0,
        np.array([0]),
        np.ones(1, bool),
        kernels._HUBER,
        0.1,
        CENTRE[0],
        np.empty(9),
    )
    assert cost * 3.0**2 / 2 == pytest.approx(3 * (np.sqrt(18) - 1.5), abs=1e-9)  # 8.23
    truth, pixels, cameras = with_outliers(4, 1, 12, 6)
    delta = LIMITS.huber_share * 1280
    found = solve(pixels, cameras, "huber")
    for n in range(12):
        best = minimize(
            huber_norm,
            truth[n],
            (pixels[:, n], cameras, delta),
            method="Nelder-Mead",
            options={"xatol": 1e-9, "fatol": 1e-12},
        )
        assert np.linalg.norm(found.points_m[n] - best.x) < 1e-5


@pytest.mark.parametrize("solver", SOLVERS)
def test_t12_every_solver_ends_where_exact_pixels_meet(solver):  # naive, from (10, 0, 10) behind both cameras: 2.7e26 m
    truth, _, _ = with_outliers(4, 0, 200, 5)
    for cameras in (ring(), arc(40.0)):
        assert np.abs(solve(seen(cameras, truth), cameras, solver).points_m - truth).max() < 1e-9


# T12 naive: a start behind both cameras ends at 2.7e26 m
def test_t12_refinement_starts_from_a_pair_and_never_runs_away():
    truth, pixels, cameras = with_outliers(4, 0, 500, 5)
    wild = pixels + np.random.default_rng(0).normal(0, 60, pixels.shape)
    found = solve(wild, cameras, outlier_units=40.0)
    assert (np.linalg.norm(found.points_m[found.valid] - truth[found.valid], axis=-1) < 2.0).all()


# T13 naive: 3.1 m wrong at 2e-13 px
def test_t13_a_keypoint_moved_along_the_epipolar_line_of_two_views_is_said_to_be_unverified():
    cameras = arc(60.0)
    truth = np.array([[0.3, 0.2, 1.2]])
    away = truth + 1.5 * (truth - cameras[0].centre_m) / np.linalg.norm(truth - cameras[0].centre_m)
    pixels = np.stack([cameras[0].project(truth)[0], cameras[1].project(away)[0]])
    found = solve(pixels, cameras)
    assert np.nanmax(found.error_px) < 1e-6
    assert not found.verified[0]


@pytest.mark.parametrize("degrees", [0.2, 0.05], ids=["T14-0.2deg", "T14-0.05deg"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_narrow_rays_keep_their_digits(degrees, solver):  # T14 naive, f32 eigenvalues: 1.3 mm and 5.5 cm
    cameras = arc(degrees)
    found = solve(seen(cameras, CENTRE), cameras, solver, min_angle_deg=0.01)
    assert found.valid[0]
    assert np.abs(found.points_m - CENTRE).max() < 1e-6


@pytest.mark.parametrize("solver", SOLVERS)
def test_t15_a_world_far_from_its_origin_costs_nothing(solver):  # T15 naive, f32: 0.1-0.3 % of the scene
    shift = np.array([1e5, -1e5, 0])
    cameras = [look_at(c.name, c.centre_m + shift, np.array([0, 0, 1]) + shift) for c in ring()]
    truth = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 3)) + np.array([0, 0, 1]) + shift
    assert np.abs(solve(seen(cameras, truth), cameras, solver).points_m - truth).max() < 1e-7


# T16, not a failure: the table's medians (±20 %), and the closed form of the error. At 10° the table's 1.8 cm came from
# few draws: 1 px is 4 mm at 4 m, the Cramér-Rao bound of the depth is then 3.2 cm, its median 2.2, and nobody unbiased
# gets below. Held instead: the bound.
@pytest.mark.parametrize(
    ("degrees", "median_cm"), [(1, 20), (2, 9.7), (5, 3.8), (10, 1.8), (30, 0.75), (90, 0.5)], ids=lambda v: f"T16-{v}"
)
def test_accuracy_follows_the_ray_angle(degrees, median_cm):
    cameras = arc(degrees)
    truth = np.tile(CENTRE, (4000, 1))
    found = solve(seen(cameras, truth, 1.0, np.random.default_rng(degrees)), cameras, min_angle_deg=0.3)
    error = np.linalg.norm(found.points_m[found.valid] - truth[found.valid], axis=-1)
    half = np.radians(degrees / 2)
    sigma_m = 0.004 * np.sqrt([0.5 / np.sin(half) ** 2, 0.5 / np.cos(half) ** 2, 0.5])  # along, across, up
    expected_m = np.linalg.norm(sigma_m)
    bound_cm = 100 * np.median(np.linalg.norm(sigma_m * np.random.default_rng(0).normal(size=(100_000, 3)), axis=-1))
    assert np.sqrt((error**2).mean()) == pytest.approx(expected_m, rel=0.05)
    assert 100 * np.median(error) == pytest.approx(bound_cm, rel=0.05)
    assert (bound_cm > 1.2 * median_cm) == (degrees == 10)
    if degrees != 10:
        assert 100 * np.median(error) == pytest.approx(median_cm, rel=0.2)
    assert np.median(found.sigma_m[found.valid]) == pytest.approx(expected_m, rel=0.2)
