# SPDX-License-Identifier: Apache-2.0
"""Geometry against other people's: OpenCV, COLMAP and scipy."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from studiorecon.geometry import rotations
from studiorecon.geometry.triangulation import triangulate

from tests.made.cameras import LIMITS, ring, seen


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
