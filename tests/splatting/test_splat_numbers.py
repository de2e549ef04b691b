# SPDX-License-Identifier: Apache-2.0
"""Hard cases of one splat's numbers: ellipse, energy, exponent, rotation, opacity and colour against float64 or closed
forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.conventions import (
    ALPHA_MAX,
    ELLIPSE_A,
    ELLIPSE_C,
    HALF_HEIGHT,
    HALF_WIDTH,
    LOG2_E,
    OPACITY_LOG2,
)
from studiorecon.splatting.cpu.harmonics import degree_supported
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.reference import leaves, project, render

from tests.made.gaussians import camera, from_values, rasterise
from tests.made.splatting_gradients import BACKGROUND, NEAR_M
from tests.made.splatting_limits import assert_finite, cpu, one, run

F = 500.0
STRAIGHT = Camera("straight", (65, 65), np.array([[F, 0, 32.5], [0, F, 32.5], [0, 0, 1.0]]), np.eye(4))


def splat(gaussian: Gaussians, view: Camera, antialias: bool = False) -> np.ndarray:
    """The record that the kernels make of one visible Gaussian."""
    rasteriser = Rasteriser(near_m=NEAR_M, threads=1, antialias=antialias)
    rasteriser.forward(gaussian, view)
    assert rasteriser.visible_count == 1
    return rasteriser._splats[:16].astype(np.float64)


def determinant(record: np.ndarray) -> float:
    """Of the dilated image covariance, px⁴: A = s·Syy/det and c = s/Syy with s = log2(e)/2."""
    half = 0.5 * float(LOG2_E)
    return half * half / (record[ELLIPSE_A] * record[ELLIPSE_C])


@pytest.mark.parametrize("depth_m", [0.3, 0.5, 1.0], ids=lambda z: f"G01 {z} m")
def test_a_near_blob_is_as_wide_as_its_points_fall(depth_m: float) -> None:
    """Linearised at its centre; nearer than 0.3 m a 5 cm blob would look 1e7 px wide or worse, hence the near plane."""
    view = Camera("near", (1001, 3), np.array([[F, 0, 500.5], [0, F, 1.5], [0, 0, 1.0]]), np.eye(4))
    points = np.random.default_rng(0).normal([0, 0, depth_m], 0.05, (400_000, 3))
    column = view.project(points)[0][:, 0]
    low, high = np.nanquantile(column, [0.158655, 0.841345])
    alpha = rasterise(
        one(means_m=[0, 0, depth_m], log_scales=np.log(0.05), logit_opacities=0.0), view, near_m=NEAR_M
    ).alpha[1]
    offset = np.abs(np.arange(1001) - 500)
    shown = (alpha > 0.02) & (offset > 10)
    sigma = np.median(offset[shown] / np.sqrt(-2 * np.log(alpha[shown] / 0.5)))
    assert sigma == pytest.approx((high - low) / 2, rel=0.05)


@pytest.mark.parametrize("depth_m", [2.0, 3.0], ids=lambda z: f"G03 {z} m")
def test_the_determinant_of_a_needle_does_not_cancel(depth_m: float) -> None:
    """10 m × 1 mm; a·c − b² in float32 gives 0 at 2 m, with or without the dilation, and is 4.7 % off at 3 m."""
    needle = one(
        means_m=[0, 0, depth_m], log_scales=np.log([10.0, 1e-3, 1e-3]), quaternions=[np.cos(0.2), 0, 0, np.sin(0.2)]
    )
    values = {name: value.detach() for name, value in leaves(needle).items()}
    covariance = project(
        values["means_m"], values["quaternions"], values["log_scales"].exp(), STRAIGHT, NEAR_M
    ).covariances[0]
    assert determinant(splat(needle, STRAIGHT)) == pytest.approx(float(torch.linalg.det(covariance)), rel=1e-4)


def test_g04_compensation_of_needles_is_finite_in_image_and_gradients() -> None:
    """From a·c − b², 0.76 % of random needles have a determinant at or below 0 and √ gives NaN (brush #522: 1 % at the
    first step)."""
    rng = np.random.default_rng(0)
    n = 4000
    scales = np.exp(rng.uniform(np.log(1e-7), np.log(10), (n, 3)))
    means = np.stack([rng.uniform(-0.5, 0.5, n), rng.uniform(-0.3, 0.3, n), rng.uniform(1, 5, n)], axis=1)
    needles = from_values(
        means, scales, rng.normal(size=(n, 4)), rng.uniform(0.05, 0.99, n), rng.normal(0, 0.3, (n, 4, 3))
    )
    rendering, gradients, rasteriser = run(needles, camera(160, 90), cpu(antialias=True))
    assert rasteriser.refused == 0
    assert rasteriser.visible_count > 100
    assert_finite(rendering, gradients)
    # gsplat #140: without a gradient through the compensation tiny splats never grow. Here a sub-pixel splat feels its
    # scale.
    tiny = one(log_scales=np.log(2e-3), logit_opacities=6.0, sh=0.5)
    compensated = cpu(antialias=True)
    compensated.forward(tiny, STRAIGHT)
    by_scale = compensated.backward(np.ones((65, 65, 3), np.float32)).log_scales
    assert (by_scale[0, :2] > 0).all()


def test_g05_a_splat_without_extent_is_the_low_pass_alone() -> None:
    """Conic 3.33 per px² and a radius of 2 px; the conic of a zero covariance is singular, and exp(−60)² is 0 in
    float32."""
    for log_scale in (-np.inf, -60.0):
        record = splat(one(log_scales=log_scale, logit_opacities=10.0), STRAIGHT)
        assert record[ELLIPSE_A] / (0.5 * LOG2_E) == pytest.approx(1 / 0.3, rel=1e-5)
        assert record[ELLIPSE_C] / (0.5 * LOG2_E) == pytest.approx(1 / 0.3, rel=1e-5)
        assert np.ceil(record[[HALF_WIDTH, HALF_HEIGHT]]).tolist() == [2, 2]


@pytest.mark.parametrize(
    ("sigma_px", "naive"), [pytest.param(s, n, id=f"G06 {s} px") for s, n in ((0.5, 2.2), (0.2, 8.5), (0.05, 121.0))]
)
def test_compensation_keeps_the_energy_of_small_splats(sigma_px: float, naive: float) -> None:
    """Energy = opacity · 2π√det, against what the undilated splat stands for; dilation alone multiplies it by
    ``naive``."""
    blob = one(means_m=[0, 0, 4.0], log_scales=np.log(4.0 * sigma_px / F), logit_opacities=6.0)
    true = 2 * np.pi * sigma_px**2 / (1 + np.exp(-6.0))
    energy = [
        2.0 ** record[OPACITY_LOG2] * 2 * np.pi * np.sqrt(determinant(record))
        for record in (splat(blob, STRAIGHT, a) for a in (True, False))
    ]
    assert energy[0] / true == pytest.approx(1, rel=0.01)
    assert energy[1] / true == pytest.approx(naive, rel=0.02)
    if sigma_px == 0.5:  # where the 1/255 threshold cuts off less than 1 %, the picture itself shows it
        assert cpu(antialias=True).forward(blob, STRAIGHT).alpha.sum() / true == pytest.approx(1, rel=0.02)


def test_g07_quaternions_of_any_norm_are_the_same_rotation_and_zero_is_none() -> None:
    """Unnormalised, norm 1.98 gives R₀₀ = −2.92."""
    scales, turn = np.log([0.3, 0.1, 0.02]), np.array([0.5, -0.3, 0.7, 0.2])
    pictures = [
        rasterise(one(quaternions=q, log_scales=scales), STRAIGHT, near_m=NEAR_M).rgb
        for q in (turn / np.linalg.norm(turn), 1.98 * turn / np.linalg.norm(turn), [1.0, 0, 0, 0], [0.0, 0, 0, 0])
    ]
    np.testing.assert_allclose(pictures[1], pictures[0], atol=1e-5)
    np.testing.assert_array_equal(pictures[3], pictures[2])
    assert np.abs(pictures[0] - pictures[2]).max() > 0.05


@pytest.mark.parametrize(
    "opacities", [pytest.param("0.99", id="G09 23 layers"), pytest.param("uniform", id="G09 2000 layers")]
)
def test_transmittance_of_many_layers_stays_above_the_stop(opacities: str) -> None:
    """The plain product underflows to T = 0 (log T = −798)."""
    values = np.full(23, 0.99) if opacities == "0.99" else np.random.default_rng(0).uniform(0, 0.6, 2000)
    n = len(values)
    means = np.stack([np.zeros(n), np.zeros(n), 2 + 0.001 * np.arange(n)], axis=1)
    stack = from_values(means, np.full((n, 3), 0.5), np.tile([1.0, 0, 0, 0], (n, 1)), values, np.zeros((n, 1, 3)))
    rendering, gradients, _ = run(stack, STRAIGHT)
    assert_finite(rendering, gradients)
    assert 1e-4 < 1 - rendering.alpha[32, 32] < 1e-2
    exact = render(leaves(stack), STRAIGHT, (0.1, 0.2, 0.3), NEAR_M)
    np.testing.assert_allclose(rendering.rgb, exact[0].detach().numpy(), atol=1e-5)


@pytest.mark.parametrize(
    "thin_px", [pytest.param(2.2e-3, id="G10 cov 100 99.99999"), pytest.param(0.5, id="G10 long blob")]
)
def test_exponents_of_long_blobs_are_right_far_from_the_centre(thin_px: float) -> None:
    """At 45°, 14 px long: the conic form in float32 gives −328 for −250, and errs by over 0.2 on 0.16 % of long
    blobs."""
    depth_m, half = 4.0, np.pi / 8
    scales = np.log(np.array([np.sqrt(199.99999), thin_px, thin_px]) * depth_m / F)
    blob = one(
        means_m=[0, 0, depth_m], log_scales=scales, quaternions=[np.cos(half), 0, 0, np.sin(half)], logit_opacities=9.0
    )
    found = rasterise(blob, STRAIGHT, near_m=NEAR_M).alpha.astype(np.float64)
    exact = render(leaves(blob), STRAIGHT, BACKGROUND, NEAR_M)[1].detach().numpy()
    both = (found > 1 / 255) & (exact > 1 / 255) & (exact < 0.99 * ALPHA_MAX)
    assert both.sum() > 50
    assert np.abs(np.log(found[both]) - np.log(exact[both])).max() < 1e-3
    # Where only one of the two draws, the other is within rounding of 1/255: nothing that should be dark is lit.
    assert np.abs(found - exact).max() < 1.01 / 255


def test_g13_logits_of_zero_one_and_seventeen_are_opacities_with_finite_gradients() -> None:
    for logit, opacity in ((-np.inf, 0.0), (np.inf, float(ALPHA_MAX)), (17.0, float(ALPHA_MAX))):
        rendering, gradients, _ = run(one(logit_opacities=logit), STRAIGHT)
        assert rendering.alpha[32, 32] == pytest.approx(opacity, abs=1e-6)
        assert_finite(rendering, gradients)


def test_g14_offsets_are_added_to_logits_so_opacity_stays_between_0_and_1() -> None:
    """Added to the opacity, sigmoid(3) + 0.2 = 1.153 and T = −0.153: later layers weigh negative; clamping kills the
    gradient."""
    blob = one(logit_opacities=3.0)
    for offset in (0.2, 20.0, -20.0):
        moved = replace(blob, logit_opacities=blob.logit_opacities + np.float32(offset))
        rendering, gradients, _ = run(moved, STRAIGHT)
        assert 0 <= rendering.alpha.min() <= rendering.alpha.max() < 1
        assert_finite(rendering, gradients)
    moved = replace(blob, logit_opacities=blob.logit_opacities + np.float32(0.2))
    assert rasterise(moved, STRAIGHT, near_m=NEAR_M).alpha[32, 32] == pytest.approx(1 / (1 + np.exp(-3.2)), rel=1e-3)


def ring(count: int) -> np.ndarray:
    angles = 2 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angles), np.sin(angles), 0.3 + 0 * angles], axis=1)


@pytest.mark.parametrize(
    ("directions", "degree"),
    [
        pytest.param(ring(1), 0, id="G15 one view"),
        pytest.param(ring(3), 0, id="G15 three views"),
        pytest.param(ring(4), 1, id="G15 four views"),
        pytest.param(np.repeat(ring(4), 20, axis=0) + 1e-3, 1, id="G15 twenty frames of each of four views"),
        pytest.param(ring(8), 1, id="G15 eight views"),
        pytest.param(ring(9), 2, id="G15 nine views"),
        pytest.param(ring(16), 3, id="G15 sixteen views"),
        pytest.param(ring(40), 3, id="G15 forty views"),
        pytest.param(np.concatenate([ring(4), np.zeros((5, 3)), np.full((5, 3), np.nan)]), 1, id="G15 no direction"),
        pytest.param(np.zeros((0, 3)), 0, id="G15 no view"),
    ],
)
def test_harmonics_need_as_many_directions_as_coefficients(directions: np.ndarray, degree: int) -> None:
    assert degree_supported(directions) == degree


def test_g16_a_gaussian_around_the_camera_shows_its_base_colour() -> None:
    """At the centre itself the direction is 0/0; it lies before the near plane and is not drawn. A hair before it, all
    is finite."""
    for depth_m in (0.0, 1.001 * NEAR_M):
        rendering, gradients, rasteriser = run(one(means_m=[0, 0, depth_m], log_scales=np.log(1e-3)), STRAIGHT)
        assert_finite(rendering, gradients)
        assert rasteriser.visible_count == (depth_m > NEAR_M)
