# SPDX-License-Identifier: Apache-2.0
"""Arguments of geometry and of pictures that cannot be meant, and entries that are no numbers beside others."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from studiorecon.body import skinning
from studiorecon.geometry import camera_path, lifting, rotations, smoothing
from studiorecon.geometry.distortion import fold_radius, undistort
from studiorecon.geometry.triangulation import triangulate
from studiorecon.images.exposure import Overlap, solve_gains
from studiorecon.images.plate import temporal_modes
from studiorecon.images.silhouette import mesh_depth
from studiorecon.scene.camera import Camera

from tests.made.cameras import LIMITS, ring

CAMERAS = ring(2)
MIDDLE = np.array([0.0, 0.0, 1.0])
FPS = smoothing.Smoothing(0.05, 0.03, "rotations")


def zeros(*shape: int) -> np.ndarray:
    return np.zeros(shape, np.float32)


# Of shapes and numbers that are none, tests/package/test_arrays and tests/layout/test_borders.
REFUSED: dict[str, tuple[Callable[[], object], str]] = {
    "between-count": (
        lambda: camera_path.interpolate_cameras(*CAMERAS, 0, MIDDLE, rotations="slerp", clearance=0.0),
        "count must be at least 1, not 0",
    ),
    "scene_centre": (lambda: camera_path.scene_centre([]), "cameras is empty"),
    "kernel": (lambda: smoothing.smoothing_kernel(0.0, 1.0), "alpha must be in"),
    "frame_rate": (lambda: smoothing.at_frame_rate(FPS, 0), "fps must be positive"),
    "fold_radius": (lambda: fold_radius("opencv", np.array([np.nan])), "at most 8 finite numbers"),
    "mesh-faces": (lambda: mesh_depth(zeros(5, 3), np.full((1, 3), 5), CAMERAS[0]), "faces name vertices 5 to 5"),
    "plate-kind": (lambda: temporal_modes(zeros(3, 4, 5, 3), np.ones((3, 4, 5), bool), 8.0), "frames are float32"),
    "gains": (lambda: solve_gains(2, [Overlap(0, 1, np.array([0, np.nan, 0]), 9)]), "log_ratio of cameras 0 and 1"),
}


@pytest.mark.parametrize(("call", "message"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_meant_is_named(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


def alone(result: object) -> tuple[np.ndarray, ...]:
    return tuple(np.asarray(r) for r in (result if isinstance(result, tuple) else (result,)))


def triangulated(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found = triangulate(np.stack([c.project(points)[0] for c in ring(4)]), np.ones((4, 5)), ring(4), LIMITS)
    return found.points_m, found.valid


TURNED = rotations.exp(np.random.default_rng(0).normal(size=(5, 3)))
PLACES = np.random.default_rng(1).uniform(-0.5, 0.5, (5, 3)) + MIDDLE
ELEMENTWISE: dict[str, tuple[Callable[[np.ndarray], object], np.ndarray]] = {
    "exp": (rotations.exp, PLACES),
    "log": (rotations.log, TURNED),
    "angle": (lambda r: rotations.angle(r, TURNED[0]), TURNED),
    "to_quaternion": (rotations.to_quaternion, TURNED),
    "from_quaternion": (rotations.from_quaternion, rotations.to_quaternion(TURNED)),
    "slerp": (lambda r: rotations.slerp(r, TURNED[0], np.full(5, 0.3)), TURNED),
    "project": (CAMERAS[0].project, PLACES),
    "unproject": (lambda p: CAMERAS[0].unproject(p, np.ones(5)), 100 * PLACES[:, :2]),
    "undistort": (lambda p: undistort(p, "opencv", np.array([-0.3, 0.1, 1e-3, 0, 0])), PLACES[:, :2] - MIDDLE[:2]),
    "triangulate": (triangulated, PLACES),
    "lift_joint": (lambda d: lifting.lift_joint(d, 100 * PLACES[:, :2], CAMERAS[0], 0.1), PLACES[:, 0] + 2),
    "skin": (
        lambda t: skinning.skin(PLACES, np.ones((5, 1)), t[:, None]),
        np.stack([Camera.world_from_camera.fget(c) for c in ring(5)]),
    ),
    "kinematics": (lambda r: skinning.forward_kinematics(r[:, None], np.ones((1, 3)), np.array([-1])), TURNED),
}


@pytest.mark.parametrize(("function", "values"), ELEMENTWISE.values(), ids=ELEMENTWISE)
def test_one_entry_that_is_not_a_number_changes_no_other(
    function: Callable[[np.ndarray], object], values: np.ndarray
) -> None:
    """Where entries do not depend on one another nothing is refused: a bad one stays bad, or is said to be, and is
    alone."""
    broken = values.copy()
    broken[2] = np.nan
    clean, found = alone(function(values)), alone(function(broken))
    others = np.arange(5) != 2
    for one, other in zip(clean, found):
        np.testing.assert_array_equal(one[others], other[others])
    assert any(not np.isfinite(f[2]).all() if f.dtype != bool else not f[2] for f in found)
