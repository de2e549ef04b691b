# SPDX-License-Identifier: Apache-2.0
"""A film of drawn people who walk, turn or stay where they are, and their keypoints: cheap, without cameras."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.scene.recorded_keypoints import RecordedKeypoints

# Shares of somebody's height, from the feet upwards and to the right.
_JOINTS = {
    "nose": (0.0, 0.93), "eye": (0.02, 0.95), "ear": (0.04, 0.94), "shoulder": (0.11, 0.82), "elbow": (0.16, 0.64),
    "wrist": (0.17, 0.48), "hip": (0.07, 0.53), "knee": (0.08, 0.28), "ankle": (0.08, 0.04),
}  # fmt: skip
_LIMBS = ("shoulder elbow", "elbow wrist", "hip knee", "knee ankle", "shoulder hip")
_NAMES = LAYOUTS["coco17"].keypoints


@dataclass(frozen=True)
class Take:
    """A film and what a detector says of it."""

    pictures: list[np.ndarray]
    recorded: RecordedKeypoints
    wh: tuple[int, int]
    fps: float


def body(x: float, foot: float, height: float, swing: float) -> np.ndarray:
    """(17, 2) joints of somebody who stands at (x, foot); ``swing`` of arms and legs, radians."""
    points = []
    for name in _NAMES:
        side, _, part = name.rpartition("_")
        right, up = _JOINTS[part]
        way = {"left": 1.0, "right": -1.0, "": 0.0}[side]
        stride = {"knee": 0.07, "ankle": 0.14, "elbow": -0.05, "wrist": -0.12}.get(part, 0.0)
        points.append((x + height * (way * right + way * stride * np.sin(swing)), foot - height * up))
    return np.array(points)


def drawn(picture: np.ndarray, points: np.ndarray, height: float, colour: tuple[int, int, int]) -> None:
    """Draw somebody's limbs, trunk and head."""
    at = dict(zip(_NAMES, points))
    thick = max(2, round(height * 0.06))
    for limb in _LIMBS:
        one, two = limb.split()
        for side in ("left", "right"):
            ends = [tuple(int(v) for v in at[f"{side}_{part}"]) for part in (one, two)]
            cv2.line(picture, ends[0], ends[1], colour, thick)
    trunk = np.array([at[n] for n in ("left_shoulder", "right_shoulder", "right_hip", "left_hip")])
    cv2.fillConvexPoly(picture, trunk.astype(np.int32), colour)
    cv2.circle(picture, tuple(int(v) for v in at["nose"]), max(2, round(height * 0.07)), colour, -1)


def take(seed: int, frames: int = 96, people: int = 2, wh: tuple[int, int] = (320, 180), moving: float = 1.0) -> Take:
    """A take at 30 pictures per second; ``moving`` 0: everybody stands still. Keypoints have noise and gaps."""
    rng, fps = np.random.default_rng(seed), 30.0
    w, h = wh
    room = cv2.resize(rng.integers(60, 200, (h // 12, w // 12, 3), dtype=np.uint8), wh, interpolation=cv2.INTER_CUBIC)
    # Small enough for feet and head to stay in the picture, somewhere off its middle.
    heights = rng.uniform(0.35, 0.65, people) * h
    feet = rng.uniform(0.8, 0.97, people) * h
    middle, reach = rng.uniform(0.3, 0.7, people) * w, rng.uniform(0.15, 0.4, people) * w * moving
    phase, rate = rng.uniform(0, 6, people), rng.uniform(0.1, 0.3, people)
    colours = [tuple(int(v) for v in rng.integers(0, 255, 3)) for _ in range(people)]
    pictures, frame, keypoints = [], [], []
    for t in range(frames):
        picture = room.copy()
        for k in range(people):
            x = middle[k] + reach[k] * np.sin(phase[k] + 2 * np.pi * rate[k] * t / fps)
            points = body(x, feet[k], heights[k], moving * 2 * np.pi * 0.9 * t / fps + phase[k])
            drawn(picture, points, heights[k], colours[k])
            if rng.random() > 0.05:
                noisy = points + rng.normal(0, 0.012 * heights[k], points.shape)
                seen = ((noisy > 0) & (noisy < wh)).all(-1)
                frame.append(t)
                keypoints.append(np.where(seen[:, None], np.column_stack([noisy, rng.uniform(0.4, 0.95, 17)]), 0.0))
        noise = rng.normal(0, 2.5, picture.shape) + rng.normal(0, 1.0)
        pictures.append(np.clip(picture + noise, 0, 255).astype(np.uint8))
    recorded = RecordedKeypoints("made", np.arange(frames), np.array(frame), np.array(keypoints), False, "coco17")
    return Take(pictures, recorded, wh, fps)
