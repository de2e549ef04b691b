# SPDX-License-Identifier: Apache-2.0
"""Rows M of the table of hard cases, and the derivatives they rest on: fitting a body to 3D keypoints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.body import fitting, prior
from studiorecon.body.basis import State
from studiorecon.body.fitting import FitSettings
from studiorecon.body.layouts import LAYOUTS
from studiorecon.body.model import JOINT_NAMES, BodyModel, upright_global_orientation
from studiorecon.geometry import rotations

NAMES = list(LAYOUTS["body_25b"].keypoints)
SETTINGS = FitSettings(
    iterations=30,
    tolerance=1e-6,
    point_sigma_m=0.005,
    correction_sigma_m=0.01,
    huber_units=3,
    pose_weight=1,
    beta_weight=1,
    free_scale=False,
)
# Nothing but the points: what a noiseless fit must reach.
TRUSTING = replace(SETTINGS, pose_weight=1e-6, beta_weight=1e-6, correction_sigma_m=1e-4, tolerance=1e-14, iterations=60)


@pytest.fixture(scope="module")
def body(root: Path) -> BodyModel:
    return BodyModel.load(root / "resources/body.npz")


def moderate(frames: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Poses (T, 72) a person can take, and pelvis positions (T, 3)."""
    rng = np.random.default_rng(seed)
    spread = 0.5 / np.sqrt(np.maximum(prior.precision(), 1e-9))
    spread[0] = 0
    local = prior.middle() @ rotations.exp(rng.normal(size=(frames, 24, 3)) * spread)
    local[:, 0] = [rotations.exp(upright_global_orientation(h)) for h in rng.uniform(-3, 3, frames)]
    return rotations.log(local).reshape(frames, 72), rng.normal(0, 1, (frames, 3))


def solve(body: BodyModel, points: np.ndarray, settings: FitSettings, sigma_m: float = 0.0, names: list[str] = NAMES) -> fitting.Fit:
    sigma = np.where(np.isfinite(points).all(-1), sigma_m, np.inf)
    return fitting.fit(body, names, points, sigma, settings)


def joint_error_mm(body: BodyModel, fit: fitting.Fit, poses: np.ndarray, betas: np.ndarray, trans: np.ndarray) -> np.ndarray:
    return 1000 * np.linalg.norm(fit.joints_m - body.joints(poses, betas, trans), axis=-1)


def test_gradient_agrees_with_finite_differences(body: BodyModel) -> None:
    rng = np.random.default_rng(0)
    poses, trans = moderate(2)
    settings = replace(SETTINGS, free_scale=True, huber_units=4.0)
    targets = body.keypoints(NAMES, poses, np.zeros(10), trans) + rng.normal(0, 0.02, (2, 25, 3))
    problem = fitting._Problem(body, NAMES, targets, np.full((2, 25), 0.01), rng.random((2, 25)) > 0.1, settings)
    local = rotations.exp(poses.reshape(2, 24, 3)) @ rotations.exp(rng.normal(0, 0.2, (2, 24, 3)))
    state = State(local, trans + 0.01, rng.normal(0, 0.5, 10), 0.05, rng.normal(0, 0.01, (25, 3)))
    _, _, _, side, shared_side, world = problem.normal(state)
    nothing = (np.zeros((2, 24, 3)), np.zeros((2, 3)), np.zeros(86))

    def slope(change: int, index: tuple[int, ...]) -> float:
        costs = []
        for step in (1e-6, -1e-6):
            moved = [part.copy() for part in nothing]
            moved[change][index] = step
            if change == 0:  # derivatives are by turns about world axes
                moved[0] = np.einsum("fjyx,fjy->fjx", world, moved[0])
            costs.append(problem.cost(state.moved(*moved)))
        return (costs[0] - costs[1]) / 2e-6

    scale = np.abs(side).max()
    for joint in range(24):
        assert slope(0, (1, joint, joint % 3)) == pytest.approx(side[1, 3 * joint + joint % 3], abs=1e-6 * scale)
    for axis in range(3):
        assert slope(1, (0, axis)) == pytest.approx(side[0, 72 + axis], abs=1e-6 * scale)
    for index in (0, 4, 9, 10, 11, 40, 85):
        assert slope(2, (index,)) == pytest.approx(shared_side[index], abs=1e-6 * np.abs(shared_side).max())


