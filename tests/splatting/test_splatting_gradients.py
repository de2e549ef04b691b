# SPDX-License-Identifier: Apache-2.0
"""The rasteriser against float64 autograd, end to end: images and every gradient, on ordinary and on hard sets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.cpu.rasterise import Rasteriser, Rendering
from studiorecon.splatting.cuda.rasterise import GsplatRasteriser

from tests.made.gaussians import camera, from_values, rasterise, room
from tests.made.gsplat_stand_in import rasterization
from tests.made.splatting_gradients import BACKGROUND, FIELDS, NEAR_M, SCENES, Pictures, reference

EXACT: Mapping[str, float] = {}


def assert_close(
    rendering: Rendering,
    gradients: object,
    expected: tuple[Pictures, dict[str, np.ndarray]],
    limits: Mapping[str, float] = EXACT,
) -> None:
    """Mean absolute errors of images and relative L2 errors of every gradient."""
    for found, wanted, limit in zip(
        (rendering.rgb, rendering.alpha, rendering.depth_m), expected[0], (1e-6, 1e-6, 1e-5), strict=True
    ):
        assert np.abs(found - wanted).mean() < limit
    for name, wanted in expected[1].items():
        error = np.linalg.norm(getattr(gradients, name) - wanted) / np.linalg.norm(wanted)
        assert error < limits.get(name, 1e-4), f"{name}: relative error {error:.1e}"


@pytest.mark.parametrize("antialias", [pytest.param(False, id="as 3DGS"), pytest.param(True, id="G04 G06 compensated")])
@pytest.mark.parametrize(("gaussians", "view"), SCENES)
def test_image_and_gradients_agree_with_float64_autograd(gaussians: Gaussians, view: Camera, antialias: bool) -> None:
    by = np.random.default_rng(3).normal(size=(*view.hw, 5)).astype(np.float32)
    rasteriser = Rasteriser(near_m=NEAR_M, threads=2, antialias=antialias)
    rendering = rasteriser.forward(gaussians, view, BACKGROUND)
    gradients = rasteriser.backward(by[..., :3], by[..., 3], by[..., 4])
    assert_close(rendering, gradients, reference(gaussians, view, by, antialias))


@pytest.mark.parametrize("antialias", [False, True])
@pytest.mark.parametrize(("gaussians", "view"), SCENES[-3:])
def test_the_gsplat_back_end_hands_over_and_takes_back_what_the_cpu_does(
    gaussians: Gaussians, view: Camera, antialias: bool
) -> None:
    """With gsplat's function replaced by the reference: camera, axes, order of harmonics, background, depth, masks,
    screen gradient."""
    by = np.random.default_rng(3).normal(size=(*view.hw, 5)).astype(np.float32)
    ours = Rasteriser(near_m=NEAR_M, threads=1, antialias=antialias)
    theirs = GsplatRasteriser(near_m=NEAR_M, antialias=antialias, place="cpu", function=rasterization)
    ours.forward(gaussians, view, BACKGROUND)
    rendering = theirs.forward(gaussians, view, BACKGROUND)
    assert (theirs.refused, theirs.visible_count) == (
        ours.refused,
        pytest.approx(ours.visible_count, abs=0.03 * gaussians.count),
    )
    gradients = theirs.backward(by[..., :3], by[..., 3], by[..., 4])
    assert_close(rendering, gradients, reference(gaussians, view, by, antialias))
    screen = ours.backward(by[..., :3], by[..., 3], by[..., 4]).screen
    assert np.linalg.norm(gradients.screen - screen) < 1e-4 * np.linalg.norm(screen)
    with pytest.raises(ValueError, match="each takes one"):
        theirs.backward(by[..., :3])


def back_ends(antialias: bool = False) -> list[Rasteriser | GsplatRasteriser]:
    return [
        Rasteriser(near_m=NEAR_M, threads=2, antialias=antialias),
        GsplatRasteriser(near_m=NEAR_M, antialias=antialias, place="cpu", function=rasterization),
    ]


@pytest.mark.parametrize("rasteriser", back_ends(), ids=["cpu", "gsplat"])
def test_normals_are_the_shortest_axes_in_the_world_turned_towards_the_camera(rasteriser) -> None:
    view = camera(64, 48)
    tilt = 0.3
    # A disc facing the camera, turned by ±0.3 rad about the world's x, its shortest axis z first pointing away and then
    # towards us.
    for turn in (tilt, np.pi + tilt):
        half = [np.cos(turn / 2), np.sin(turn / 2), 0, 0]
        disc = from_values(
            np.array([[0, 0, 3.0]]),
            np.array([[0.8, 0.8, 0.01]]),
            np.array([half]),
            np.array([0.9]),
            np.zeros((1, 1, 3)),
        )
        rendering = rasteriser.forward(disc, view, normals=True)
        shown = rendering.alpha > 0.1
        assert shown.sum() > 100
        np.testing.assert_allclose(
            rendering.normals[shown], np.tile([0, np.sin(tilt), -np.cos(tilt)], (shown.sum(), 1)), atol=1e-5
        )
        assert not rendering.normals[rendering.alpha == 0].any()


def test_screen_gradient_is_the_gradient_by_the_projected_centre() -> None:
    gaussians, view = room(300, 9), camera(64, 48)
    # A smooth weight, because finite differences also feel pixels that cross the 1/255 threshold at the splat's rim; of
    # a linear weight that is ln(255)/255, 2 to 4 %.
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
