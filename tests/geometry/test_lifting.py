# SPDX-License-Identifier: Apache-2.0
"""Rows C04, C11 and C12: depth that is none, depth of the wrong surface, and depth between two surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.geometry.lifting import SURFACE_TO_PELVIS_M, lift_joint, lift_pelvis, patch_depth
from studiorecon.scene.camera import Camera

from tests.made.cameras import look_at

WH = (320, 176)
CAMERA = look_at("c", np.array([4.0, 0.5, 1.5]), [0, 0, 1]).resized(WH)
EVERYWHERE = np.ones(WH[::-1], bool)


# C04 naive: 0 gives the camera's centre, NaN and inf NaN, -2 a point behind the camera.
@pytest.mark.parametrize("bad", [0.0, np.nan, np.inf, -2.0], ids=lambda v: f"C04-{v}")
def test_a_depth_that_is_none_lifts_to_nothing(bad: float) -> None:
    depth = np.full(WH[::-1], bad)
    depth[:, 200:] = 3.0
    pelvis, valid = lift_pelvis(depth, EVERYWHERE, np.array([[100.5, 88.5], [200.5, 88.5], [260.5, 88.5]]), CAMERA)
    assert valid.tolist() == [False, True, True]
    assert np.isnan(pelvis[0]).all()
    for point in pelvis[1:]:  # the patch at 200 is half unknown: only its measured half votes
        surface = point - SURFACE_TO_PELVIS_M * (point - CAMERA.centre_m) / np.linalg.norm(point - CAMERA.centre_m)
        assert CAMERA.project(surface)[1] == pytest.approx(3.0, abs=1e-9)
    assert np.isnan(lift_joint(np.array(bad), np.array([100.5, 88.5]), CAMERA, 0.13)).all()


def test_c04_the_mask_chooses_the_person_and_not_what_is_before_them() -> None:
    depth = np.full(WH[::-1], 5.0)
    depth[:, 150:170] = 2.0
    person = np.zeros(WH[::-1], bool)
    person[:, 165:200] = True
    person[:, 150:170] = False  # somebody else's arm
    read, valid = patch_depth(depth, np.stack([person, ~person]), np.array([[169.5, 80.5]] * 2), 9, 0.1)
    assert valid.all()
    assert read.tolist() == [5.0, 2.0]


@pytest.mark.parametrize(
    "pixel", [[np.nan, 3.0], [np.inf, 3.0], [1e30, 3.0], [-40.0, 3.0]], ids=lambda p: f"C04-pixel-{p[0]}"
)
def test_a_pixel_that_is_none_lifts_to_nothing(pixel: list[float]) -> None:
    point, valid = lift_pelvis(np.full(WH[::-1], 3.0), EVERYWHERE, np.array(pixel), CAMERA)
    assert not valid
    assert np.isnan(point).all()


def ellipse_depth(camera: Camera, centre: np.ndarray) -> np.ndarray:
    """z-depth (H, W) of an upright elliptic cylinder, 0.17 m wide (y) and 0.11 m deep (x): rays against the quadric."""
    origin, directions = camera.rays()
    shape = np.array([1 / 0.11, 1 / 0.17])
    o, d = (origin - centre)[:2] * shape, directions[..., :2] * shape
    a, b, c = (d**2).sum(-1), (d * o).sum(-1), (o**2).sum() - 1
    root = b**2 - a * c
    return np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, 0.0)


# C11 naive: the same pelvis lifted from two sides is 0.19-0.20 (90°), 0.22-0.25 (117°) and 0.22-0.34 m (180°) apart.
@pytest.mark.parametrize("degrees", [90, 117, 180], ids=lambda d: f"C11-{d}deg")
@pytest.mark.parametrize("turned", [0, 30, 45, 80])
def test_two_cameras_lift_the_same_pelvis(degrees: int, turned: int) -> None:
    centre, lifted, skin = np.array([0.0, 0.0, 1.0]), [], []
    for side in (0, degrees):
        a = np.radians(turned + side)
        camera = look_at("c", np.array([4 * np.cos(a), 4 * np.sin(a), 1.3]), centre).resized(WH)
        depth = ellipse_depth(camera, centre)
        pixel = camera.project(centre)[0]
        lifted.append(lift_pelvis(depth, depth > 0, pixel, camera)[0])
        skin.append(lift_pelvis(depth, depth > 0, pixel, camera, surface_to_joint_m=0.0)[0])
    assert np.linalg.norm(skin[0] - skin[1]) > 0.15
    assert np.linalg.norm(lifted[0] - lifted[1]) < 0.1


def test_c11_one_and_many_agree_and_the_shift_follows_the_ray() -> None:
    rng = np.random.default_rng(0)
    depth = rng.uniform(2, 5, WH[::-1])
    pixels = rng.uniform(20, 150, (30, 2))
    many, valid = lift_pelvis(depth, EVERYWHERE, pixels, CAMERA)
    skin, _ = lift_pelvis(depth, EVERYWHERE, pixels, CAMERA, surface_to_joint_m=0.0)
    assert valid.all()
    assert np.linalg.norm(many - skin, axis=-1) == pytest.approx(np.full(30, 0.13), abs=1e-12)
    assert np.abs(CAMERA.project(many)[0] - pixels).max() < 1e-9
    for i in range(3):
        assert np.array_equal(lift_pelvis(depth, EVERYWHERE, pixels[i], CAMERA)[0], many[i])


def test_c12_a_patch_across_two_surfaces_takes_one_of_them() -> None:
    # Naive: the mean of the two middle values of an even count, 4 m.
    depth = np.full((21, 21), 6.0)
    depth[:, :10] = 2.0
    mask = np.zeros((21, 21), bool)
    mask[10, 8:12] = True
    assert patch_depth(depth, mask, np.array([[10.5, 10.5]]), 9, 0.1)[0][0] == 2.0