@pytest.mark.parametrize("layout", ["body_25b", "smpl24"])
def test_noiseless_points_are_met_exactly(body: BodyModel, layout: str) -> None:
    # M03. Naive, 30 steps: Adam 77 mm, L-BFGS 17 mm, gradient descent 1e36.
    names = list(LAYOUTS[layout].keypoints)
    poses, trans = moderate(12)
    betas = np.array([0.3, -0.5, 0.4, 0.2, -0.3, 0.1, 0.2, -0.1, 0.1, 0.2])
    fit = solve(body, body.keypoints(names, poses, betas, trans), TRUSTING, names=names)
    assert fit.valid.all()
    assert 1000 * np.nanmean(fit.residual_m) < 0.1
    assert 1000 * np.nanmax(fit.residual_m) < 0.5


def test_unobserved_twist_is_reported_as_unsure(body: BodyModel) -> None:
    # M04. Naive: joints 0.000 mm off and 28° wrong, silently. No keypoint tells how hands or the spine's parts turn.
    poses, trans = moderate(6)
    fit = solve(body, body.keypoints(NAMES, poses, np.zeros(10), trans), SETTINGS)
    sigma = fit.joint_sigma_m.mean(0)
    assert sigma[JOINT_NAMES.index("left_hand")] > 2 * sigma[JOINT_NAMES.index("left_wrist")]
    bend = np.linalg.norm(prior.bend(fit.rotations), axis=-1)
    assert np.rad2deg(bend[:, [JOINT_NAMES.index(f"{s}_collar") for s in ("left", "right")]]).max() < 30


@pytest.mark.parametrize("turned_deg", [90, 170, 180])
def test_body_that_faces_away_is_turned(body: BodyModel, turned_deg: float) -> None:
    # M05. Naive: gradient −2e-14 at 180°, L-BFGS ends 64° off.
    poses, trans = moderate(1)
    poses[:, :3] = upright_global_orientation(np.deg2rad(turned_deg))
    upside_down = rotations.log(rotations.exp([np.pi, 0, 0]) @ rotations.exp(poses[0, :3]))
    for root in (poses[0, :3].copy(), upside_down):
        poses[0, :3] = root
        fit = solve(body, body.keypoints(NAMES, poses, np.zeros(10), trans), TRUSTING)
        assert np.rad2deg(rotations.angle(fit.rotations[0, 0], rotations.exp(root))) < 8  # it shares its turn with the spine
        assert joint_error_mm(body, fit, poses, np.zeros(10), trans)[0, [1, 2, 4, 5, 7, 8, 16, 17, 18, 19, 20, 21]].max() < 10


def test_missing_points_leave_the_others_alone(body: BodyModel) -> None:
    # M02. Naive: value 0, gradient NaN.
    poses, trans = moderate(8)
    points = body.keypoints(NAMES, poses, np.zeros(10), trans)
    points[:, NAMES.index("left_wrist")] = np.nan
    points[3, :5] = np.nan
    fit = solve(body, points, SETTINGS)
    assert fit.valid.all()
    assert np.isfinite(fit.rotations).all()
    assert np.isnan(fit.residual_m[:, NAMES.index("left_wrist")]).all()
    known = [j for j, n in enumerate(JOINT_NAMES) if not n.startswith(("left_wrist", "left_hand", "left_elbow"))]
    assert joint_error_mm(body, fit, poses, np.zeros(10), trans)[:, known].mean() < 15
    assert (fit.joint_sigma_m[:, JOINT_NAMES.index("left_wrist")] > 2 * fit.joint_sigma_m[:, JOINT_NAMES.index("right_wrist")]).all()


