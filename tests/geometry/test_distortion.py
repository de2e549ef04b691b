# SPDX-License-Identifier: Apache-2.0
"""Lens distortion both ways, and the undistorted working picture."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.geometry.distortion import distort, fold_radius, undistort
from studiorecon.geometry.lens import video_from_working, working_from_video, working_view, working_wh
from studiorecon.scene.camera import Lens

PINHOLE = Lens(
    "cam",
    (640, 480),
    np.array([[500.0, 0, 300], [0, 510, 250], [0, 0, 1]]),
    "opencv",
    np.zeros(5),
    np.eye(4),
    np.eye(2, 3),
)
BARREL = replace(PINHOLE, distortion=np.array([-0.33, 0.05, -0.004, 0.004, 0.07]))


def test_distortion_agrees_with_opencv():
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.5, 0.5, (50, 2))
    rays = np.concatenate([points, np.ones((50, 1))], axis=1)
    for model, coefficients in (
        ("opencv", np.array([-0.2, 0.1, 1e-3, -2e-3, 0.02, 0.01, 0.02, 0.003])),
        ("fisheye", np.array([-0.03, 0.01, -0.004, 0.001])),
    ):
        project = (
            cv2.projectPoints if model == "opencv" else lambda r, rv, t, k, d: cv2.fisheye.projectPoints(r, rv, t, k, d)
        )
        theirs = project(rays.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), np.eye(3), coefficients)[0].reshape(-1, 2)
        assert np.abs(distort(points, model, coefficients) - theirs).max() < 1e-12
        back, valid = undistort(theirs, model, coefficients)
        assert valid.all()
        assert np.abs(back - points).max() < 1e-8


@pytest.mark.parametrize("k1", [0.0, 1e-300])
def test_without_distortion_every_finite_point_is_its_own(k1: float) -> None:
    """With and without the solver, which a lens of all zeros does not need."""
    points = np.array([[[0.3, -0.2], [0.0, 0.0]], [[40.0, 1e3], [np.nan, 0.1]]])
    back, valid = undistort(points, "opencv", np.array([k1, 0, 0, 0, 0]))
    assert valid.tolist() == [[True, True], [True, False]]
    np.testing.assert_allclose(back[valid], points[valid], rtol=1e-12)
    assert np.isnan(back[1, 1]).all()
    assert undistort(np.array([np.inf, 0.0]), "opencv", np.array([k1]))[1].tolist() is False


def test_fisheye_knows_that_a_right_angle_has_no_pinhole_ray():
    assert fold_radius("fisheye", np.zeros(4)) == pytest.approx(np.pi / 2, abs=1e-5)
    _, valid = undistort(np.array([[1.2, 0.0], [1.6, 0.0]]), "fisheye", np.zeros(4))
    assert valid.tolist() == [True, False]


def test_a_smaller_working_picture_is_a_pure_scaling_and_does_not_alias():
    view = working_view(PINHOLE, (1280, 960), (320, 240))
    assert np.allclose(view.intrinsics, np.diag([0.5, 0.5, 1.0]) @ PINHOLE.intrinsics)
    stripes = np.tile(np.array([0, 255], dtype=np.uint8), (960, 640))
    assert np.ptp(view.picture(stripes).astype(int)) <= 2


def test_the_working_picture_has_no_black_border_and_projects_where_the_lens_did():
    for lens in (BARREL, replace(BARREL, distortion=np.array([0.18, -0.25, 0.003, 0.002, 0.12]))):
        view = working_view(lens, (640, 480), working_wh((640, 480), 0))
        assert view.picture(np.full((480, 640), 200, np.uint8)).min() == 200
        assert view.map_x.min() > -0.51
        assert view.map_x.max() < 639.51
        point = np.array([0.21, -0.13, 1.0])
        working = point[:2] * np.diag(view.intrinsics)[:2] + view.intrinsics[:2, 2]
        video = distort(point[:2], "opencv", lens.distortion) * np.diag(lens.intrinsics)[:2] + lens.intrinsics[:2, 2]
        assert np.abs(video_from_working(working, lens, (640, 480), view.intrinsics) - video).max() < 1e-9
        back, valid = working_from_video(video, lens, (640, 480), view.intrinsics)
        assert valid
        assert np.abs(back - working).max() < 1e-6


def test_a_letterboxed_video_shows_no_bars():
    boxed = replace(
        PINHOLE, calibration_from_video=np.array([[1.25, 0, 0], [0, 1.25, -60.0]])
    )  # 512 × 480 with bars of 48 rows
    video = np.zeros((480, 512), np.uint8)
    video[48:432] = 180
    view = working_view(boxed, (512, 480), working_wh((512, 480), 0))
    assert view.picture(video)[2:-2, 2:-2].min() >= 170


def test_another_shape_than_calibrated_is_refused_by_name():
    with pytest.raises(UserError, match=r"cam: .*640×480.*500×500.*pixel_maps"):
        working_view(PINHOLE, (500, 500), (500, 500))


def test_coefficients_of_another_lens_are_refused():
    with pytest.raises(UserError, match="distortion"):
        working_view(replace(PINHOLE, distortion=np.array([-0.9, 0.0, 0, 0, 0])), (640, 480), (640, 480))


@pytest.mark.parametrize("wild", [np.nan, np.inf, -np.inf, 1e300])
def test_a_point_s_answer_does_not_depend_on_its_neighbours(wild):
    """Tangential lenses settle points in blocks: bad ones, more than a block of them and a remainder change nothing for
    the others."""
    coefficients = np.array([-0.3, 0.1, 5e-3, -4e-3, 0.01])
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (1300, 2))
    distorted = distort(points, "opencv", coefficients)
    distorted[::7, 0] = wild
    back, valid = undistort(distorted, "opencv", coefficients)
    assert not valid[::7].any()
    assert np.isnan(back[::7]).all()
    good = np.arange(1300) % 7 > 0
    assert valid[good].all()
    assert np.abs(back - points)[good].max() < 1e-9
    for n in (1, 600, 1299):
        np.testing.assert_array_equal(undistort(distorted[n], "opencv", coefficients)[0], back[n])
