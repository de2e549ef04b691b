# SPDX-License-Identifier: Apache-2.0
"""Hard cases C01 to C10 of cameras and lenses; C04, C11 and C12 are in test_lifting.py."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from studiorecon.camera_files.raw_camera import camera_from_world_of_pose, raw_camera, rigid_camera_from_world
from studiorecon.estimate.factors.keypoints import keypoint_factor
from studiorecon.estimate.unknowns import Unknowns
from studiorecon.geometry import rotations
from studiorecon.geometry.crop_hypotheses import for_square_pixels
from studiorecon.geometry.distortion import distort, undistort
from studiorecon.geometry.triangulation import triangulate
from studiorecon.scene.camera import Camera, Lens

from tests.made.cameras import LIMITS, look_at, ring, seen

CAMERA = look_at("c", np.array([4.0, 0.5, 1.5]), [0, 0, 1])
POINT = np.array([0.3, -0.2, 1.2])


# C01 naive: inverse by transposition 4.0 mm off
def test_c01_a_rotation_written_with_three_digits_is_made_a_rotation_again():
    rounded = np.round(CAMERA.camera_from_world[:3, :3], 3)
    pose, _ = rigid_camera_from_world(rounded, CAMERA.camera_from_world[:3, 3], "x")
    assert np.abs(pose[:3, :3].T @ pose[:3, :3] - np.eye(3)).max() < 1e-6
    camera = Camera("c", CAMERA.wh, CAMERA.intrinsics, pose)
    pixel, depth = camera.project(POINT)
    assert np.abs(camera.unproject(pixel, depth) - POINT).max() < 1e-9


def test_c02_both_directions_of_a_pose_are_distinguished_by_name():  # C02 naive: 5.67 m off
    pose, _ = camera_from_world_of_pose(CAMERA.world_from_camera, "x")
    assert np.abs(pose - CAMERA.camera_from_world).max() < 1e-12
    loaded, naive = (Camera("c", CAMERA.wh, CAMERA.intrinsics, m) for m in (pose, CAMERA.world_from_camera))
    pixel, depth = CAMERA.project(POINT)
    assert np.abs(loaded.unproject(pixel, depth) - POINT).max() < 1e-9
    assert np.linalg.norm(naive.unproject(pixel, depth) - POINT) > 1.0
    assert np.abs(CAMERA.world_from_camera @ CAMERA.camera_from_world - np.eye(4)).max() < 1e-14


# C03 naive: the ray's length taken for z is 0.27, 0.71 and 1.59 m off at 20, 30 and 40 degrees off axis, 4 m away.
@pytest.mark.parametrize(("degrees", "naive_m"), [(20, 0.27), (30, 0.71), (40, 1.59)], ids=lambda v: f"C03-{v}")
def test_depth_is_z_and_not_range(degrees, naive_m):
    camera = Camera("c", (1280, 704), CAMERA.intrinsics, np.eye(4))
    point = np.array([4 * np.tan(np.radians(degrees)), 0.0, 4.0])
    pixel, depth = camera.project(point)
    assert depth == 4.0
    assert np.abs(camera.unproject(pixel, depth) - point).max() < 1e-9
    length = np.linalg.norm(point)
    assert np.linalg.norm(camera.unproject(pixel, length) - point) == pytest.approx((length - 4) * length / 4, rel=1e-9)
    assert (length - 4) * length / 4 == pytest.approx(naive_m, abs=0.01)


def rays(count: int, rng: np.random.Generator) -> tuple[list[Camera], np.ndarray, np.ndarray]:
    cameras, points = ring(), rng.uniform(-0.5, 0.5, (count, 3)) + np.array([0, 0, 1])
    return cameras, points, seen(cameras, points, 1.0, rng)


# C06 naive: gradient NaN, because the mask comes after the division. Here derivatives are the estimate's.
@pytest.mark.parametrize("z", [0.0, 1e-30, -2.0], ids=lambda z: f"C06-z={z:g}")
def test_points_on_the_camera_plane_have_finite_derivatives(z):
    cameras, points, _ = rays(40, np.random.default_rng(0))
    on_plane = cameras[0].world_from_camera @ np.array([0.0, 0, z, 1])
    unknowns = Unknowns.of(cameras, np.zeros(4), np.concatenate([points, on_plane[None, :3]]))
    one = np.zeros(1, int)
    factor = keypoint_factor(unknowns, one, one + 40, np.full((1, 2), 3.0), np.ones(1), np.ones(4))
    assert np.isfinite(factor.evaluate(unknowns)).all()
    assert np.isfinite(factor.derivatives(unknowns, np.arange(factor.columns.shape[1]))).all()


def test_a_view_without_a_weight_leaves_no_trace_in_triangulation() -> None:
    cameras, _, pixels = rays(40, np.random.default_rng(0))
    weights = np.ones((4, 40))
    weights[0] = 0
    pixels[0] = 1e30
    with_it = triangulate(pixels, weights, cameras, LIMITS)
    without = triangulate(pixels[1:], weights[1:], cameras[1:], LIMITS)
    assert with_it.valid.all()
    assert np.array_equal(with_it.points_m, without.points_m)


def test_c05_a_point_behind_the_camera_is_not_seen():  # C05 naive: pixel (540, 302), inside the picture
    camera = Camera("c", (1280, 704), CAMERA.intrinsics, np.eye(4))
    pixel, depth = camera.project(np.array([0.2, 0.1, -2.0]))
    assert np.isnan(pixel).all()
    assert depth < 0
    assert not triangulate(
        np.array([[[540.0, 302.0]], [[700.0, 300.0]]]), np.ones((2, 1)), [camera, camera], LIMITS
    ).valid[0]


@pytest.mark.parametrize("scale", [0.5, 0.25, 2.0], ids=lambda s: f"C07-{s}")
def test_resizing_keeps_the_ray_of_every_pixel_centre(
    scale,
):  # C07 naive: cx · s with integer centres is 0.25 to 0.5 px off
    at_integers = raw_camera("c", "x", (1280, 704), (1000, 1000, 639.5, 351.5), (np.eye(4), 1.0)).intrinsics
    camera = Camera("c", (1280, 704), at_integers, np.eye(4)).resized((int(1280 * scale), int(704 * scale)))
    assert camera.principal_px[0] == pytest.approx(scale * 639.5 + (scale - 1) / 2 + 0.5)


def test_c08_a_far_origin_costs_no_pixels():  # C08 naive, f32: 0.01 px at 1 km, 185 px at 10 000 km
    shift = np.array([1e6, -1e6, 0.0])
    far = look_at("c", CAMERA.centre_m + shift, np.array([0, 0, 1]) + shift)
    assert np.abs(far.project(POINT + shift)[0] - CAMERA.project(POINT)[0]).max() < 1e-3
    pixel, depth = far.project(POINT + shift)
    assert np.abs(far.unproject(pixel, depth) - POINT - shift).max() < 1e-8


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


# ---- Geometry against other people's: OpenCV, COLMAP and scipy ----


def cloud(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (count, 3)) + np.array([0, 0, 1])


def test_projection_is_opencvs() -> None:
    camera, points = ring()[1], cloud(200)
    turn = cv2.Rodrigues(camera.rotation_camera_from_world.copy())[0]
    np.testing.assert_allclose(rotations.log(camera.rotation_camera_from_world), turn.ravel(), atol=1e-12)
    theirs = cv2.projectPoints(points, turn, camera.camera_from_world[:3, 3], camera.intrinsics, np.zeros(5))[
        0
    ].reshape(-1, 2)
    pixels, depth = camera.project(points)
    np.testing.assert_allclose(pixels, theirs, atol=1e-9)
    np.testing.assert_allclose(camera.unproject(pixels, depth), points, atol=1e-12)


def test_projection_and_triangulation_are_colmaps() -> None:
    pycolmap = pytest.importorskip("pycolmap")
    cameras, points = ring(), cloud(60, 1)
    lens = pycolmap.Camera(model="PINHOLE", width=1280, height=704, params=[1000, 1000, 640, 352])
    pixels = seen(cameras, points)
    exact = np.stack(
        [lens.img_from_cam(points @ c.camera_from_world[:3, :3].T + c.camera_from_world[:3, 3]) for c in cameras]
    )
    np.testing.assert_allclose(pixels, exact, atol=1e-9)
    found = triangulate(pixels[:2], np.ones((2, 60)), cameras[:2], LIMITS, solver="dlt")
    rays = [lens.cam_from_img(pixels[v]) for v in range(2)]
    for n in range(60):
        theirs = pycolmap.triangulate_point(
            cameras[0].camera_from_world[:3],
            cameras[1].camera_from_world[:3],
            *(np.append(r[n], 1.0) / np.hypot(1, np.linalg.norm(r[n])) for r in rays),
        )
        assert np.linalg.norm(found.points_m[n] - theirs) < 1e-9


# ---- A calibration of a film whose pixels are not square may be for the picture as stored, or as shown ----

STORED, SHOWN = (240, 180), (320, 180)
FOR_SHOWN = Lens(
    "a",
    SHOWN,
    np.array([[228.0, 0, 160.0], [0, 228.0, 90.0], [0, 0, 1]]),
    "opencv",
    np.array([-0.1, 0.02, 0, 0, 0]),
    np.eye(4),
    np.eye(2, 3),
)


def for_stored(scale: float = 1.0, sized: bool = True) -> Lens:
    wh = tuple(round(side * scale) for side in STORED) if sized else (0, 0)
    return replace(FOR_SHOWN, wh=wh, intrinsics=np.diag([0.75 * scale, scale, 1.0]) @ FOR_SHOWN.intrinsics)


@pytest.mark.parametrize("lens", [FOR_SHOWN, for_stored(), replace(FOR_SHOWN, wh=(0, 0)), for_stored(sized=False)])
def test_both_are_the_same_camera(lens: Lens) -> None:
    square, note = for_square_pixels(lens, STORED, SHOWN)
    np.testing.assert_allclose(square.intrinsics, FOR_SHOWN.intrinsics)
    assert square.wh in (SHOWN, (0, 0))
    assert "240×180" in note
    assert "320×180" in note


def test_a_calibration_of_another_scale_is_known_by_its_shape() -> None:
    square, _ = for_square_pixels(for_stored(2.0), STORED, SHOWN)
    assert square.wh == (640, 360)
    np.testing.assert_allclose(square.intrinsics, np.diag([2.0, 2.0, 1.0]) @ FOR_SHOWN.intrinsics)


def test_square_pixels_and_the_user_s_own_maps_stay() -> None:
    mapped = replace(for_stored(), calibration_from_video=np.array([[2.0, 0, 0], [0, 2.0, 0]]))
    assert for_square_pixels(FOR_SHOWN, SHOWN, SHOWN) == (FOR_SHOWN, "")
    assert for_square_pixels(mapped, STORED, SHOWN) == (mapped, "")
