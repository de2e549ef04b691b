# SPDX-License-Identifier: Apache-2.0
"""Hard cases C01 to C10 of cameras and lenses; C04, C11 and C12 are in test_lifting.py."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.cameras.formats.raw import camera_from_world_of_pose, intrinsics_matrix, rigid_camera_from_world
from studiorecon.geometry.distortion import distort, undistort
from studiorecon.geometry.triangulation import triangulate
from studiorecon.scene.camera import Camera

from tests.foundations.camera_ring import LIMITS, look_at

CAMERA = look_at("c", np.array([4.0, 0.5, 1.5]), [0, 0, 1])
POINT = np.array([0.3, -0.2, 1.2])
ASIDE = np.array([0.3, 1.3, 1.2])


def test_a_rotation_written_with_three_digits_is_made_a_rotation_again():  # C01 naive: inverse by transposition 4.0 mm off
    rounded = np.round(CAMERA.camera_from_world[:3, :3], 3)
    pose, _ = rigid_camera_from_world(rounded, CAMERA.camera_from_world[:3, 3], "x")
    assert np.abs(pose[:3, :3].T @ pose[:3, :3] - np.eye(3)).max() < 1e-6
    camera = Camera("c", CAMERA.wh, CAMERA.intrinsics, pose)
    pixel, depth = camera.project(POINT)
    assert np.abs(camera.unproject(pixel, depth) - POINT).max() < 1e-9


def test_both_directions_of_a_pose_are_told_apart_by_name():  # C02 naive: 5.67 m off
    pose = camera_from_world_of_pose(CAMERA.world_from_camera, "x")
    assert np.abs(pose - CAMERA.camera_from_world).max() < 1e-12


def test_depth_is_z_and_not_range():  # C03 naive: 0.27 m off at 20 degrees off axis, 4 m away
    pixel, depth = CAMERA.project(ASIDE)
    assert np.linalg.norm(ASIDE - CAMERA.centre_m) > depth + 0.1
    assert np.abs(CAMERA.unproject(pixel, depth) - ASIDE).max() < 1e-9


def test_a_point_behind_the_camera_is_not_seen():  # C05 naive: pixel (540, 302), inside the picture
    camera = Camera("c", (1280, 704), CAMERA.intrinsics, np.eye(4))
    pixel, depth = camera.project(np.array([0.2, 0.1, -2.0]))
    assert np.isnan(pixel).all()
    assert depth < 0
    assert not triangulate(np.array([[[540.0, 302.0]], [[700.0, 300.0]]]), np.ones((2, 1)), [camera, camera], LIMITS).valid[0]


@pytest.mark.parametrize("scale", [0.5, 0.25, 2.0], ids=lambda s: f"C07-{s}")
def test_resizing_keeps_the_ray_of_every_pixel_centre(scale):  # C07 naive: cx · s with integer centres is 0.25 to 0.5 px off
    at_integers = intrinsics_matrix(1000, 1000, 639.5, 351.5, integer_centres=True)
    camera = Camera("c", (1280, 704), at_integers, np.eye(4)).resized((int(1280 * scale), int(704 * scale)))
    assert camera.principal_px[0] == pytest.approx(scale * 639.5 + (scale - 1) / 2 + 0.5)


def test_a_far_origin_costs_no_pixels():  # C08 naive, f32: 0.01 px at 1 km, 185 px at 10 000 km
    shift = np.array([1e6, -1e6, 0.0])
    far = look_at("c", CAMERA.centre_m + shift, np.array([0, 0, 1]) + shift)
    assert np.abs(far.project(POINT + shift)[0] - CAMERA.project(POINT)[0]).max() < 1e-3


# C09 naive: five fixed-point steps give 0.943, 0.712, 0.122; two hundred 1.0, a cycle, 16.4.
@pytest.mark.parametrize("radius", [1.0, 1.5, 3.0], ids=lambda r: f"C09-{r}")
def test_a_strong_pincushion_is_undone(radius):
    k = np.array([0.5, 0, 0, 0, 0])
    for direction in (np.array([1.0, 0.0]), np.array([0.6, -0.8])):
        distorted = distort(radius * direction, "opencv", k)
        back, valid = undistort(distorted, "opencv", k)
        assert valid
        assert np.abs(distort(back, "opencv", k) - distorted).max() < 1e-9
        assert np.linalg.norm(back) == pytest.approx(radius, abs=1e-9)


# C10 naive: 0.719 and 1.644, with residuals of -0.10 and -0.49; Newton gives -2.14.
@pytest.mark.parametrize("radius", [0.71, 0.8], ids=lambda r: f"C10-{r}")
def test_beyond_the_fold_there_is_no_answer(radius):
    back, valid = undistort(np.array([radius, 0.0]), "opencv", np.array([-0.3, 0, 0, 0, 0]))
    assert not valid
    assert np.isnan(back).all()
