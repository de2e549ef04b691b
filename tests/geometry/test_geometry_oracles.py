# SPDX-License-Identifier: Apache-2.0
"""Geometry against other people's: OpenCV, COLMAP, kornia, scipy, and mpmath in fifty digits."""

from __future__ import annotations

import cv2
import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp
from studiorecon.geometry import rotations
from studiorecon.geometry.distortion import distort, undistort
from studiorecon.geometry.triangulation import triangulate

from tests.made.cameras import LIMITS, ring, seen

OPENCV = np.array([-0.3, 0.1, 1e-3, -2e-3, 0.01])


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


def test_dlt_is_opencvs_and_kornias() -> None:
    torch, kornia = pytest.importorskip("torch"), pytest.importorskip("kornia")
    cameras, points = ring()[:2], cloud(100, 3)
    pixels = seen(cameras, points)
    ours = triangulate(pixels, np.ones((2, 100)), cameras, LIMITS, solver="dlt").points_m
    matrices = [c.intrinsics @ c.camera_from_world[:3] for c in cameras]
    homogeneous = cv2.triangulatePoints(*matrices, pixels[0].T.copy(), pixels[1].T.copy())
    np.testing.assert_allclose(ours, (homogeneous[:3] / homogeneous[3]).T, atol=1e-9)
    theirs = kornia.geometry.triangulate_points(
        *(torch.from_numpy(np.stack([m])) for m in matrices), *(torch.from_numpy(p[None]) for p in pixels)
    )
    np.testing.assert_allclose(ours, theirs[0].numpy(), atol=1e-9)


def test_undistortion_is_opencvs_where_opencv_converges() -> None:
    distorted = distort(np.random.default_rng(4).uniform(-0.3, 0.3, (100, 2)), "opencv", OPENCV)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-14)
    theirs = cv2.undistortPoints(distorted[:, None], np.eye(3), OPENCV, criteria=criteria).reshape(-1, 2)
    ours, valid = undistort(distorted, "opencv", OPENCV)
    assert valid.all()
    np.testing.assert_allclose(ours, theirs, atol=1e-9)


@pytest.mark.parametrize("lens", ["radial", "tangential", "rational", "fisheye"])
def test_undistortion_inverts_in_fifty_digits(lens: str) -> None:
    """The distorted point is made in 50 digits, so that the answer is known to more than a double holds."""
    coefficients = {
        "radial": [-0.3, 0.1, 0, 0, 0.01],
        "tangential": OPENCV.tolist(),
        "rational": [0.4, 0.02, 1e-3, 0, 0.01, 0.7, 0.05, 0.002],
        "fisheye": [-0.03, 0.01, -0.004, 0.001],
    }[lens]
    model = "fisheye" if lens == "fisheye" else "opencv"
    truth = np.random.default_rng(5).uniform(-0.6, 0.6, (20, 2))
    with mpmath.workdps(50):
        distorted = np.array([[float(v) for v in exactly(point, coefficients, model)] for point in truth])
    np.testing.assert_allclose(distort(truth, model, np.array(coefficients)), distorted, atol=1e-15)
    back, valid = undistort(distorted, model, np.array(coefficients))
    assert valid.all()
    np.testing.assert_allclose(back, truth, atol=1e-11)


def exactly(point: np.ndarray, coefficients: list[float], model: str) -> tuple[mpmath.mpf, mpmath.mpf]:
    x, y = mpmath.mpf(float(point[0])), mpmath.mpf(float(point[1]))
    k = [mpmath.mpf(c) for c in coefficients] + [mpmath.mpf(0)] * 8
    s = x * x + y * y
    if model == "fisheye":
        radius = mpmath.sqrt(s)
        angle = mpmath.atan(radius)
        scale = angle * (1 + k[0] * angle**2 + k[1] * angle**4 + k[2] * angle**6 + k[3] * angle**8) / radius
        return x * scale, y * scale
    gain = (1 + k[0] * s + k[1] * s**2 + k[4] * s**3) / (1 + k[5] * s + k[6] * s**2 + k[7] * s**3)
    return x * gain + 2 * k[2] * x * y + k[3] * (s + 2 * x * x), y * gain + k[2] * (s + 2 * y * y) + 2 * k[3] * x * y


def test_slerp_is_scipys() -> None:
    pair = Rotation.random(2, random_state=3)
    shares = np.linspace(0, 1, 33)
    theirs = Slerp([0, 1], pair)(shares).as_matrix()
    np.testing.assert_allclose(rotations.slerp(*pair.as_matrix(), shares), theirs, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 1e-3, 1.0, 3.0, np.pi - 1e-3, np.pi - 1e-6])
def test_exp_and_log_in_fifty_digits(angle: float) -> None:
    axis_angle = angle * np.array([0.36, -0.48, 0.8])
    with mpmath.workdps(50):
        x, y, z = (mpmath.mpf(float(v)) for v in axis_angle)
        cross = mpmath.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        theta = mpmath.sqrt(x * x + y * y + z * z)
        first = mpmath.sin(theta) / theta if theta else mpmath.mpf(1)
        second = (1 - mpmath.cos(theta)) / theta**2 if theta else mpmath.mpf(1) / 2
        exact = np.array((mpmath.eye(3) + first * cross + second * cross * cross).tolist(), dtype=np.float64)
    np.testing.assert_allclose(rotations.exp(axis_angle), exact, atol=4e-16)
    np.testing.assert_allclose(rotations.log(exact), axis_angle, atol=2e-8 if angle > 3.1 else 1e-14)
