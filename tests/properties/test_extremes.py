# SPDX-License-Identifier: Apache-2.0
"""The foundations at the ends of their range: worlds from a millimetre to a kilometre, lenses from a fisheye's to a
telescope's, rays that are nearly parallel, numbers at the ends of float32.

Few cases, the same ones, in every push; ``STUDIORECON_FUZZ`` is how many of each a night draws, other ones every time.
"""

from __future__ import annotations

import os

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st
from studiorecon.body.avatar.posing import Posing
from studiorecon.footage.video import to_bytes
from studiorecon.geometry import rotations
from studiorecon.geometry.camera_path import gaps_around, interpolate_cameras, scene_centre
from studiorecon.geometry.distortion import distort, fold_radius, undistort
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.images import metrics
from studiorecon.images.warp import sample, warp
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.cpu.rasterise import Rasteriser

from tests.made.cameras import look_at
from tests.properties.moved_worlds import World, numbers, turns, vectors

NIGHT = int(os.environ.get("STUDIORECON_FUZZ", "0"))
CASES = settings(
    max_examples=NIGHT or 30,
    deadline=None,
    derandomize=not NIGHT,
    database=None,
    suppress_health_check=list(HealthCheck),
)
WH = (640, 360)


def powers(low: float, high: float) -> st.SearchStrategy[float]:
    """10 to the power of anything between."""
    return numbers(low, high).map(lambda exponent: float(10.0**exponent))


def camera(centre: np.ndarray, target: np.ndarray, focal_px: float, name: str = "c") -> Camera:
    return look_at(name, centre, target, WH, focal_px)


def is_rotation(matrices: np.ndarray) -> bool:
    apart = np.abs(matrices @ np.swapaxes(matrices, -1, -2) - np.eye(3)).max(initial=0.0)
    return bool(apart < 1e-9 and (np.linalg.det(matrices) > 0).all())


@CASES
@given(powers(-3, 3), powers(1.3, 4.7), turns(), vectors(100.0), numbers(0, 640), numbers(0, 360), powers(-1, 2))
def test_a_pixel_and_its_point_are_one_in_every_world(
    scale: float, focal_px: float, turn: np.ndarray, shift: np.ndarray, u: float, v: float, depth: float
) -> None:
    view = World(turn, scale * shift, scale).camera(camera(np.array([3.0, 0, 1.5]), np.array([0, 0, 1.0]), focal_px))
    point = view.unproject(np.array([u, v]), np.array(scale * depth))
    pixel, z = view.project(point)
    # A centre that is far away from the origin leaves so many digits for what is near it.
    digits = 1e-15 * (np.linalg.norm(view.centre_m) + scale * depth) / (scale * depth)
    assert z == pytest.approx(scale * depth, rel=100 * digits)
    np.testing.assert_allclose(pixel, [u, v], atol=1e-9 + 100 * digits * (focal_px + 640))


@CASES
@given(
    st.integers(0, 2**31), powers(-3, 3), powers(1.7, 4.3), st.integers(2, 5), powers(-6, 0.3), turns(), vectors(20.0)
)
def test_a_point_is_where_its_rays_meet_or_nobody_says_where(
    seed: int, scale: float, focal_px: float, views: int, apart: float, turn: np.ndarray, shift: np.ndarray
) -> None:
    """Cameras ``apart`` radians from one another, down to a fifth of an arc second."""
    rng, world = np.random.default_rng(seed), World(turn, scale * shift, scale)
    azimuths = apart * np.arange(views)
    rig = [
        world.camera(camera(np.array([3 * np.cos(a), 3 * np.sin(a), 1.5]), np.array([0, 0, 1.0]), focal_px, f"c{k}"))
        for k, a in enumerate(azimuths)
    ]
    reach = 0.4 * 3 * 180 / focal_px
    truth = world.points(np.array([0, 0, 1.0]) + min(reach, 1.0) * rng.uniform(-0.5, 0.5, (6, 3)))
    pixels = np.stack([view.project(truth)[0] for view in rig])
    limits = Limits(near_m=0.05 * scale, min_angle_deg=2.0)
    found = {
        solver: triangulate(pixels, np.ones(pixels.shape[:-1]), rig, limits, solver=solver)  # type: ignore[arg-type]
        for solver in ("robust", "huber", "dlt")
    }
    for solver, one in found.items():
        assert np.isfinite(one.points_m[one.valid]).all(), solver
        assert (one.covariance_m2[one.valid].diagonal(axis1=-2, axis2=-1) >= 0).all(), solver
    # Rounding of a pixel, seen over the angle between the outermost rays.
    angle = min(apart * (views - 1), 1.0)
    rounding = 1e-15 * (np.abs(pixels).max() / focal_px + np.linalg.norm(scale * shift) / scale + 10) / angle
    wrong = np.linalg.norm(found["robust"].points_m - truth, axis=-1) / (3 * scale)
    assert (wrong[found["robust"].valid] < 1e-9 + 1e4 * rounding).all()
    if np.degrees(apart) > 5 and np.degrees(angle) < 150:
        assert found["robust"].valid.all(), "exact pixels of cameras that stand apart"
    if np.degrees(angle) < 1.5:
        assert not found["robust"].verified.any(), "nothing is verified that nearly parallel rays say"


