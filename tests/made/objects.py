# SPDX-License-Identifier: Apache-2.0
"""What tests of objects and their neighbours share."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from studiorecon.scene.camera import Camera

from tests.made.cameras import look_at

WH, FRAMES, FPS = (240, 136), 24, 15.0


RADIUS_M = 0.12


@dataclass(frozen=True)
class Ball:
    """A ball of two colours along ``path_m`` (T, 3)."""

    path_m: np.ndarray
    radius_m: float = RADIUS_M
    colours: tuple[tuple[float, float, float], tuple[float, float, float]] = ((0.8, 0.15, 0.1), (0.9, 0.85, 0.2))


def around(name: str, azimuth_deg: float) -> Camera:
    a = np.radians(azimuth_deg)
    return look_at(name, np.array([2.8 * np.cos(a), 2.8 * np.sin(a), 1.6]), np.array([0, 0, 0.9]), WH, 180.0)


CAMERAS = [around(f"c{i}", azimuth) for i, azimuth in enumerate((5, 95, 185, 275))]


UNSEEN = around("between", 50)


def bouncing(frames: int = FRAMES, y_m: float = 0.1) -> np.ndarray:
    """(T, 3) of a ball that crosses the room in two bounces."""
    phase = (np.arange(frames) / 11 + 0.3) % 1
    return np.stack(
        [np.linspace(-0.7, 0.7, frames), np.full(frames, y_m), RADIUS_M + 1.2 * 4 * phase * (1 - phase)], axis=1
    )


def plate_of(camera: Camera) -> np.ndarray:
    """(H, W, 3) a smooth wall, another in each camera."""
    rng = np.random.default_rng(int(camera.name.encode().hex(), 16) % 1000)
    return cv2.resize(rng.uniform(0.3, 0.6, (6, 8, 3)).astype(np.float32), WH, interpolation=cv2.INTER_CUBIC)


def about(camera: Camera, ball: Ball, frame: int) -> tuple[slice, slice]:
    """Rows and columns of the picture that the ball can be in."""
    (middle_px,), (depth_m,) = camera.project(ball.path_m[frame][None])
    reach_px = 2 + 1.5 * max(camera.focal_px) * ball.radius_m / max(depth_m - ball.radius_m, 0.05)
    low, high = (np.clip(middle_px + sign * reach_px, 0, camera.wh).astype(int) for sign in (-1, 1))
    return slice(low[1], high[1] + 1), slice(low[0], high[0] + 1)


def drawn(camera: Camera, balls: list[Ball], frame: int, seed: int = 0) -> np.ndarray:
    """(H, W, 3) uint8 picture with the balls, four rays a pixel, and noise of one grey level."""
    fine = camera.resized((2 * WH[0], 2 * WH[1]))
    picture = cv2.resize(plate_of(camera), fine.wh, interpolation=cv2.INTER_NEAREST)
    origin = fine.centre_m
    for ball in sorted(balls, key=lambda b: -np.linalg.norm(b.path_m[frame] - origin)):
        part = about(fine, ball, frame)
        centres = fine.pixel_centres()[part]
        rays = fine.unproject(centres, np.ones(centres.shape[:2])) - origin
        unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        away = ball.path_m[frame] - origin
        along = unit @ away
        gap = ball.radius_m**2 - (away @ away - along**2)
        hit = gap > 0
        point = origin + (along - np.sqrt(np.maximum(gap, 0)))[..., None] * unit - ball.path_m[frame]
        colours = np.where(point[..., 2:] > 0, *np.float32(ball.colours))
        picture[part] = np.where(hit[..., None], colours, picture[part])
    small = cv2.resize(picture.astype(np.float32), WH, interpolation=cv2.INTER_AREA) * 255
    noise = np.random.default_rng([seed, frame, CAMERAS.index(camera) if camera in CAMERAS else 9]).normal(
        0, 1, small.shape
    )
    return np.clip(np.rint(small + noise), 0, 255).astype(np.uint8)


def nobody(camera: Camera, frame: int) -> np.ndarray:
    return np.zeros(camera.hw, bool)
