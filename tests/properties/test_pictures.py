# SPDX-License-Identifier: Apache-2.0
"""What must hold for any picture: it does not depend on where its world stands, nor on any order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from studiorecon.enhance.backends import ResidualTransfer, Unchanged
from studiorecon.geometry.rotations import to_quaternion
from studiorecon.images.exposure import Overlap, solve_gains
from studiorecon.images.plate import temporal_modes
from studiorecon.images.regions import dilate, signed_distance_px, without_holes, without_islands
from studiorecon.images.silhouette import mesh_depth
from studiorecon.images.transfer import Transfer, residual_source
from studiorecon.models.protocols import Moment
from studiorecon.scene.gaussians import Gaussians
from studiorecon.views import forward_warp

from tests.made.cameras import ring
from tests.made.gaussians import camera, rasterise, room
from tests.properties.moved_worlds import FEW, MANY, World, worlds

TRANSFER = Transfer(depth_tolerance=0.03, angle_power=4.0, feather_px=4.0, smooth_px=1.0)


@FEW
@given(st.integers(0, 1000), st.permutations(range(7)))
def test_the_plate_does_not_depend_on_the_order_of_frames(seed: int, order: list[int]) -> None:
    """Two thirds show the room with noise, the rest something else; no tie is close enough for the order to matter."""
    rng = np.random.default_rng(seed)
    frames = np.clip(100 + rng.integers(-2, 3, (7, 9, 11, 3)), 0, 255).astype(np.uint8)
    frames[:2] = 200
    free = np.ones((7, 9, 11), bool)
    one, other = temporal_modes(frames, free, 8.0), temporal_modes(frames[order], free[order], 8.0)
    for a, b in zip(one, other):
        np.testing.assert_allclose(a, b, atol=1e-4)


@FEW
@given(st.integers(0, 1000), st.permutations(range(3)))
def test_the_residual_transfer_leaves_a_render_that_is_right_and_knows_no_order_of_cameras(
    seed: int, order: list[int]
) -> None:
    rng = np.random.default_rng(seed)
    cameras = [c.resized((40, 22)) for c in ring(4)]
    depth = np.full((22, 40), 3.0, np.float32)
    photos = [rng.integers(0, 255, (22, 40, 3), dtype=np.uint8) for _ in range(3)]
    image = rng.random((22, 40, 3)).astype(np.float32)
    moment = Moment(cameras[3], 0.0, depth, np.zeros((22, 40), np.float32))
    right = [residual_source(c, p, p, depth, TRANSFER) for c, p in zip(cameras, photos)]
    np.testing.assert_array_equal(
        ResidualTransfer(lambda frame: right, 1.0, TRANSFER).enhance(image, photos[0], moment), image
    )
    wrong = [residual_source(c, p, p[::-1], depth, TRANSFER) for c, p in zip(cameras, photos)]
    one = ResidualTransfer(lambda frame: wrong, 1.0, TRANSFER).enhance(image, photos[0], moment)
    other = ResidualTransfer(lambda frame: [wrong[i] for i in order], 1.0, TRANSFER).enhance(image, photos[0], moment)
    np.testing.assert_allclose(one, other, atol=1e-5)
    np.testing.assert_array_equal(Unchanged().enhance(image, photos[0], moment), image)


@FEW
@given(st.integers(0, 1000), st.permutations(range(4)))
def test_gains_follow_their_cameras_and_have_a_mean_of_one(seed: int, order: list[int]) -> None:
    rng = np.random.default_rng(seed)
    planted = np.exp(rng.normal(0, 0.1, (4, 3)))
    planted /= np.exp(np.log(planted).mean(axis=0))
    pairs = [(0, 1), (1, 2), (2, 3), (0, 3)]
    found = solve_gains(4, [Overlap(i, j, np.log(planted[i] / planted[j]), 100 + i) for i, j in pairs])
    np.testing.assert_allclose(found, planted, rtol=1e-9)
    place = np.argsort(order)
    shuffled = [Overlap(int(place[i]), int(place[j]), np.log(planted[i] / planted[j]), 100 + i) for i, j in pairs]
    np.testing.assert_allclose(solve_gains(4, shuffled), planted[order], rtol=1e-9)


@MANY
@given(st.integers(0, 1000), st.sampled_from([1, 3, 7]))
def test_operations_on_regions_only_grow_or_only_shrink(seed: int, size: int) -> None:
    region = np.random.default_rng(seed).random((20, 25)) < 0.3
    assert (dilate(region, size) >= region).all()
    assert (without_holes(region, 9) >= region).all()
    assert (without_islands(region, 3) <= region).all()
    np.testing.assert_array_equal(signed_distance_px(region) > 0, region)
    np.testing.assert_allclose(signed_distance_px(~region), -signed_distance_px(region), atol=1e-5)
    for constant in (np.zeros((20, 25), bool), np.ones((20, 25), bool)):
        for result in (dilate(constant, size), without_islands(constant, 3), without_holes(constant, 9)):
            np.testing.assert_array_equal(result, constant)


def moved_gaussians(gaussians: Gaussians, world: World) -> Gaussians:
    """The set in another world; colours must not depend on direction."""
    turned = to_quaternion(world.rotation @ rotation_of(gaussians.quaternions))
    return replace(
        gaussians,
        means_m=world.points(gaussians.means_m.astype(np.float64)).astype(np.float32),
        quaternions=turned.astype(np.float32),
        log_scales=(gaussians.log_scales + np.log(world.scale)).astype(np.float32),
    )


def rotation_of(quaternions: np.ndarray) -> np.ndarray:
    from studiorecon.geometry.rotations import from_quaternion

    return from_quaternion(quaternions.astype(np.float64))


@FEW
@given(worlds(), st.integers(0, 20))
def test_a_rendered_picture_does_not_depend_on_where_its_world_stands(world: World, seed: int) -> None:
    near = replace(world, shift=world.shift / 10)  # means are float32: G and C08 say what distance costs
    gaussians = room(400, seed)
    gaussians = replace(gaussians, sh=gaussians.sh[:, :1])
    view = camera(64, 40)
    here = rasterise(gaussians, view, near_m=0.1)
    there = rasterise(moved_gaussians(gaussians, near), near.camera(view), near_m=0.1 * near.scale)
    difference = np.abs(here.rgb - there.rgb)
    assert np.quantile(difference, 0.99) < 2e-3
    assert difference.mean() < 1e-4
    assert np.abs(here.alpha - there.alpha).mean() < 1e-4


def made_source(seed: int, world: World | None = None) -> forward_warp.WarpSource:
    rng = np.random.default_rng(seed)
    view = ring(4)[0].resized((64, 36))
    depth = (4.5 + 0.3 * np.sin(np.arange(64) / 9.0)[None] + np.zeros((36, 1))) * (world.scale if world else 1)
    return forward_warp.warp_source(
        world.camera(view) if world else view, rng.random((36, 64, 3)), np.ones((36, 64), bool), depth, 0.04
    )


@FEW
@given(st.integers(0, 50), st.permutations(range(3)))
def test_carried_photos_blend_the_same_in_any_order_and_an_empty_one_adds_nothing(seed: int, order: list[int]) -> None:
    sources = [made_source(seed + i) for i in range(3)]
    target = ring(12)[1].resized((64, 36))
    one = forward_warp.blend_photos(target, sources, 3, 0.02, 0.3)
    other = forward_warp.blend_photos(target, [sources[i] for i in order], 3, 0.02, 0.3)
    empty = replace(sources[0], usable=np.zeros((36, 64), bool))
    with_empty = forward_warp.blend_photos(target, [*sources, empty], 3, 0.02, 0.3)
    for a, b, c in zip(one, other, with_empty):
        np.testing.assert_allclose(b, a, atol=1e-5)
        np.testing.assert_allclose(c, a, atol=1e-6)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_of_two_triangles_is_the_one_that_is_seen(order: tuple[int, int]) -> None:
    view = ring(1)[0].resized((64, 36))
    corners = np.array([[-9.0, -9.0], [60.0 * 3, -9.0], [-9.0, 36.0 * 4]])
    vertices = np.concatenate([view.unproject(corners, np.full(3, depth)) for depth in (2.0, 3.0)])
    found = mesh_depth(vertices, np.array([[0, 1, 2], [3, 4, 5]])[list(order)], view)
    np.testing.assert_allclose(found, 2.0, rtol=1e-5)