@CASES
@given(vectors(1.0), st.sampled_from(["tiny", "small", "half", "turn"]), powers(-17, -1), turns())
def test_turns_of_any_size_go_there_and_back(direction: np.ndarray, size: str, short: float, other: np.ndarray) -> None:
    assume(np.linalg.norm(direction) > 1e-3)
    axis = direction / np.linalg.norm(direction)
    angle = {"tiny": short * 1e-290, "small": short, "half": np.pi - short, "turn": 2 * np.pi - short}[size]
    turn = rotations.exp(angle * axis)
    assert is_rotation(turn)
    np.testing.assert_allclose(rotations.exp(rotations.log(turn)), turn, atol=1e-7 if size == "half" else 1e-12)
    quaternion = rotations.to_quaternion(turn)
    np.testing.assert_allclose(rotations.from_quaternion(quaternion), turn, atol=1e-12)
    np.testing.assert_allclose(rotations.from_quaternion(-1e-11 * quaternion), turn, atol=1e-12)
    # The length of the turn's vector is rounded where a whole turn is: to a few units in its last place.
    rounded = 4 * np.spacing(2 * np.pi)
    assert rotations.angle(np.eye(3), turn) == pytest.approx(min(angle, 2 * np.pi - angle), rel=1e-6, abs=rounded)
    for share in (0.0, 0.3, 1.0):
        assert is_rotation(rotations.slerp(other, other @ turn, share))
    middle, _ = rotations.mean(np.stack([other, other @ turn]))
    assert is_rotation(middle)
    assert is_rotation(rotations.project_to_so3(other * 1e-5 + 1e-9 * turn))


@CASES
@given(
    st.integers(0, 2**31), st.sampled_from(["opencv", "fisheye"]), st.tuples(*[numbers(-0.5, 0.5)] * 4), powers(-6, 0.5)
)
def test_distortion_is_undone_inside_the_fold_and_refused_beyond(
    seed: int, model: str, coefficients: tuple[float, ...], reach: float
) -> None:
    k = np.array(coefficients) * ([1, 0.5, 0.01, 0.01] if model == "opencv" else [1, 0.5, 0.2, 0.1])
    around = np.random.default_rng(seed).uniform(-reach, reach, (20, 2))
    fold = fold_radius(model, k)
    radius = np.linalg.norm(around, axis=-1)
    inside = (np.arctan(radius) if model == "fisheye" else radius) < 0.9 * fold
    found, valid = undistort(distort(around, model, k), model, k)
    assert np.isnan(found[~valid]).all()
    again = distort(np.where(valid[:, None], found, 0.0), model, k)
    np.testing.assert_allclose(again[valid], distort(around, model, k)[valid], atol=1e-8)
    if model == "fisheye" or not k[2:].any():
        assert valid[inside].all()
        np.testing.assert_allclose(found[inside & valid], around[inside & valid], rtol=1e-6, atol=1e-9)


@CASES
@given(st.integers(0, 2**31), powers(-3, 3), powers(1.3, 4.7), st.integers(1, 8), st.sampled_from(["slerp", "look_at"]))
def test_ways_between_cameras_are_cameras(seed: int, scale: float, focal_px: float, count: int, turn: str) -> None:
    rng = np.random.default_rng(seed)
    places = scale * rng.normal([0, 0, 1.5], [3, 3, 0.5], (count, 3))
    targets = scale * rng.normal([0, 0, 1.0], 0.3, (count, 3))
    rig = [camera(p, t, focal_px, f"c{k}") for k, (p, t) in enumerate(zip(places, targets))]
    centre = scene_centre(rig)
    assert np.isfinite(centre).all()
    gaps = gaps_around(rig)
    assert sum(gap.rad for gap in gaps) == pytest.approx(2 * np.pi)
    for gap in gaps:
        views, _ = interpolate_cameras(rig[gap.first], rig[gap.second], 5, centre, rotations=turn, clearance=0.6)  # type: ignore[arg-type]
        assert is_rotation(np.stack([view.rotation_camera_from_world for view in views]))
        assert np.isfinite([view.centre_m for view in views]).all()


FLOATS = np.array(
    [0.0, -0.0, 1e-45, -1e-38, 1e-20, 0.5, 1.0, -3.0, 255.0, 1e10, -1e30, 3.4e38, np.inf, -np.inf, np.nan], np.float32
)


