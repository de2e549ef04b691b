# SPDX-License-Identifier: Apache-2.0
"""People who walk about without a plan, as the embedded detector sees them in films without sound: for clocks.

The studio's own play repeats itself after seconds, so nobody could tell its moments apart over a longer film. Errors
are as measured on the demo's films (480 × 272, 60 frames, pose_landmark_heavy against the true bodies, in shares of a
body's height in the picture): 1 % that stays, 1 % that wanders within about 0.3 s, and 0.3 % from frame to frame; one
joint of ten is missing, and tracks break off after some seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from studiorecon.geometry.camera_motion import move_camera
from studiorecon.geometry.rotations import exp
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.clocks import Clock
from studiorecon.scene.people import Detections

from tests.made.cameras import STANDING, ring

_LASTING, _WANDERING, _FROM_FRAME_TO_FRAME = 0.01, 0.01, 0.003
_WANDERS_S = 0.3
_MISSING = 0.1
_TRACK_S = 4.0
# The room that people walk about in, metres to either side, and how long they take to think of another place.
_ROOM_M, _PLACE_S, _GESTURE_S = 1.2, 1.6, 0.45
_STRIDE_M = 1.2
_LIMBS = np.repeat([0, 0.5, 1, 0, 0.5, 1], 2)
_COCO = [LAYOUTS["coco17"].index(k) for k in STABLE_KEYPOINTS]


@dataclass(frozen=True)
class Silent:
    """A camera: it begins at ``start_s`` of the world's time, its second is longer by ``drift_ppm``; ``own_s``: when it
    takes its pictures, by its own clock."""

    camera: Camera
    start_s: float
    own_s: np.ndarray
    drift_ppm: float = 0.0

    @property
    def world_s(self) -> np.ndarray:
        return self.start_s + self.own_s * (1 + 1e-6 * self.drift_ppm)


def wanderer(times_s: np.ndarray, seed: int, longest_s: float = 200.0) -> np.ndarray:
    """(T, 12, 3) the keypoints of somebody who walks to and fro, turns and gestures; the same person of a seed at any
    moments."""
    rng = np.random.default_rng([seed, 77])
    knots = np.arange(-2 * _PLACE_S, longest_s, _PLACE_S)
    place = CubicSpline(knots, rng.uniform(-_ROOM_M, _ROOM_M, (len(knots), 2)))
    fine = np.arange(-_PLACE_S, longest_s - 2 * _PLACE_S, 0.05)
    speed = np.linalg.norm(place(fine, 1), axis=1)
    gone = CubicSpline(fine, np.cumsum(speed) * 0.05)
    # Who steps aside does not turn on the spot: the direction is that of the last and the next half second.
    ahead = place(fine + 0.5) - place(fine - 0.5)
    heading = CubicSpline(fine, np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])))(times_s)
    phase = 2 * np.pi * gone(times_s) / _STRIDE_M
    pace = np.minimum(np.linalg.norm(place(times_s, 1), axis=1) / 0.8, 1.0)
    swing = 0.2 * (pace * np.sin(phase))[:, None] * _LIMBS * np.tile([1, -1], 6)
    gestures = np.arange(-2 * _GESTURE_S, longest_s, _GESTURE_S)
    arms = CubicSpline(gestures, rng.normal(0, 0.12, (len(gestures), 4, 3)))(times_s)
    body = np.repeat(STANDING[None], len(times_s), axis=0)
    body[..., 0] += swing
    body[:, 2:6] += arms * np.array([0.4, 0.4, 1, 1])[None, :, None]
    c, s = np.cos(heading), np.sin(heading)
    turned = np.stack(
        [
            c[:, None] * body[..., 0] - s[:, None] * body[..., 1],
            s[:, None] * body[..., 0] + c[:, None] * body[..., 1],
            body[..., 2],
        ],
        axis=-1,
    )
    turned[..., :2] += place(times_s)[:, None]
    return turned


def sighted(film: Silent, people: Sequence[int], rng: np.random.Generator) -> Detections:
    """What the detector reports of the ``people`` (seeds of ``wanderer``) in one silent film."""
    frames, tracks, keypoints, count = [], [], [], 0
    step_s = np.diff(film.own_s, prepend=film.own_s[0])
    stays = np.exp(-step_s / _WANDERS_S)[:, None, None]
    for person in people:
        pixels, depth = film.camera.project(wanderer(film.world_s, person))
        height = (pixels[..., 1].max(1) - pixels[..., 1].min(1))[:, None, None]
        wanders = rng.normal(size=pixels.shape)
        for t in range(1, len(wanders)):
            wanders[t] = stays[t] * wanders[t - 1] + np.sqrt(1 - stays[t] ** 2) * wanders[t]
        error = _LASTING * rng.normal(size=pixels.shape[1:]) + _WANDERING * wanders
        pixels = pixels + height * (error + _FROM_FRAME_TO_FRAME * rng.normal(size=pixels.shape))
        inside = (depth > 0.1) & (pixels >= 0).all(-1) & (pixels < film.camera.wh).all(-1)
        there = inside & (rng.uniform(size=inside.shape) > _MISSING)
        broken = np.cumsum(rng.uniform(size=len(pixels)) < step_s / _TRACK_S)
        for t in np.flatnonzero(there.sum(1) >= 6):
            full = np.full((17, 3), [np.nan, np.nan, 0.0])
            full[_COCO] = np.column_stack([np.where(there[t, :, None], pixels[t], np.nan), 0.9 * there[t]])
            frames.append(t)
            tracks.append(count + broken[t])
            keypoints.append(full)
        count += int(broken[-1]) + 1
    order = np.argsort(frames, kind="stable")
    return Detections(
        film.camera.name,
        "coco17",
        np.array(frames, dtype=int)[order],
        np.array(tracks, dtype=int)[order],
        np.array(keypoints).reshape(-1, 17, 3)[order],
    )


@dataclass(frozen=True)
class Rough:
    """Cameras whose calibration is off, started one after the other: what they see of people, their clocks as filmed,
    the calibrated lenses with the sizes of the footage, and when each was started (seconds)."""

    seen: list[Detections]
    clocks: list[Clock]
    lenses: dict[str, tuple[Lens, tuple[int, int]]]
    start_s: np.ndarray


def rough(
    seed: int,
    cameras: int = 4,
    fps: float = 30.0,
    seconds: float = 4.0,
    spread_s: float = 0.15,
    off_deg: float = 1.0,
    off_m: float = 0.05,
    people: int = 2,
) -> Rough:
    """A ring of cameras of 640 × 360 pixels, ``off_deg`` about every axis and ``off_m`` along every axis (1 σ) from
    where they are calibrated, started up to ``spread_s`` before or after the others."""
    rng = np.random.default_rng(seed)
    intrinsics = np.array([[500.0, 0, 320], [0, 500, 180], [0, 0, 1]])
    stand = [replace(c, intrinsics=intrinsics) for c in ring(cameras, 4.0, 1.6, (640, 360))]
    start_s = 5 + rng.uniform(-spread_s, spread_s, cameras)
    own_s = np.arange(round(seconds * fps)) / fps
    films = [Silent(camera, start, own_s) for camera, start in zip(stand, start_s, strict=True)]
    seen = [sighted(film, [10 * seed + person for person in range(people)], rng) for film in films]
    lenses = {}
    for c in stand:
        turned = exp(np.radians(rng.normal(0, off_deg, 3))) @ c.camera_from_world[:3, :3]
        pose = move_camera(c, turned, c.centre_m + rng.normal(0, off_m, 3)).camera_from_world
        lenses[c.name] = Lens(c.name, c.wh, intrinsics, "opencv", np.zeros(5), pose, np.eye(2, 3)), c.wh
    return Rough(seen, [Clock(c.name, fps, len(own_s)) for c in stand], lenses, start_s)
