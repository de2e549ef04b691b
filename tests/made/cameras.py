# SPDX-License-Identifier: Apache-2.0
"""Cameras on a ring that look at its middle, and people as clouds of keypoints: planted truth for geometry tests."""

from __future__ import annotations

import numpy as np
from studiorecon.geometry.triangulation import Limits
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

LIMITS = Limits(min_confidence=0.1, huber_share=0.005, outlier_units=3.0, min_angle_deg=2.0, near_m=0.1)
# Shoulders, elbows, wrists, hips, knees, ankles, left before right, of somebody standing at the origin and facing x.
_LEFT = np.array(
    [[0, 0.18, 1.42], [0.02, 0.25, 1.15], [0.1, 0.24, 0.92], [0, 0.1, 0.92], [0.03, 0.1, 0.5], [0, 0.1, 0.09]]
)
STANDING = np.stack([_LEFT, _LEFT * [1, -1, 1]], axis=1).reshape(12, 3)


def look_at(
    name: str, centre: np.ndarray, target: np.ndarray, wh: tuple[int, int] = (1280, 704), focal_px: float = 1000.0
) -> Camera:
    """A camera that looks at ``target``, level unless it looks straight down."""
    forward = np.asarray(target, float) - centre
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-9 else np.array([1.0, 0.0, 0.0])
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ centre
    return Camera(name, wh, np.array([[focal_px, 0, wh[0] / 2], [0, focal_px, wh[1] / 2], [0, 0, 1]]), pose)


def ring(
    count: int = 4, radius_m: float = 4.0, height_m: float = 1.5, wh: tuple[int, int] = (1280, 704)
) -> list[Camera]:
    angles = np.arange(count) * 2 * np.pi / count
    return [
        look_at(f"c{i}", np.array([radius_m * np.cos(a), radius_m * np.sin(a), height_m]), [0, 0, 1], wh)
        for i, a in enumerate(angles)
    ]


def arc(degrees: float, radius_m: float = 4.0) -> list[Camera]:
    """Two cameras whose rays meet at ``degrees`` in the middle."""
    angles = np.radians([-degrees / 2, degrees / 2])
    return [
        look_at(f"c{i}", np.array([radius_m * np.cos(a), radius_m * np.sin(a), 1.0]), [0, 0, 1])
        for i, a in enumerate(angles)
    ]


def seen(
    cameras: list[Camera], points_m: np.ndarray, noise_px: float = 0.0, rng: np.random.Generator | None = None
) -> np.ndarray:
    """(V, N, 2) pixels of world points, with noise."""
    pixels = np.stack([c.project(points_m)[0] for c in cameras])
    return pixels if rng is None else pixels + rng.normal(0, noise_px, pixels.shape)


def walk(start: np.ndarray, velocity_m: np.ndarray, frames: int, turn_rad: float = 0.0) -> np.ndarray:
    """(T, 12, 3) a standing person that slides along, arms and legs swinging so that no two frames are alike."""
    t = np.arange(frames)
    swing = 0.15 * np.sin(0.4 * t)[:, None] * np.repeat([0, 0.5, 1, 0, 0.5, 1], 2) * np.tile([1, -1], 6)
    body = STANDING[None] + np.stack([swing, np.zeros_like(swing), np.zeros_like(swing)], axis=-1)
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    return (
        body @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T
        + np.asarray(start)
        + t[:, None, None] * np.asarray(velocity_m)
    )


def detect(
    cameras: list[Camera],
    people: list[np.ndarray],
    noise_px: float,
    rng: np.random.Generator,
    missing: set[tuple[int, int]] = frozenset(),
) -> list[Detections]:
    """What every camera sees of ``people`` (T, 12, 3 each; NaN frames unseen), tracks in shuffled order; ``missing``
    (view, person)."""
    found = []
    for v, camera in enumerate(cameras):
        order = rng.permutation(len(people))
        frames, tracks, keypoints = [], [], []
        for track, p in enumerate(order):
            if (v, int(p)) in missing:
                continue
            pixels, depth = camera.project(people[p])
            pixels = pixels + rng.normal(0, noise_px, pixels.shape)
            inside = (depth > 0.1) & (pixels >= 0).all(-1) & (pixels < camera.wh).all(-1)
            for t in np.flatnonzero(inside.sum(-1) >= 6):
                frames.append(t)
                tracks.append(track)
                keypoints.append(in_coco(np.where(inside[t, :, None], pixels[t], np.nan), inside[t]))
        order_in_time = np.argsort(frames, kind="stable")
        found.append(
            Detections(
                camera.name,
                "coco17",
                np.array(frames, dtype=int)[order_in_time],
                np.array(tracks, dtype=int)[order_in_time],
                np.array(keypoints).reshape(-1, 17, 3)[order_in_time],
            )
        )
    return found


def owner(cameras: list[Camera], detections: list[Detections], people: list[np.ndarray]) -> dict[tuple[int, int], int]:
    """(view, track) → index of the planted person whose projection lies nearest."""
    table = {}
    names = _coco_places()
    for v, d in enumerate(detections):
        for track in np.unique(d.track):
            i = int(np.flatnonzero(d.track == track)[0])
            apart = [
                np.linalg.norm(cameras[v].project(p[d.frame[i]])[0] - d.keypoints[i][names][:, :2], axis=-1)
                for p in people
            ]
            errors = [np.median(a[np.isfinite(a)]) if np.isfinite(a).any() else np.inf for a in apart]
            table[v, int(track)] = int(np.argmin(errors))
    return table


def _coco_places() -> list[int]:
    from studiorecon.keypoints.layouts import LAYOUTS

    return [LAYOUTS["coco17"].index(k) for k in STABLE_KEYPOINTS]


def in_coco(pixels: np.ndarray, present: np.ndarray) -> np.ndarray:
    full = np.full((17, 3), [np.nan, np.nan, 0.0])
    full[_coco_places()] = np.concatenate([pixels, np.where(present, 0.9, 0.0)[:, None]], axis=1)
    return full