@CASES
@given(st.integers(0, 2**31), numbers(0, 1))
def test_pictures_of_any_number_are_measured_and_written(seed: int, wild: float) -> None:
    rng = np.random.default_rng(seed)
    picture = rng.random((24, 32, 3)).astype(np.float32)
    strange = rng.random(picture.shape) < wild
    picture[strange] = rng.choice(FLOATS, int(strange.sum()))
    first = to_bytes(picture)
    second = np.full_like(first, rng.integers(0, 256)) if rng.random() < 0.3 else to_bytes(rng.random(first.shape))
    similarity = metrics.ssim_map(first, second)
    assert np.isfinite(similarity).all()
    assert -1.0 - 1e-9 <= similarity.min() <= similarity.max() <= 1.0
    measured = metrics.psnr(first, second)
    assert measured is None or measured >= 0
    assert metrics.ssim(metrics.ssim_map(first, first)) == pytest.approx(1.0)


@CASES
@given(st.integers(0, 2**31), st.sampled_from(["nearest", "linear", "cubic"]), numbers(0, 1))
def test_a_picture_read_anywhere_gives_what_is_in_it(seed: int, how: str, wild: float) -> None:
    rng = np.random.default_rng(seed)
    image = rng.uniform(0.2, 0.8, (20, 30, 3)).astype(np.float32)
    pixels = rng.uniform(-10, 40, (20, 30, 2)).astype(np.float32)
    strange = rng.random(pixels.shape) < wild
    pixels[strange] = rng.choice(FLOATS, int(strange.sum()))
    values, inside = sample(image, pixels, how)  # type: ignore[arg-type]
    assert np.isfinite(values).all()
    assert not inside[~np.isfinite(pixels).all(-1)].any()
    # A cubic may overshoot by an eighth of what it is between.
    assert 0.2 - 0.2 <= values.min() <= values.max() <= 0.8 + 0.2
    warped, within = warp(image, pixels, how)  # type: ignore[arg-type]
    assert np.isfinite(warped).all()
    assert not within[~np.isfinite(pixels).all(-1)].any()


@CASES
@given(st.integers(0, 2**31), numbers(0, 0.5), powers(1, 4), st.booleans())
@example(937, 0.25, 10.0, False).via("a harmonic at the end of float32 changed by no number with the direction")
def test_gaussians_of_any_numbers_make_finite_pictures_and_gradients(
    seed: int, wild: float, focal_px: float, antialias: bool
) -> None:
    rng, count = np.random.default_rng(seed), 24

    def spoiled(values: np.ndarray) -> np.ndarray:
        strange = rng.random(values.shape) < wild
        spread = np.where(rng.random(values.shape) < 0.5, rng.choice(FLOATS, values.shape), values * 100)
        return np.where(strange, spread, values).astype(np.float32)

    room = Gaussians(
        spoiled(rng.normal([0, 0, 3], 1, (count, 3))),
        spoiled(rng.normal(size=(count, 4))),
        spoiled(rng.normal(-3, 2, (count, 3))),
        spoiled(rng.normal(0, 3, count)),
        spoiled(rng.normal(0, 0.5, (count, 4, 3))),
    )
    view = Camera("c", (48, 32), np.array([[focal_px, 0, 24], [0, focal_px, 16], [0, 0, 1.0]]), np.eye(4))
    rasteriser = Rasteriser(near_m=0.05, threads=1, antialias=antialias)
    shown = rasteriser.forward(room, view, (0.1, 0.2, 0.3))
    for name, value in vars(shown).items():
        assert value is None or np.isfinite(value).all(), name
    assert (shown.alpha >= 0).all()
    assert (shown.alpha <= 1).all()
    back = rasteriser.backward(*(rng.normal(size=(*view.hw, *c)).astype(np.float32) for c in ((3,), (), ())))
    for name, value in vars(back).items():
        assert value is None or np.isfinite(value).all(), name


@CASES
@given(st.integers(0, 2**31), powers(-3, 3))
def test_posed_gaussians_keep_their_size_whatever_the_bones_do(seed: int, reach: float) -> None:
    rng, count = np.random.default_rng(seed), 12
    transforms = np.tile(np.eye(4), (24, 1, 1))
    transforms[:, :3, :3] = rotations.exp(rng.normal(0, 2, (24, 3)))
    transforms[:, :3, 3] = reach * rng.normal(size=(24, 3))
    weights = rng.dirichlet(np.ones(4), count)
    posing = Posing(rng.integers(0, 24, (count, 4)), weights)
    quaternions = rng.normal(size=(count, 4)).astype(np.float32)
    means, turned, _ = posing.out(
        (reach * rng.normal(size=(count, 3))).astype(np.float32),
        quaternions,
        np.zeros((count, 1, 3), np.float32),
        transforms,
    )
    assert np.isfinite(means).all()
    assert is_rotation(posing.turn)
    np.testing.assert_allclose(
        np.linalg.norm(turned, axis=1), np.linalg.norm(quaternions, axis=1), rtol=1e-4, atol=1e-6
    )