def test_frames_with_too_few_points_are_left_out(body: BodyModel) -> None:
    # M06. Naive: up to 136° wrong with a tenth of the points.
    poses, trans = moderate(5)
    points = body.keypoints(NAMES, poses, np.zeros(10), trans)
    points[1, 4:] = np.nan
    points[2] = np.nan
    fit = solve(body, points, SETTINGS)
    assert fit.valid.tolist() == [True, False, False, True, True]
    assert np.isnan(fit.joints_m[1:3]).all()
    assert np.isinf(fit.joint_sigma_m[1:3]).all()
    rest = solve(body, points[[0, 3, 4]], SETTINGS)
    np.testing.assert_allclose(fit.joints_m[[0, 3, 4]], rest.joints_m, atol=1e-6)
    nothing = solve(body, np.full((3, 25, 3), np.nan), SETTINGS)
    assert not nothing.valid.any()


def test_detectors_own_hips_are_learnt(body: BodyModel) -> None:
    # M07. Naive: a constant offset of several cm goes into pose and shape.
    poses, trans = moderate(30)
    points = body.keypoints(NAMES, poses, np.zeros(10), trans)
    hips = [NAMES.index("left_hip"), NAMES.index("right_hip")]
    pelvis = rotations.exp(poses[:, :3])
    for k, side in zip(hips, (1, -1)):
        points[:, k] += pelvis @ np.array([0.02 * side, 0.0, 0.0])
    learnt = solve(body, points, SETTINGS)
    blind = solve(body, points, replace(SETTINGS, correction_sigma_m=1e-5))
    errors = [joint_error_mm(body, fit, poses, np.zeros(10), trans).mean() for fit in (learnt, blind)]
    assert errors[0] < errors[1]
    assert learnt.corrections_m[hips[0], 0] > 0.004
    assert learnt.corrections_m[hips[1], 0] < -0.004


def test_one_wild_point_is_outvoted(body: BodyModel) -> None:
    poses, trans = moderate(10)
    points = body.keypoints(NAMES, poses, np.zeros(10), trans)
    clean = joint_error_mm(body, solve(body, points, SETTINGS), poses, np.zeros(10), trans).mean()
    points[4, NAMES.index("right_ankle")] += [1.0, 0.5, 0]
    error = joint_error_mm(body, solve(body, points, SETTINGS), poses, np.zeros(10), trans)
    others = [j for j, n in enumerate(JOINT_NAMES) if n not in ("right_hip", "right_knee", "right_ankle", "right_foot")]
    assert error[4, others].mean() < clean + 15


def test_scale_is_found_only_when_asked(body: BodyModel) -> None:
    # S06: scale and the first beta are exchangeable; the prior splits them, a metric world fixes the scale.
    poses, trans = moderate(10)
    points = 3.0 * body.keypoints(NAMES, poses, np.zeros(10), trans)
    free = solve(body, points, replace(SETTINGS, free_scale=True))
    size = free.scale * np.ptp(body.rest_vertices(free.betas)[:, 1]) / np.ptp(body.template_m[:, 1])
    assert size == pytest.approx(3.0, rel=0.03)
    assert solve(body, points / 3, SETTINGS).scale == pytest.approx(1.0, abs=1e-6)


def test_fit_moves_with_the_world(body: BodyModel) -> None:
    poses, trans = moderate(4)
    points = body.keypoints(NAMES, poses, np.zeros(10), trans) + np.random.default_rng(1).normal(0, 0.01, (4, 25, 3))
    turn, shift = rotations.exp([0.3, -1.0, 2.0]), np.array([5.0, -3, 1])
    patient = replace(SETTINGS, tolerance=1e-9, iterations=100)
    here, there = solve(body, points, patient), solve(body, points @ turn.T + shift, patient)
    np.testing.assert_allclose(there.joints_m, here.joints_m @ turn.T + shift, atol=1e-4)
    np.testing.assert_allclose(there.betas, here.betas, atol=2e-3)
