# SPDX-License-Identifier: Apache-2.0
"""Hard cases of cameras, rotations, triangulation, scale, depth, association and motion over time (families C, R, T, S,
D, A, F, V)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from studiorecon.geometry import rotations
from studiorecon.geometry.depth_alignment import align_depth
from studiorecon.geometry.distortion import distort, undistort
from studiorecon.geometry.scale import fit_scale
from studiorecon.geometry.smoothing import smooth_rotations, smooth_vectors
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.people.association.postures import joint_differences_rad
from studiorecon.report.metrics.jitter import rotation_jitter

from tests.hard.stability_case import Case
from tests.made.scene import ring


def _turn(angle_rad: float) -> np.ndarray:
    axis = np.array([0.3, -0.5, 0.81])
    return rotations.exp(axis / np.linalg.norm(axis) * angle_rad)


def _arccos_angle(turn: np.ndarray) -> float:
    return float(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))


def _textbook_log(turn: np.ndarray) -> np.ndarray:
    angle = _arccos_angle(turn)
    part = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    with np.errstate(all="ignore"):
        return angle / (2 * np.sin(angle)) * part


def _lost(turn: np.ndarray, vector: np.ndarray) -> float:
    """Degrees between a rotation and the one that its vector stands for; half a turn for a vector that is none."""
    if not np.isfinite(vector).all():
        return 180.0
    return float(np.degrees(rotations.angle(turn, rotations.exp(vector))))


_CAMERAS = ring([0, 80, 170, 260], "cam")
_POINT_M = np.array([0.2, -0.1, 1.2])


def _triangulated(solver: str, off_px: float) -> float:
    pixels = np.stack([camera.project(_POINT_M[None])[0][0] for camera in _CAMERAS])
    pixels[1, 0] += off_px
    found = triangulate(pixels[:, None], np.ones((len(_CAMERAS), 1)), _CAMERAS, Limits(), solver=solver)  # type: ignore[arg-type]
    return float(1000 * np.linalg.norm(found.points_m[0] - _POINT_M)) if found.valid[0] else np.nan


_BARREL = np.array([-0.32, 0.11, 0.0, 0.0, -0.015])


def _fixed_point(question: np.ndarray) -> np.ndarray:
    """The usual inversion: divide by the distortion at the last guess, five times (OpenCV's undistortPoints)."""
    guess = question.copy()
    for _ in range(5):
        guess = question * guess / distort(guess, "opencv", _BARREL)
    return guess


def _undistorted(inverse: Callable[[np.ndarray], np.ndarray], radius: float) -> float:
    true = radius * np.array([0.8, 0.6])
    return float(1000 * np.linalg.norm(inverse(distort(true, "opencv", _BARREL)) - true))


def _bones_scale(noise_m: float, ours: bool) -> float:
    """Error of the scale of 2,000 frames of twelve bones, their ends off by ``noise_m`` per coordinate; per cent."""
    rng = np.random.default_rng(4)
    template_m = np.tile([0.06, 0.09, 0.1, 0.18, 0.25, 0.27, 0.27, 0.36, 0.4, 0.41, 0.42, 0.55], 2000)
    bones = np.zeros((len(template_m), 3))
    bones[:, 0] = template_m
    seen = np.linalg.norm(bones + np.sqrt(2) * noise_m * rng.normal(size=bones.shape), axis=1)
    if ours:
        return 100 * abs(fit_scale(seen, template_m, np.full(len(seen), 2 * noise_m**2)) - 1)
    return float(100 * abs((seen / template_m).mean() - 1))


def _between_postures(short_rad: float, ours: bool) -> float:
    """Error of the angle between two joints that lie ``short_rad`` either side of half a turn; degrees."""
    vectors = np.array([[0.0, 0.0, np.pi - short_rad], [0.0, 0.0, np.pi + short_rad]])
    first, second = rotations.exp(vectors)
    if ours:
        found = float(joint_differences_rad(first[None], second[None]))
    else:
        found = float(np.linalg.norm(rotations.log(first) - rotations.log(second)))
    return float(np.degrees(abs(found - 2 * short_rad)))


def _about_z(degrees: np.ndarray) -> np.ndarray:
    return rotations.exp(np.radians(degrees)[:, None] * np.array([0.0, 0.0, 1.0]))


def _smoothed(facing_deg: float, ours: bool) -> float:
    """Degrees by which a steady slow turn is off in its middle, after smoothing with the paper's constants."""
    turns = _about_z(facing_deg + np.linspace(-20, 20, 81))
    smooth = (
        smooth_rotations(turns, 0.5, 1.0) if ours else rotations.exp(smooth_vectors(rotations.log(turns), 0.5, 1.0))
    )
    return float(np.degrees(rotations.angle(smooth, turns)[20:-20]).max())


def _jitter(facing_deg: float, ours: bool) -> float:
    """Degrees per frame² of a steady turn, which has none."""
    turns = _about_z(facing_deg + np.linspace(-15, 15, 31))
    if ours:
        return float(rotation_jitter(turns, np.ones(len(turns), bool)).mean())
    return float(np.degrees(np.linalg.norm(np.diff(rotations.log(turns), n=2, axis=0), axis=1)).mean())


def _scale_error(moved: float, robust: bool) -> float:
    rng = np.random.default_rng(3)
    true_m = rng.uniform(1.5, 6, 4000)
    predicted = (true_m - 0.2) / 1.7
    where = rng.random(4000) < moved
    seen_m = np.where(where, rng.uniform(0.5, 1.5, 4000), true_m)
    if robust:
        found = align_depth(predicted, seen_m, np.ones(4000, bool), np.random.default_rng(0))
        return 100 * abs(found.scale / 1.7 - 1)
    return float(100 * abs(np.polyfit(predicted, seen_m, 1)[0] / 1.7 - 1))


def _mean_error(apart_deg: float, ours: bool) -> float:
    """Mean of two turns about z that lie ``apart_deg`` either side of half a turn: half a turn."""
    turns = rotations.exp(np.radians([[0.0, 0.0, 180 - apart_deg], [0.0, 0.0, 180 + apart_deg]]))
    found = rotations.mean(turns)[0] if ours else rotations.exp(rotations.log(turns).mean(0))
    return float(np.degrees(rotations.angle(found, rotations.exp(np.array([0.0, 0.0, np.pi])))))


CASES = (
    Case(
        "angle",
        "R01-R04",
        "Angle of a small turn",
        "arccos of the trace loses half of the digits: below 1e-8 rad every turn is none, or the same one",
        "arctan2 of sine and cosine keeps them all",
        "angle, rad",
        [10.0**-k for k in range(13)],
        "relative error",
        lambda x: abs(_arccos_angle(_turn(x)) / x - 1),
        lambda x: float(abs(rotations.angle(np.eye(3), _turn(x)) / x - 1)),
        1e-3,
    ),
    Case(
        "log",
        "R05-R09",
        "Rotation vector near half a turn",
        "the axis is divided by a sine that goes to zero",
        "the axis comes from the largest row of the quaternion",
        "short of half a turn, rad",
        [10.0**-k for k in range(1, 17)],
        "rotation lost, degrees",
        lambda x: _lost(_turn(np.pi - x), _textbook_log(_turn(np.pi - x))),
        lambda x: _lost(_turn(np.pi - x), rotations.log(_turn(np.pi - x))),
        1e-6,
    ),
    Case(
        "mean",
        "R16, R17",
        "Mean of turns on either side of half a turn",
        "vectors on either side point in opposite directions, and their mean is no turn at all",
        "the mean is the eigenvector of quaternions' outer products, whose signs do not matter",
        "apart, degrees",
        [40.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.1],
        "error, degrees",
        lambda x: _mean_error(x, False),
        lambda x: _mean_error(x, True),
        1e-6,
    ),
    Case(
        "triangulation",
        "T01-T16",
        "A point of four views, one of them wrong",
        "least squares shares the error among all",
        "pairs propose, the truncated cost picks, and only views that agree refine",
        "pixels that one view is off",
        [0.0, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0],
        "error, mm",
        lambda x: _triangulated("dlt", x),
        lambda x: _triangulated("robust", x),
        20.0,
        log_x=False,
    ),
    Case(
        "distortion",
        "C09, C10",
        "Barrel distortion, undone",
        "dividing by the distortion of the last guess, a few times, ends too early where the picture ends",
        "Newton inside a bracket; beyond the fold there is no answer, and it says so",
        "radius, focal lengths",
        [0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 1.0],
        "error, thousandths of the focal length",
        lambda x: _undistorted(_fixed_point, x),
        lambda x: _undistorted(lambda q: undistort(q, "opencv", _BARREL)[0], x),
        1e-6,
        log_x=False,
    ),
    Case(
        "depth",
        "D01-D07",
        "Scale of a depth map where people have moved",
        "least squares follows whatever moved",
        "Theil-Sen, then Huber rounds, stand up to 45 % of moved pixels",
        "share of moved pixels",
        [0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.45],
        "error of the scale, %",
        lambda x: _scale_error(x, False),
        lambda x: _scale_error(x, True),
        1.0,
        log_x=False,
    ),
    Case(
        "bones",
        "S01-S07",
        "Scale from the lengths of noisy bones",
        "noise makes every bone longer, the short ones most, and the mean of the ratios with them",
        "the length that noise adds is taken off before it is compared, and no short bone outvotes a long one",
        "noise of a joint, m",
        [0.0, 0.002, 0.005, 0.01, 0.02, 0.03, 0.04],
        "error of the scale, %",
        lambda x: _bones_scale(x, False),
        lambda x: _bones_scale(x, True),
        1.0,
        log_x=False,
    ),
    Case(
        "posture",
        "A05-A08",
        "How alike two postures are, near half a turn",
        "rotation vectors on either side of half a turn are a whole turn apart: one person becomes two",
        "the angle of the turn that leads from one to the other",
        "short of half a turn, rad",
        [10.0**-k for k in range(9)],
        "error of the angle, degrees",
        lambda x: _between_postures(x, False),
        lambda x: _between_postures(x, True),
        1e-6,
    ),
    Case(
        "smoothing",
        "F01-F09",
        "A slow turn, smoothed, by where it faces",
        "components of rotation vectors are averaged, and one of them jumps by a turn",
        "rotations are averaged where they are, on the sphere of quaternions of one sign",
        "facing, degrees",
        [0.0, 45.0, 90.0, 135.0, 150.0, 165.0, 180.0],
        "error, degrees",
        lambda x: _smoothed(x, False),
        lambda x: _smoothed(x, True),
        1e-6,
        log_x=False,
    ),
    Case(
        "jitter",
        "V04, V05",
        "Jitter of a steady turn, by where it faces",
        "second differences of rotation vectors see a jump of a turn where there is none",
        "differences are turns from one frame to the next",
        "facing, degrees",
        [0.0, 45.0, 90.0, 135.0, 150.0, 165.0, 180.0],
        "degrees per frame²",
        lambda x: _jitter(x, False),
        lambda x: _jitter(x, True),
        1e-6,
        log_x=False,
    ),
)
