# SPDX-License-Identifier: Apache-2.0
"""Poses from points: of two cameras relative to each other (up to scale), and of a camera relative to points."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import require
from studiorecon.geometry.rotations import cross_matrix, exp

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

_MIN_PAIRS = 12
_CONFIDENCE = 0.9999


def relative_pose(
    first: Num[np.ndarray, "N 2"], second: Num[np.ndarray, "N 2"], unit: float
) -> tuple[Num[np.ndarray, "3 3"], Num[np.ndarray, " 3"], Bool[np.ndarray, " N"]] | None:
    """Rotation, unit translation and inliers with x_second = R x_first + t, or None.

    ``first`` and ``second`` are undistorted normalised coordinates of the same points, ``unit`` the Sampson distance of
    an inlier. From samples of five points (Nister 2004) by OpenCV's USAC, which refines on the inliers: cameras of rigs
    end in the same places as after least squares of the Sampson distance. Only points in front of both cameras are
    inliers. Raises ValueError for other shapes and coordinates that are not finite.
    """
    require("second", second, ("N", 2), require("first", first, ("N", 2), finite=True), finite=True)
    if len(first) < _MIN_PAIRS:
        return None
    essential, _ = cv2.findEssentialMat(
        first, second, np.eye(3), method=cv2.USAC_DEFAULT, prob=_CONFIDENCE, threshold=unit
    )
    if essential is None:
        return None
    best = None
    for start in range(0, len(essential), 3):
        agreed = np.abs(sampson(essential[start : start + 3], first, second)) < unit
        if agreed.sum() < _MIN_PAIRS:
            continue
        _, rotation, translation, ahead = cv2.recoverPose(
            essential[start : start + 3],
            first[agreed],
            second[agreed],
            np.eye(3),
            mask=np.ones((int(agreed.sum()), 1), np.uint8),
        )
        if best is None or int((ahead > 0).sum()) > best[0]:
            best = int((ahead > 0).sum()), rotation, translation[:, 0]
    if best is None or best[0] < _MIN_PAIRS:
        return None
    _, rotation, translation = best
    inliers = (np.abs(sampson(essential_matrix(rotation, translation), first, second)) < unit) & is_in_front(
        rotation, translation, first, second
    )
    return (rotation, translation, inliers) if inliers.sum() >= _MIN_PAIRS else None


def essential_matrix(rotation: Num[np.ndarray, "3 3"], translation: Num[np.ndarray, " 3"]) -> Num[np.ndarray, "3 3"]:
    """E = [t]x R, with second^T E first = 0."""
    return cross_matrix(translation) @ rotation


def sampson(
    essential: Num[np.ndarray, "3 3"], first: Num[np.ndarray, "N 2"], second: Num[np.ndarray, "N 2"]
) -> Num[np.ndarray, " N"]:
    """Signed Sampson distance: to first order, how far the two points are from a consistent pair.

    Raises ValueError for other shapes.
    """
    require("second", second, ("N", 2), require("first", first, ("N", 2)))
    # Epipolar lines of (x, y, 1) in either picture.
    line, back = first @ essential[:, :2].T + essential[:, 2], second @ essential[:2] + essential[2]
    scale = np.sqrt((line[:, :2] ** 2).sum(-1) + (back[:, :2] ** 2).sum(-1))
    return ((second * line[:, :2]).sum(-1) + line[:, 2]) / np.maximum(scale, 1e-12)


def is_in_front(
    rotation: Num[np.ndarray, "3 3"],
    translation: Num[np.ndarray, " 3"],
    first: Num[np.ndarray, "N 2"],
    second: Num[np.ndarray, "N 2"],
) -> Bool[np.ndarray, " N"]:
    """Whether the closest points of a pair's rays are in front of both cameras. Raises ValueError for other shapes."""
    require("second", second, ("N", 2), require("first", first, ("N", 2)))
    one = np.pad(first, ((0, 0), (0, 1)), constant_values=1.0) @ rotation.T
    two = np.pad(second, ((0, 0), (0, 1)), constant_values=1.0)
    # a · one + t = b · two in the second camera's axes, least squares for (a, b)
    aa, bb, ab = (one**2).sum(-1), (two**2).sum(-1), (one * two).sum(-1)
    at, bt = one @ translation, two @ translation
    determinant = aa * bb - ab**2
    return (-at * bb + ab * bt > 0) & (aa * bt - ab * at > 0) & (determinant > 1e-9 * aa * bb)


def resection(
    points_m: Num[np.ndarray, "N 3"], normalised: Num[np.ndarray, "N 2"], unit: float
) -> tuple[Num[np.ndarray, "4 4"], Bool[np.ndarray, " N"]] | None:
    """``camera_from_world`` and inliers of a camera that sees world points at ``normalised``, or None.

    Three-point RANSAC, then Levenberg-Marquardt on the inliers; ``unit`` as above. Raises ValueError for other shapes
    and numbers that are not finite.
    """
    require("normalised", normalised, ("N", 2), require("points_m", points_m, ("N", 3), finite=True), finite=True)
    if len(points_m) < _MIN_PAIRS:
        return None
    points, pixels = np.ascontiguousarray(points_m), np.ascontiguousarray(normalised)
    found, turn, shift, chosen = cv2.solvePnPRansac(
        points,
        pixels,
        np.eye(3),
        None,
        iterationsCount=300,
        reprojectionError=unit,
        confidence=_CONFIDENCE,
        flags=cv2.SOLVEPNP_AP3P,
    )
    if not found or chosen is None or len(chosen) < _MIN_PAIRS:
        return None
    inliers = np.zeros(len(points), dtype=bool)
    inliers[chosen[:, 0]] = True
    for _ in range(3):
        turn, shift = cv2.solvePnPRefineLM(points[inliers], pixels[inliers], np.eye(3), None, turn, shift)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = exp(turn[:, 0]), shift[:, 0]
        inliers = reprojection_distances(pose, points, pixels) < unit
        if inliers.sum() < _MIN_PAIRS:
            return None
    return pose, inliers


def reprojection_distances(
    camera_from_world: Num[np.ndarray, "4 4"], points_m: Num[np.ndarray, "N 3"], normalised: Num[np.ndarray, "N 2"]
) -> Num[np.ndarray, " N"]:
    """Distance between projected world points and ``normalised``; inf behind the camera."""
    in_camera = points_m @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
    ahead = in_camera[:, 2] > 1e-6
    error = np.linalg.norm(in_camera[:, :2] / np.where(ahead, in_camera[:, 2], 1.0)[:, None] - normalised, axis=-1)
    return np.where(ahead, error, np.inf)
