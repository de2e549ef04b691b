# SPDX-License-Identifier: Apache-2.0
"""What geometry and skinning say about arguments that do not fit or are not numbers: the argument's name and its
shape."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from studiorecon.body import skinning
from studiorecon.body.avatar import weight_grid
from studiorecon.geometry import (
    bundle,
    camera_path,
    depth_surface,
    groups,
    lens,
    lifting,
    relative_pose,
    rotations,
    scale,
    smoothing,
)
from studiorecon.geometry.depth_alignment import align_depth
from studiorecon.geometry.distortion import distort, fold_radius, undistort
from studiorecon.geometry.triangulation import triangulate
from studiorecon.keypoints import correspondence
from studiorecon.scene.camera import Camera, Lens

from tests.made.cameras import LIMITS, ring

CAMERAS = ring(2)
MIDDLE = np.array([0.0, 0.0, 1.0])
PINHOLE = Lens(
    "cam",
    (640, 480),
    np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]),
    "opencv",
    np.zeros(5),
    np.eye(4),
    np.eye(2, 3),
)
SETTINGS = bundle.BundleSettings(iterations=1, prior_deg=1.0, prior_m=0.1)
EYES = np.tile(np.eye(3), (4, 24, 1, 1))
FPS = smoothing.Smoothing(0.05, 0.03, True, "rotations")
Case = tuple[Callable[[], object], str]


def zeros(*shape: int) -> np.ndarray:
    return np.zeros(shape)


def bad(*shape: int) -> np.ndarray:
    """Ones with one number that is none."""
    values = np.ones(shape)
    values.flat[-1] = np.nan
    return values


def adjusted(pixels: np.ndarray, weights: np.ndarray, points: np.ndarray, huber: np.ndarray) -> object:
    return bundle.adjust_with_lenses(CAMERAS, pixels, weights, points, huber, SETTINGS, bundle.LensPrior(0.0, 0.0))


SHAPES: dict[str, Case] = {
    "cross_matrix": (lambda: rotations.cross_matrix(zeros(4)), r"vectors has shape \(4,\), expected \(\.\.\., 3\)"),
    "exp": (lambda: rotations.exp(zeros(3, 2)), r"axis_angle_rad has shape \(3, 2\)"),
    "log": (lambda: rotations.log(zeros(3)), r"rotations has shape \(3,\), expected \(\.\.\., 3, 3\)"),
    "angle": (lambda: rotations.angle(np.eye(3), np.eye(4)), r"b has shape \(4, 4\)"),
    "to_quaternion": (lambda: rotations.to_quaternion(zeros(9)), r"rotations has shape \(9,\)"),
    "from_quaternion": (lambda: rotations.from_quaternion(zeros(3)), r"quaternions has shape \(3,\)"),
    "project_to_so3": (lambda: rotations.project_to_so3(zeros(4, 3)), r"matrices has shape \(4, 3\)"),
    "slerp": (lambda: rotations.slerp(np.eye(3), zeros(4), 0.5), r"b has shape \(4,\)"),
    "half_turn": (lambda: rotations.half_turn(zeros(4), np.eye(3)), r"a has shape \(4,\)"),
    "mean": (lambda: rotations.mean(np.eye(3)), r"rotations has shape \(3, 3\), expected \(\.\.\., N, 3, 3\)"),
    "kabsch": (lambda: rotations.kabsch(zeros(4, 3), zeros(4, 2), zeros(4)), r"target_m has shape \(4, 2\)"),
    "kabsch-weights": (
        lambda: rotations.kabsch(zeros(4, 3), zeros(4, 3), zeros(5)),
        r"weights has shape \(5,\), expected \(\.\.\., 4\)",
    ),
    "azimuths": (lambda: camera_path.azimuths_rad(CAMERAS, zeros(2)), r"centre_m has shape \(2,\)"),
    "order_around": (lambda: camera_path.order_around(CAMERAS, zeros(2), True), r"centre_m has shape \(2,\)"),
    "look_at": (lambda: camera_path.look_at(zeros(3), zeros(4)), r"target_m has shape \(4,\)"),
    "with_pose": (lambda: camera_path.with_pose(CAMERAS[0], zeros(3), MIDDLE), r"world_from_camera has shape \(3,\)"),
    "straight": (lambda: camera_path.straight_path(zeros(3), zeros(3), zeros(2, 2)), r"shares has shape \(2, 2\)"),
    "arc": (lambda: camera_path.arc_path(zeros(3), zeros(3), zeros(2), zeros(2)), r"centre_m has shape \(2,\)"),
    "clearance_share": (lambda: camera_path.clearance_share(zeros(3), MIDDLE), r"points_m has shape \(3,\)"),
    "axis_miss": (lambda: camera_path.axis_miss_rad(CAMERAS[0], zeros(2)), r"target_m has shape \(2,\)"),
    "between": (
        lambda: camera_path.interpolate_cameras(*CAMERAS, 3, zeros(4), rotations="slerp", clearance=0.0),
        r"centre_m has shape \(4,\)",
    ),
    "between-count": (
        lambda: camera_path.interpolate_cameras(*CAMERAS, 0, MIDDLE, rotations="slerp", clearance=0.0),
        "count must be at least 1, not 0",
    ),
    "scene_centre": (lambda: camera_path.scene_centre([]), "cameras is empty"),
    "depth_breaks": (lambda: depth_surface.depth_breaks(zeros(5), 0.1), r"depth_m has shape \(5,\), expected \(H, W\)"),
    "points_and_normals": (
        lambda: depth_surface.points_and_normals(zeros(5, 5), CAMERAS[0]),
        r"depth_m has shape .* expected \(704, 1280\)",
    ),
    "fill_vectors": (
        lambda: smoothing.fill_vectors(zeros(5, 3), np.ones(4, bool)),
        r"valid has shape \(4,\), expected \(5,\)",
    ),
    "fill_rotations": (lambda: smoothing.fill_rotations(zeros(5, 3), np.ones(5, bool)), r"values has shape \(5, 3\)"),
    "smooth_vectors": (lambda: smoothing.smooth_vectors(np.float64(3), 0.5, 1.0), r"values has shape \(\)"),
    "smooth_rotations": (lambda: smoothing.smooth_rotations(zeros(5, 4), 0.5, 1.0), r"values has shape \(5, 4\)"),
    "kernel": (lambda: smoothing.kernel(0.0, 1.0), "alpha must be in"),
    "frame_rate": (lambda: smoothing.at_frame_rate(FPS, 0), "fps must be positive"),
    "fit_scale": (
        lambda: scale.fit_scale(np.ones(3), np.ones(4), zeros(3)),
        r"template_m has shape \(4,\), expected \(N,\) with N = 3",
    ),
    "scene_scale": (
        lambda: scale.scene_scale(zeros(1, 2, 24, 2), zeros(1, 24, 3), zeros(1, 2), np.ones((1, 2, 24))),
        r"joints has shape \(1, 2, 24, 2\)",
    ),
    "adjust": (
        lambda: adjusted(zeros(3, 5, 2), zeros(2, 5), zeros(5, 3), np.ones(2)),
        r"pixels has shape .* expected \(2, N, 2\)",
    ),
    "adjust-weights": (
        lambda: adjusted(zeros(2, 5, 2), zeros(2, 4), zeros(5, 3), np.ones(2)),
        r"weights has shape \(2, 4\)",
    ),
    "adjust-points": (
        lambda: adjusted(zeros(2, 5, 2), zeros(2, 5), zeros(4, 3), np.ones(2)),
        r"points_m has shape \(4, 3\)",
    ),
    "adjust-huber": (
        lambda: adjusted(zeros(2, 5, 2), zeros(2, 5), zeros(5, 3), np.ones(3)),
        r"huber_px has shape \(3,\)",
    ),
    "ray_distances": (
        lambda: correspondence.ray_distances(zeros(3), zeros(4, 3), zeros(3), zeros(4)),
        r"second has shape \(4,\)",
    ),
    "groups_of": (
        lambda: correspondence.track_groups(zeros(3, 3), zeros(2), zeros(3, 3), 1.0),
        "view has shape .* with M = 3",
    ),
    "groups_by_affinity": (lambda: groups.groups_by_affinity(zeros(3, 4), zeros(3, 3)), r"affinity has shape \(3, 4\)"),
    "ray_directions": (
        lambda: correspondence.ray_directions(zeros(17, 3), CAMERAS[0]),
        r"keypoints has shape \(17, 3\)",
    ),
    "median_over_shared": (
        lambda: correspondence.median_over_shared(zeros(3, 4), zeros(3, 5), 1),
        r"present has shape \(3, 5\)",
    ),
    "relative_pose": (
        lambda: relative_pose.relative_pose(zeros(20, 2), zeros(19, 2), 0.01),
        r"second has shape \(19, 2\)",
    ),
    "sampson": (lambda: relative_pose.sampson(np.eye(3), zeros(4, 3), zeros(4, 3)), r"first has shape \(4, 3\)"),
    "in_front": (
        lambda: relative_pose.in_front(np.eye(3), MIDDLE, zeros(4, 2), zeros(4, 3)),
        r"second has shape \(4, 3\)",
    ),
    "resection": (lambda: relative_pose.resection(zeros(20, 2), zeros(20, 2), 0.01), r"points_m has shape \(20, 2\)"),
    "distort": (lambda: distort(zeros(3), "opencv", zeros(5)), r"points has shape \(3,\)"),
    "undistort": (lambda: undistort(zeros(2, 3), "fisheye", zeros(4)), r"points has shape \(2, 3\)"),
    "fold_radius": (
        lambda: fold_radius("opencv", bad(5)),
        "coefficients of the opencv model must be at most 8 finite numbers",
    ),
    "normalised": (lambda: lens.normalised_from_calibration(zeros(3), PINHOLE), r"pixels has shape \(3,\)"),
    "working_from_video": (
        lambda: lens.working_from_video(zeros(3), PINHOLE, (640, 480), np.eye(3)),
        r"pixels has shape \(3,\)",
    ),
    "working_from_calibration": (
        lambda: lens.working_from_calibration(zeros(2), PINHOLE, np.eye(2)),
        r"intrinsics has shape \(2, 2\)",
    ),
    "video_from_working": (
        lambda: lens.video_from_working(zeros(3), PINHOLE, (640, 480), np.eye(3)),
        r"pixels has shape \(3,\)",
    ),
    "patch_depth": (
        lambda: lifting.patch_depth(zeros(5, 5), np.ones((4, 5)), zeros(1, 2), 3, 0.1),
        r"valid_mask has shape \(4, 5\)",
    ),
    "lift_pelvis": (
        lambda: lifting.lift_pelvis(zeros(5, 5), zeros(5, 5), zeros(1, 2), CAMERAS[0]),
        r"depth_m has shape \(5, 5\)",
    ),
    "lift_joint": (
        lambda: lifting.lift_joint(zeros(4), zeros(3, 2), CAMERAS[0], 0.1),
        r"pixels has shape \(3, 2\), expected \(4, 2\)",
    ),
    "align_depth": (
        lambda: align_depth(zeros(5, 5), zeros(5, 4), np.ones((5, 5), bool), np.random.default_rng(0)),
        r"reference_m has shape \(5, 4\)",
    ),
    "triangulate": (
        lambda: triangulate(zeros(3, 5, 2), zeros(2, 5), CAMERAS, LIMITS),
        r"pixels has shape .* expected \(2, \.\.\., 2\)",
    ),
    "triangulate-confidence": (
        lambda: triangulate(zeros(2, 5, 2), zeros(2, 4), CAMERAS, LIMITS),
        r"confidence has shape \(2, 4\)",
    ),
    "project": (lambda: CAMERAS[0].project(zeros(4, 2)), r"points_m has shape \(4, 2\)"),
    "unproject": (lambda: CAMERAS[0].unproject(zeros(4, 2), zeros(3)), r"pixels has shape \(4, 2\), expected \(3, 2\)"),
    "kinematics": (
        lambda: skinning.forward_kinematics(EYES, zeros(23, 3), np.arange(-1, 23)),
        r"rest_joints_m has shape \(23, 3\)",
    ),
    "world_from_rest": (
        lambda: skinning.world_from_rest(EYES, zeros(3, 24, 3), zeros(24, 3)),
        r"joints_m has shape \(3, 24, 3\)",
    ),
    "skin": (lambda: skinning.skin(zeros(7, 3), zeros(8, 24), zeros(4, 24, 4, 4)), r"points_m has shape \(7, 3\)"),
    "skin-weights": (
        lambda: skinning.skin(zeros(8, 3), zeros(8, 23), zeros(4, 24, 4, 4)),
        r"weights has shape \(8, 23\)",
    ),
    "grid": (lambda: weight_grid.build_weight_grid(zeros(7, 3), zeros(8, 2), 4, 0.1), r"weights has shape \(8, 2\)"),
    "strongest": (lambda: weight_grid.strongest(zeros(7), 2), r"weights has shape \(7,\)"),
}

NUMBERS: dict[str, Case] = {
    "project_to_so3": (
        lambda: rotations.project_to_so3(bad(5, 3, 3)),
        r"matrices of shape \(5, 3, 3\) has 1 values that are not finite",
    ),
    "mean": (lambda: rotations.mean(bad(5, 3, 3)), "rotations of shape"),
    "mean-weights": (lambda: rotations.mean(EYES, bad(24)), "weights of shape"),
    "kabsch": (lambda: rotations.kabsch(bad(5, 3), zeros(5, 3), np.ones(5)), "source_m where it has weight"),
    "kabsch-weights": (lambda: rotations.kabsch(zeros(5, 3), zeros(5, 3), bad(5)), "weights of shape"),
    "look_at": (lambda: camera_path.look_at(bad(3), MIDDLE), "eye_m of shape"),
    "with_pose": (lambda: camera_path.with_pose(CAMERAS[0], bad(3, 3), MIDDLE), "world_from_camera of shape"),
    "azimuths": (lambda: camera_path.azimuths_rad(CAMERAS, bad(3)), "centre_m of shape"),
    "clearance_share": (lambda: camera_path.clearance_share(bad(4, 3), MIDDLE), "points_m of shape"),
    "smooth_vectors": (lambda: smoothing.smooth_vectors(bad(5, 3), 0.5, 1.0), "values of shape"),
    "smooth_rotations": (lambda: smoothing.smooth_rotations(bad(5, 3, 3), 0.5, 1.0), "values of shape"),
    "fit_scale": (lambda: scale.fit_scale(bad(4), np.ones(4), zeros(4)), "lengths of shape"),
    "scene_scale": (
        lambda: scale.scene_scale(zeros(1, 2, 24, 3), bad(1, 24, 3), zeros(1, 2), np.ones((1, 2, 24))),
        "template_joints_m of shape",
    ),
    "adjust-points": (
        lambda: adjusted(zeros(2, 5, 2), np.ones((2, 5)), bad(5, 3), np.ones(2)),
        "points_m that are seen of shape",
    ),
    "adjust-huber": (lambda: adjusted(zeros(2, 5, 2), np.ones((2, 5)), zeros(5, 3), bad(2)), "huber_px of shape"),
    "groups_by_affinity": (lambda: groups.groups_by_affinity(bad(3, 3), zeros(3, 3)), "affinity of shape"),
    "relative_pose": (lambda: relative_pose.relative_pose(bad(20, 2), zeros(20, 2), 0.01), "first of shape"),
    "resection": (lambda: relative_pose.resection(zeros(20, 3), bad(20, 2), 0.01), "normalised of shape"),
    "working": (lambda: lens.working_from_calibration(zeros(2), PINHOLE, bad(3, 3)), "intrinsics of shape"),
    "grid": (lambda: weight_grid.build_weight_grid(bad(8, 3), zeros(8, 2), 4, 0.1), "vertices_m of shape"),
    "query": (
        lambda: weight_grid.WeightGrid(zeros(3), 0.1, np.ones((2, 2, 2, 1))).query(bad(4, 3)),
        "points_m of shape",
    ),
    "strongest": (lambda: weight_grid.strongest(bad(4, 5), 2), "weights of shape"),
}


@pytest.mark.parametrize(("call", "message"), SHAPES.values(), ids=SHAPES)
def test_an_argument_of_another_shape_is_named(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize(("call", "message"), NUMBERS.values(), ids=NUMBERS)
def test_an_argument_that_is_not_finite_is_named(call: Callable[[], object], message: str) -> None:
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
