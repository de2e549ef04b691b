# SPDX-License-Identifier: Apache-2.0
"""Hard cases of splatting: values that crashed, poisoned or misled other rasterisers."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import concatenate
from studiorecon.splatting.cpu import rasterise as rasterise_module
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.cuda.rasterise import GsplatRasteriser
from studiorecon.splatting.train.terms import Density

from tests.made.gaussians import camera, room
from tests.made.gsplat_stand_in import rasterization
from tests.made.splatting_limits import BASE, DEGENERATE, NEAR_M, POISON, assert_finite, cpu, one, run  # noqa: F401
from tests.made.training import of_alpha, photometric


def gsplat(antialias: bool = False) -> GsplatRasteriser:
    """gsplat's back end over the float64 stand-in, which refuses what the real one would crash on."""
    return GsplatRasteriser(near_m=NEAR_M, antialias=antialias, place="cpu", function=rasterization)


BACK_ENDS = [pytest.param(cpu, id="cpu"), pytest.param(gsplat, id="gsplat")]
ANTIALIAS = [pytest.param(False, id="as 3DGS"), pytest.param(True, id="compensated")]


def view_for(back_end: Callable) -> Camera:
    """Sizes that no tile divides; the stand-in looks at every pixel of every Gaussian and gets fewer of them."""
    return camera(97, 53) if back_end is cpu else camera(49, 27)


@cache
def clean_rgb(back_end: Callable) -> np.ndarray:
    """What the room looks like without anything poisoned in it."""
    return back_end().forward(room(300, 2), view_for(back_end), (0.1, 0.2, 0.3)).rgb


@pytest.mark.parametrize("back_end", BACK_ENDS)
@pytest.mark.parametrize("changes", [pytest.param(v, id=k) for k, v in POISON.items()])
def test_a_poisoned_gaussian_is_left_out_and_counted(changes: dict, back_end) -> None:
    clean, view = room(300, 2), view_for(back_end)
    poisoned = concatenate([clean.take(np.arange(100)), one(**changes), clean.take(np.arange(100, 300))])
    rendering, gradients, rasteriser = run(poisoned, view, back_end())
    assert rasteriser.refused == 1
    assert_finite(rendering, gradients)
    np.testing.assert_array_equal(rendering.rgb, clean_rgb(back_end))
    assert not gradients.means_m[100].any()
    assert not gradients.sh[100].any()


@pytest.mark.parametrize("antialias", ANTIALIAS)
@pytest.mark.parametrize("back_end", BACK_ENDS)
@pytest.mark.parametrize("changes", [pytest.param(v, id=k) for k, v in DEGENERATE.items()])
def test_a_degenerate_gaussian_gives_finite_images_and_gradients(changes: dict, back_end, antialias: bool) -> None:
    scene, view = concatenate([room(300, 2), one(**changes)]), view_for(back_end)
    rendering, gradients, _ = run(scene, view, back_end(antialias))
    assert_finite(rendering, gradients)
    np.testing.assert_allclose(
        rendering.rgb, cpu(antialias).forward(scene, view, (0.1, 0.2, 0.3)).rgb, atol=1e-3, rtol=1e-4
    )


@pytest.mark.parametrize("back_end", BACK_ENDS)
def test_side_outputs_of_a_poisoned_and_degenerate_set_are_finite(back_end) -> None:
    bad = [one(**changes) for changes in [*POISON.values(), *DEGENERATE.values()]]
    rendering = back_end().forward(concatenate([room(300, 2), *bad]), view_for(back_end), normals=True)
    requested_size = {name: value for name, value in vars(rendering).items() if value is not None}
    assert {"rgb", "alpha", "normals"} <= set(requested_size)
    for name, value in requested_size.items():
        assert np.isfinite(value).all(), name
    length = np.linalg.norm(rendering.normals, axis=2)
    assert ((abs(length - 1) < 1e-5) | (length == 0)).all()


def test_g01_nothing_nearer_than_the_near_plane_is_drawn() -> None:
    view = camera(64, 48)
    for depth_m, drawn in ((1e-3, False), (0.0, False), (-0.5, False), (0.5, True)):
        blob = one(means_m=view.centre_m + view.forward * depth_m, log_scales=np.log(0.05))
        assert run(blob, view)[0].alpha.any() == drawn, depth_m


def test_g02_a_blob_far_outside_the_frame_does_not_reach_it() -> None:
    view = camera(64, 48)
    for degrees in (60, 70, 80):
        direction = view.rotation_camera_from_world.T @ [np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))]
        blob = one(means_m=view.centre_m + 3 * direction, log_scales=np.log([0.01, 0.01, 0.3]), logit_opacities=3.0)
        assert not run(blob, view)[0].alpha.any()


