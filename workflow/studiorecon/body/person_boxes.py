# SPDX-License-Identifier: Apache-2.0
"""Regions of the image where detected people are, drawn generously: pixels that may hide the background."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

# Keypoints below this confidence are guesses that would stretch the outline across the room.
_MIN_CONFIDENCE = 0.2
# Half-thickness of limbs and radius of the head, as shares of a person's height; a hand extends the forearm by this
# share.
_LIMB, _HEAD, _HAND = 0.035, 0.065, 0.5
_FACE = ("nose", "left_eye", "right_eye", "left_ear", "right_ear", "head_top")
_TORSO = ("left_shoulder", "right_shoulder", "right_hip", "left_hip")
_CHAIN = ("shoulder", "hip", "knee", "ankle")


def people_regions(
    detections: Detections, frames: Num[np.ndarray, " T"], hw: tuple[int, int], margin: float, hold: int
) -> Bool[np.ndarray, "T H W"]:
    """Regions of detected people at the working frames ``frames``.

    Thick limbs, torso and head along the layout's bones, grown by ``margin`` times the person's height, because clothes
    and hair are wider than bodies. A detection covers ``hold`` frames before and after, because detectors miss single
    frames.
    """
    regions = np.zeros((len(frames), *hw), np.uint8)
    layout = LAYOUTS[detections.layout]
    for keypoints, frame in zip(detections.keypoints, detections.frame):
        seen = (keypoints[:, 2] >= _MIN_CONFIDENCE) & np.isfinite(keypoints[:, :2]).all(axis=1)
        points = {name: keypoints[k, :2] for k, name in enumerate(layout.keypoints) if seen[k]}
        bones = [(layout.keypoints[a], layout.keypoints[b]) for a, b in layout.edges]
        for index in np.flatnonzero(np.abs(frames - frame) <= hold):
            draw_person(regions[index], points, bones, margin)
    return regions.astype(bool)


def draw_person(
    region: Num[np.ndarray, "H W"],
    points: dict[str, Num[np.ndarray, " 2"]],
    bones: Sequence[tuple[str, str]],
    margin: float,
) -> None:
    """Draw one person into ``region``; ``points`` are pixels by keypoint name, absent when not seen."""
    if len(points) < 3:
        return
    height_px = _height_px(points)
    thickness = max(1, round(2 * (_LIMB + margin) * height_px))
    for a, b in bones:
        if a in points and b in points:
            cv2.line(region, _pixel(points[a]), _pixel(points[b]), 1, thickness)
    for side in ("left", "right"):
        elbow, wrist = points.get(f"{side}_elbow"), points.get(f"{side}_wrist")
        if elbow is not None and wrist is not None:
            cv2.line(region, _pixel(wrist), _pixel(wrist + _HAND * (wrist - elbow)), 1, thickness)
    torso = [points[n] for n in _TORSO if n in points]
    if len(torso) >= 3:
        cv2.fillConvexPoly(region, cv2.convexHull(np.array([_pixel(p) for p in torso], np.int32)), 1)
    face = [points[n] for n in _FACE if n in points]
    shoulders = [points[n] for n in _TORSO[:2] if n in points]
    if face:
        centre = np.mean(face, axis=0)
        cv2.circle(region, _pixel(centre), max(1, round((_HEAD + margin) * height_px)), 1, -1)
        if shoulders:
            cv2.line(region, _pixel(centre), _pixel(np.mean(shoulders, axis=0)), 1, thickness)


def _height_px(points: dict[str, np.ndarray]) -> float:
    """A person's height in pixels, along the longer leg and the torso, so that crouching does not shrink it."""
    found = np.array(list(points.values()))
    longest = float(np.max(np.ptp(found, axis=0)))
    for side in ("left", "right"):
        joints = [points.get(f"{side}_{name}") for name in _CHAIN]
        lengths = [
            float(np.linalg.norm(b - a)) for a, b in itertools.pairwise(joints) if a is not None and b is not None
        ]
        longest = max(longest, 1.2 * sum(lengths))
    return longest


def _pixel(point: np.ndarray) -> tuple[int, int]:
    # Far outside, drawing only costs time; the clip keeps numbers within OpenCV's integers.
    return int(np.clip(np.floor(point[0]), -10000, 10000)), int(np.clip(np.floor(point[1]), -10000, 10000))
