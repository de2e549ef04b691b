# SPDX-License-Identifier: Apache-2.0
"""People tell the time by a calibration that the user brings: sharper, also those who walk evenly, and never wrongly by
one that is off."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from studiorecon.clocks.calibrated_lag import CalibratedPair
from studiorecon.clocks.people_clock import people_pair
from studiorecon.geometry.bundle import move_camera
from studiorecon.geometry.rotations import exp
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.clocks import Clock
from studiorecon.scene.people import Detections

from tests.made.cameras import detect, ring, walk

CAMERAS = ring(3)
LATE_S = 0.4


def evenly(seconds: float, fps: float) -> np.ndarray:
    """Somebody who walks 1.2 m/s along a line, arms and legs swinging."""
    frames = round(seconds * fps)
    t = np.arange(frames) / fps
    still = walk(np.zeros(3), np.zeros(3), 1)[0]
    swing = 0.15 * np.sin(2 * np.pi * 0.9 * t)[:, None] * np.repeat([0, 0.5, 1, 0, 0.5, 1], 2) * np.tile([1, -1], 6)
    along = np.array([0.6, 0.8, 0.0])
    path = (1.2 * (t - seconds / 2))[:, None] * along
    return still[None] + swing[..., None] * along + path[:, None]


def filmed(fps: float, noise_px: float = 3.0, seed: int = 0) -> tuple[list[Detections], list[Clock]]:
    """Three seconds of it by three cameras, of which the last is started ``LATE_S`` later."""
    cut = round(LATE_S * fps)
    seen = detect(CAMERAS, [evenly(3.0, fps)], noise_px, np.random.default_rng(seed))
    frames = round(3.0 * fps)
    late = seen[2].only(seen[2].frame >= cut)
    seen[2] = Detections(late.camera, late.layout, late.frame - cut, late.track, late.keypoints)
    return seen, [Clock(c.name, fps, frames - (cut if k == 2 else 0)) for k, c in enumerate(CAMERAS)]


def lenses(cameras: Sequence[Camera]) -> dict[str, tuple[Lens, tuple[int, int]]]:
    return {
        c.name: (Lens(c.name, c.wh, c.intrinsics, "opencv", np.zeros(8), c.camera_from_world, np.eye(2, 3)), c.wh)
        for c in cameras
    }


@pytest.mark.parametrize("fps", [10.0, 30.0])
@pytest.mark.parametrize("seed", range(2))
def test_who_walks_evenly_tells_the_time_by_a_calibration(fps: float, seed: int) -> None:
    seen, clocks = filmed(fps, seed=seed)
    free = {(p.first, p.second): p for p in people_pair(seen, clocks, fps)[0]}
    pairs, reasons = people_pair(seen, clocks, fps, lenses(CAMERAS))
    assert {c for p in pairs for c in (p.first, p.second)} == {0, 1, 2}
    assert not reasons
    assert len(free) < len(pairs), "without one, an even walk is as good at many lags"
    for pair in pairs:
        true = LATE_S if pair.second == 2 else 0.0
        assert abs(pair.offset_s - true) < 0.02, (pair, true)
        assert pair.sigma_s < 0.15, "what a calibration that is 3 cm off would be taken for is counted in"


@pytest.mark.parametrize(("degrees", "metres"), [(0.3, 0.03), (1.0, 0.1), (3.0, 0.3)])
def test_a_calibration_that_is_off_says_less_or_nothing_but_nothing_wrong(degrees: float, metres: float) -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        off = []
        for c in CAMERAS:
            axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
            turned = exp(np.radians(degrees) * axis) @ c.camera_from_world[:3, :3]
            off.append(move_camera(c, turned, c.centre_m + metres * way))
        seen, clocks = filmed(30.0, seed=seed)
        for pair in people_pair(seen, clocks, 30.0, lenses(off))[0]:
            true = LATE_S if pair.second == 2 else 0.0
            assert abs(pair.offset_s - true) < 3 * pair.sigma_s, (seed, pair)


def test_gaps_between_rays_are_metres() -> None:
    """Rays to one point meet; those to two points 5 cm apart along the normal of both miss by that."""
    first, second = CAMERAS[:2]
    pair = CalibratedPair(second.camera_from_world @ np.linalg.inv(first.camera_from_world))
    point = np.array([0.1, 0.2, 1.0])
    one, two = point - first.centre_m, point - second.centre_m
    normal = np.cross(one, two) / np.linalg.norm(np.cross(one, two))

    def ray(camera: Camera, at: np.ndarray) -> np.ndarray:
        inside = camera.camera_from_world[:3, :3] @ at + camera.camera_from_world[:3, 3]
        return (inside / inside[2])[None, None]

    assert pair.gaps_m(ray(first, point), ray(second, point), 0)[0, 0] == pytest.approx(0.0, abs=1e-9)
    apart = pair.gaps_m(ray(first, point), ray(second, point + 0.05 * normal), 0)[0, 0]
    assert abs(apart) == pytest.approx(0.05, rel=0.02)
    assert np.isnan(pair.gaps_m(ray(first, point), ray(second, point), 1)).all()
