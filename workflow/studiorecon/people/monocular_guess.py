# SPDX-License-Identifier: Apache-2.0
"""The detector's metric guess, used where cameras do not suffice: swapped left and right, and people seen by one other
camera.

A guess assumes a person of usual size. Aligned with the landmarks that it was made with, its depth is known up to that
size, which two cameras give wherever both see the person. On the synthetic studio it is then within 3 to 6 % of the
body's extent of another camera's landmarks, in the median, and the left-right direction is within 37° of the truth for
nine in ten.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.people.expected_keypoints import ExpectedKeypoints
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# A landmark agrees with a guess when it is this near to it, as a share of the person's extent in the picture.
_NEAR_SHARE = 0.1
# Less confident landmarks do not count; so many are needed.
_SURE, _MIN = 0.3, 6
# Time within which a person faces about the same way, seconds; number of other detections that must agree; cosine below
# which they contradict one.
_STEADY_S, _SIGHTS, _CONTRADICTED = 0.5, 3, -0.5
# Least agreement of those other detections among themselves, length of their mean.
_CLEAR = 0.5
# The rays of a landmark must meet at this angle for the depth they give, radians.
_MIN_ANGLE_RAD = 0.17


def right_to_left(found: Detections, camera: Camera) -> Num[np.ndarray, "D 3"]:
    """Level unit vectors of the world from each person's right to their left, by the guess; NaN without one."""
    names = LAYOUTS[found.layout].keypoints
    ends = [f"{side}_{joint}" for joint in ("shoulder", "hip") for side in ("left", "right")]
    if found.points_m is None or not set(ends) <= set(names):
        return np.full((len(found.frame), 3), np.nan)
    left_s, right_s, left_h, right_h = (found.points_m[:, names.index(end)] for end in ends)
    world = ((left_s - right_s) + (left_h - right_h)) @ camera.world_from_camera[:3, :3].T
    world[:, 2] = 0.0
    length = np.linalg.norm(world, axis=1, keepdims=True)
    return np.where(length > 1e-6, world / np.maximum(length, 1e-6), np.nan)


def is_left_right_swapped(
    found: Detections, camera: Camera, owners: Sequence[str], fps: float
) -> Bool[np.ndarray, " D"]:
    """Detections whose left and right contradict the same person's neighbouring detections in this camera."""
    direction, whose = right_to_left(found, camera), np.array(owners, dtype=object)
    out = np.zeros(len(found.frame), bool)
    for person in sorted({str(owner) for owner in owners if owner}):
        mine = np.flatnonzero((whose == person) & np.isfinite(direction).all(1))
        for d in mine:
            near = mine[(np.abs(found.frame[mine] - found.frame[d]) <= _STEADY_S * fps) & (mine != d)]
            if len(near) < _SIGHTS:
                continue
            usual = direction[near].mean(0)
            out[d] = np.linalg.norm(usual) >= _CLEAR and direction[d] @ usual / np.linalg.norm(usual) <= _CONTRADICTED
    return out


def guess_in_world(found: Detections, camera: Camera) -> Num[np.ndarray, "D K 3"]:
    """World points of every detection's guess, fitted to its landmarks (linear least squares).

    NaN where too few are confident.
    """
    out = np.full((*found.keypoints.shape[:2], 3), np.nan)
    if found.points_m is None:
        return out
    focal, middle = camera.focal_px, camera.intrinsics[:2, 2]
    for d, (keypoints, guess) in enumerate(zip(found.keypoints, found.points_m)):
        sure = (keypoints[:, 2] >= _SURE) & np.isfinite(guess).all(1)
        if sure.sum() < _MIN:
            continue
        ray = (keypoints[sure, :2] - middle) / focal
        weight = keypoints[sure, 2]
        rows = np.zeros((2, len(ray), 3))
        rows[0, :, 0] = rows[1, :, 1] = weight
        rows[:, :, 2] = -(weight[:, None] * ray).T
        wanted = (weight[:, None] * (ray * guess[sure, 2:] - guess[sure, :2])).T
        moved = guess + np.linalg.lstsq(rows.reshape(-1, 3), wanted.reshape(-1), rcond=None)[0]
        if (moved[sure, 2] > 0).all():
            out[d] = moved @ camera.world_from_camera[:3, :3].T + camera.centre_m
    return out


def project_guess(
    person: str,
    view: int,
    cameras: Sequence[Camera],
    detections: Sequence[Detections],
    identities: Mapping[tuple[str, int], str],
    frames: int,
) -> ExpectedKeypoints:
    """The other camera's guess of ``person``, in pixels of camera ``view``; NaN without one.

    Also NaN where no moment determines the person's size.
    """
    other = 1 - view
    found, camera = detections[other], cameras[other]
    rows = {v: _best_detections(person, detections[v], identities) for v in (view, other)}
    points_m = guess_in_world(found, camera)
    factors = [
        _depth_factor(points_m[d], detections[view].keypoints[rows[view][frame]], camera, cameras[view])
        for frame, d in rows[other].items()
        if frame in rows[view]
    ]
    known = [factor for factor in factors if np.isfinite(factor)]
    pixels = np.full((frames, points_m.shape[1], 2), np.nan)
    if known:
        factor = float(np.median(known))
        for frame, d in rows[other].items():
            where, depth = cameras[view].project(camera.centre_m + factor * (points_m[d] - camera.centre_m))
            sure = found.keypoints[d, :, 2] >= _SURE
            pixels[frame] = np.where(((depth > 0) & sure)[:, None], where, np.nan)
    return ExpectedKeypoints(person, pixels, _NEAR_SHARE)


def _best_detections(person: str, found: Detections, identities: Mapping[tuple[str, int], str]) -> dict[int, int]:
    """Frame → a person's detection, the more confident one of two."""
    best: dict[int, int] = {}
    for d, (frame, track) in enumerate(zip(found.frame, found.track)):
        if identities.get((found.camera, int(track)), "") != person:
            continue
        before = best.get(int(frame))
        if before is None or found.keypoints[d, :, 2].sum() > found.keypoints[before, :, 2].sum():
            best[int(frame)] = d
    return best


def _depth_factor(points_m: np.ndarray, keypoints: np.ndarray, camera: Camera, view: Camera) -> float:
    """Factor on the distances of guessed points (K, 3) from ``camera`` with which ``view`` sees them at its landmarks
    (K, 3).

    The median over those whose rays meet at an angle; NaN where there are too few.
    """
    sure = (keypoints[:, 2] >= _SURE) & np.isfinite(points_m).all(1)
    if sure.sum() < _MIN:
        return float("nan")
    there = points_m[sure] - camera.centre_m
    distance = np.linalg.norm(there, axis=1)
    first = there / distance[:, None]
    second = view.unproject(keypoints[sure, :2], np.ones(int(sure.sum()))) - view.centre_m
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    cosine = (first * second).sum(1)
    baseline = view.centre_m - camera.centre_m
    # Position along the first ray where the second passes nearest.
    along = (first @ baseline - cosine * (second @ baseline)) / np.maximum(1 - cosine**2, 1e-9)
    usable = (np.sqrt(np.maximum(1 - cosine**2, 0)) > np.sin(_MIN_ANGLE_RAD)) & (along > 0)
    return float(np.median(along[usable] / distance[usable])) if usable.sum() >= _MIN else float("nan")
