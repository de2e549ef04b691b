# SPDX-License-Identifier: Apache-2.0
"""The rasteriser against float64 autograd, end to end: images and every gradient, on ordinary and on hard sets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.blocks import block, morton_order, repose
from studiorecon.splatting.rasterise import Rasteriser, rasterise

from tests.foundations.splatting_scenes import camera, hard, room

NEAR_M = 0.01
BACKGROUND = (0.2, 0.5, 0.7)
FIELDS = ("means_m", "quaternions", "log_scales", "logit_opacities", "sh")


def reference(gaussians: Gaussians, view: Camera, by: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """rgb, alpha, expected depth, and gradients of Σ by·(rgb, alpha, depth), all by float64 autograd."""
    import torch
    from studiorecon.splatting.reference import leaves, render

    parameters = leaves(gaussians)
    rgb, alpha, depth_sum = render(parameters, view, BACKGROUND, NEAR_M)
    depth = torch.where(alpha > 1e-4, depth_sum / alpha.clamp_min(1e-9), torch.zeros_like(alpha))
    weights = torch.tensor(by, dtype=torch.float64)
    ((rgb * weights[..., :3]).sum() + (alpha * weights[..., 3]).sum() + (depth * weights[..., 4]).sum()).backward()
    gradients = {name: parameters[name].grad.numpy() for name in FIELDS}
    return rgb.detach().numpy(), alpha.detach().numpy(), depth.detach().numpy(), gradients


# The seeds are such that no pixel lies within rounding of the 1/255 threshold, where image and gradients jump.
@pytest.mark.parametrize(
    ("gaussians", "view"),
    [
        pytest.param(room(1500, 5), camera(96, 56), id="room"),
        pytest.param(hard(600, 1), camera(96, 56), id="hard"),
        pytest.param(hard(900, 7), camera(160, 90), id="hard, not whole tiles"),
        pytest.param(room(777, 9).with_sh_degree(1), camera(83, 41, (11.3, -6.2)), id="odd size, off-centre, SH 1"),
    ],
)
def test_image_and_gradients_agree_with_float64_autograd(gaussians: Gaussians, view: Camera) -> None:
    by = np.random.default_rng(3).normal(size=(*view.hw, 5)).astype(np.float32)
    rgb, alpha, depth, expected = reference(gaussians, view, by)
    rasteriser = Rasteriser(near_m=NEAR_M, threads=2)
    rendering = rasteriser.forward(gaussians, view, BACKGROUND)
    assert np.abs(rendering.rgb - rgb).mean() < 1e-6
    assert np.abs(rendering.alpha - alpha).mean() < 1e-6
    assert np.abs(rendering.depth_m - depth).mean() < 1e-5
    gradients = rasteriser.backward(by[..., :3], by[..., 3], by[..., 4])
    for name in FIELDS:
        found, wanted = getattr(gradients, name), expected[name]
        error = np.linalg.norm(found - wanted) / np.linalg.norm(wanted)
        assert error < 1e-4, f"{name}: relative error {error:.1e}"


def test_screen_gradient_is_the_gradient_by_the_projected_centre() -> None:
    gaussians, view = room(300, 9), camera(64, 48)
    # A smooth weight, because finite differences also feel pixels that cross the 1/255 threshold at the splat's rim; of a linear
    # weight that is ln(255)/255, 2 to 4 %.
    by = (view.pixel_centres() @ [[0.01, 0.02, -0.01], [0.02, -0.01, 0.02]]).astype(np.float32)
    # Moving the principal point moves the centre and nothing else.
    rasteriser = Rasteriser(near_m=NEAR_M, threads=1)
    for index in range(60):
        one = gaussians.take(np.array([index]))
        rasteriser.forward(one, view)
        found = rasteriser.backward(by).screen[0]
        if found > 0.1:
            break
    step, slopes = 1e-2, []
    for axis in range(2):
        losses = []
        for sign in (-1, 1):
            intrinsics = view.intrinsics.copy()
            intrinsics[axis, 2] += sign * step
            moved = rasteriser.forward(one, replace(view, intrinsics=intrinsics))
            losses.append(float((moved.rgb * by).sum(dtype=np.float64)))
        slopes.append((losses[1] - losses[0]) / (2 * step))
    assert found == pytest.approx(np.hypot(*slopes), rel=6e-2)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_the_same_thread_count_repeats_bit_for_bit(threads: int) -> None:
    gaussians, view = hard(900, 7), camera(160, 90)
    by = np.random.default_rng(1).normal(size=(*view.hw, 3)).astype(np.float32)
    results = []
    for _ in range(2):
        rasteriser = Rasteriser(near_m=NEAR_M, threads=threads)
        rendering = rasteriser.forward(gaussians, view)
        gradients = rasteriser.backward(by)
        results.append([rendering.rgb, rendering.depth_m] + [getattr(gradients, name) for name in FIELDS])
    for first, second in zip(*results, strict=True):
        assert first.tobytes() == second.tobytes()


def test_the_image_does_not_depend_on_threads_or_on_the_order_of_gaussians() -> None:
    gaussians, view = room(1500, 5), camera(96, 56)
    once = rasterise(gaussians, view, near_m=NEAR_M, threads=1)
    np.testing.assert_array_equal(once.rgb, rasterise(gaussians, view, near_m=NEAR_M, threads=3).rgb)
    shuffled = gaussians.take(np.random.default_rng(2).permutation(gaussians.count))
    np.testing.assert_array_equal(once.rgb, rasterise(shuffled, view, near_m=NEAR_M, threads=1).rgb)


@pytest.mark.parametrize("count", [0, 1, 16, 17])
@pytest.mark.parametrize("wh", [(1, 1), (16, 16), (17, 15), (50, 3)])
def test_any_number_of_gaussians_and_any_image_size(count: int, wh: tuple[int, int]) -> None:
    rasteriser = Rasteriser(near_m=NEAR_M, threads=2)
    rendering = rasteriser.forward(room(40, 1).take(np.arange(count)), camera(*wh), BACKGROUND)
    gradients = rasteriser.backward(np.ones_like(rendering.rgb))
    assert rendering.rgb.shape == (wh[1], wh[0], 3)
    assert gradients.sh.shape == (count, 16, 3)
    assert np.isfinite(rendering.rgb).all()
    if count == 0:
        np.testing.assert_array_equal(rendering.rgb, np.broadcast_to(np.float32(BACKGROUND), rendering.rgb.shape))
        assert not rendering.alpha.any()
        assert not rendering.depth_m.any()


def test_buffers_do_not_remember_an_earlier_scene() -> None:
    small, large, view = room(200, 1), room(1500, 5), camera(96, 56)
    by = np.ones((56, 96, 3), np.float32)
    reused, fresh = Rasteriser(near_m=NEAR_M, threads=2), Rasteriser(near_m=NEAR_M, threads=2)
    for scene, seen in ((large, view), (small, camera(33, 70)), (small, view)):
        reused.forward(scene, seen)
    fresh.forward(small, view)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(reused.backward(by), name), getattr(fresh.backward(by), name))


def test_reposed_blocks_render_like_new_gaussians() -> None:
    canonical, view, rng = room(333, 4), camera(64, 40), np.random.default_rng(5)
    canonical = canonical.take(morton_order(canonical.means_m))
    means = canonical.means_m + rng.normal(0, 0.1, canonical.means_m.shape).astype(np.float32)
    quaternions = rng.normal(size=canonical.quaternions.shape).astype(np.float32)
    blocked = block(canonical)
    repose(blocked, means, quaternions)
    expected = rasterise(replace(canonical, means_m=means, quaternions=quaternions), view, near_m=NEAR_M, threads=1)
    np.testing.assert_array_equal(rasterise(blocked, view, near_m=NEAR_M, threads=1).rgb, expected.rgb)


def test_feature_colours_render_as_a_map_of_classes() -> None:
    gaussians, view = room(1500, 5), camera(96, 56)
    labels = (gaussians.means_m[:, :1] > 0).astype(np.float32).repeat(3, axis=1)
    shown = rasterise(gaussians.with_colours(labels), view, near_m=NEAR_M, threads=1)
    none = rasterise(gaussians.with_colours(1 - labels), view, near_m=NEAR_M, threads=1)
    np.testing.assert_allclose(shown.rgb[..., 0] + none.rgb[..., 0], shown.alpha, atol=2e-6)