def test_g11_equal_depths_are_drawn_in_order_of_index() -> None:
    red, blue = (
        one(sh=np.concatenate([[colour], np.zeros((15, 3))]), logit_opacities=0.0)
        for colour in ([1.5, -2, -2], [-2, -2, 1.5])
    )
    view = Camera("straight", (33, 33), np.array([[40, 0, 16.5], [0, 40, 16.5], [0, 0, 1.0]]), np.eye(4))
    first = run(concatenate([red, blue]), view)[0].rgb[16, 16]
    second = run(concatenate([blue, red]), view)[0].rgb[16, 16]
    np.testing.assert_allclose(first - [0.025, 0.05, 0.075], (second - [0.025, 0.05, 0.075])[[2, 1, 0]], atol=1e-6)
    assert first[0] > 1.5 * first[2]
    seventeen = concatenate([red] * 8 + [blue] * 9)
    np.testing.assert_array_equal(run(seventeen, view)[0].rgb, run(seventeen, view)[0].rgb)


def test_too_many_pairs_are_a_sentence_not_a_crash(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rasterise_module, "PAIRS_MAX", 100)
    with pytest.raises(UserError, match=r"camera test: .* cover .* tiles"):
        Rasteriser(near_m=NEAR_M, threads=1).forward(room(500, 1), camera(97, 53))


def test_i07_a_frame_with_everything_masked_weighs_nothing() -> None:
    rng = np.random.default_rng(0)
    loss, gradient = photometric(rng.random((20, 30, 3)), rng.random((20, 30, 3)), np.zeros((20, 30)), 0.7, 0.3)
    assert loss == 0
    assert not gradient.any()
    loss, gradient = of_alpha(Density(0.1), np.full((20, 30), 0.5, np.float32), np.zeros((20, 30), np.float32))
    assert loss == 0
    assert not gradient.any()


def test_i08_an_error_inside_a_person_does_not_reach_the_loss_outside() -> None:
    # Naive, map averaged outside the mask: similarity 0.991 for pictures that are equal there.
    rng = np.random.default_rng(0)
    target = rng.random((48, 64, 3)).astype(np.float32)
    weight = np.ones((48, 64), np.float32)
    weight[15:35, 20:40] = 0
    rendered = np.where(weight[..., None] > 0, target, 1 - target).astype(np.float32)
    loss, gradient = photometric(rendered, target, weight, 0.7, 0.3)
    assert loss == pytest.approx(0, abs=1e-6)
    assert np.abs(gradient).max() < 1e-7
    assert photometric(rendered, target, None, 0.7, 0.3)[0] > 0.05


@pytest.mark.parametrize("shown", [1.0, 0.5, 0.25], ids="I09-{:g}".format)
def test_the_masked_loss_divides_by_the_mask(shown: float) -> None:
    # Naive, person blanked in both and the whole map averaged: the error shrinks with the share of the picture that is
    # shown.
    weight = np.zeros((40, 100), np.float32)
    weight[:, : round(100 * shown)] = 1
    rng = np.random.default_rng(0)
    target = rng.random((40, 100, 3)).astype(np.float32)
    rendered = np.where(target > 0.5, target - np.float32(0.3), target + np.float32(0.3))
    assert photometric(rendered, target, weight, 1.0, 0.0)[0] == pytest.approx(0.3, rel=1e-6)
    whole, _ = photometric(rendered, target, None, 0.0, 1.0)
    masked, _ = photometric(rendered, target, weight, 0.0, 1.0)
    # Windows that reach behind the mask see the target's own colours there and less of the error.
    assert 0.75 * whole < masked < 1.1 * whole


@pytest.mark.parametrize("hidden", [0.0, 1.0, np.nan], ids="I10-{:g}".format)
def test_what_a_mask_hides_does_not_enter_the_windows_beside_it(hidden: float) -> None:
    # Naive, windows normalised by their count: the local mean of a constant 0.5 runs from 0.66 down to 0.006.
    weight = np.zeros((40, 60), np.float32)
    weight[:, :30] = 1
    target = np.full((40, 60, 3), 0.5, np.float32)
    rendered = np.where(weight[..., None] > 0, target, np.float32(hidden)).astype(np.float32)
    loss, gradient = photometric(rendered, target, weight, 0.0, 1.0)
    assert loss == pytest.approx(0, abs=1e-6)
    assert np.abs(gradient).max() < 1e-7


@pytest.mark.parametrize(("alpha", "prior"), [(0.0, 0.0), (1.0, 0.0), (0.5, 0.1201)])
def test_i14_the_density_prior_is_finite_everywhere(alpha: float, prior: float) -> None:
    loss, gradient = of_alpha(Density(1.0), np.full((4, 4), alpha, np.float32), None)
    assert loss == pytest.approx(prior, abs=1e-4)
    np.testing.assert_allclose(gradient * 16, np.tanh(0.5 - alpha), atol=1e-6)
