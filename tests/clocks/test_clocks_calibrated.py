# SPDX-License-Identifier: Apache-2.0
"""People tell the time by a calibration that the user brings, also those who walk evenly, and never wrongly by one that
is off: cameras that were moved by a degree since still agree on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from studiorecon.clocks import offsets
from studiorecon.clocks.people import people_lags
from studiorecon.clocks.posterior import Offset, estimate_offsets
from studiorecon.clocks.timeline import Timeline
from studiorecon.geometry.camera_motion import move_camera
from studiorecon.geometry.rotations import exp
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.clocks import Clock
from studiorecon.scene.people import Detections

from tests.made.cameras import detect, ring, walk
from tests.made.silent import Rough, rough

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
    lags, reasons = people_lags(seen, clocks, fps, lenses(CAMERAS))
    found = estimate_offsets(lags, 3, 0)
    assert not reasons
    for offset, true in zip(found[1:], (0.0, LATE_S)):
        assert abs(offset.seconds - true) < min(0.05, offset.half_s), (offset, true)
        assert offset.half_s < 0.15, "what a calibration that is off would be taken for is counted in"


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
        found = estimate_offsets(people_lags(seen, clocks, 30.0, lenses(off))[0], 3, 0)
        for offset, true in zip(found[1:], (0.0, LATE_S)):
            assert abs(offset.seconds - true) < 1.5 * offset.half_s, (seed, offset)


def errors_s(found: Sequence[Offset], take: Rough) -> np.ndarray:
    """By how much the cameras are off against the first."""
    return np.array([o.seconds for o in found]) - (take.start_s - take.start_s[0])


def together(take: Rough) -> list[Offset]:
    lags, _ = people_lags(take.seen, take.clocks, take.clocks[0].fps, take.lenses)
    return estimate_offsets(lags, len(take.clocks), 0)


@pytest.mark.parametrize(("fps", "cameras", "seed"), [(30.0, 3, 3), (15.0, 5, 2), (60.0, 4, 3)])
def test_clocks_come_out_though_every_camera_stands_elsewhere(fps: float, cameras: int, seed: int) -> None:
    take = rough(seed, cameras, fps)
    assert np.ptp(take.start_s) > 0.1
    found = together(take)
    half_s = np.array([o.half_s for o in found])
    assert np.abs(errors_s(found, take)).max() < 0.02
    assert (np.abs(errors_s(found, take)) <= half_s).all()
    assert half_s.max() < 0.05


def test_people_who_stand_still_tell_nothing() -> None:
    take = rough(1)
    still = [replace(d, keypoints=d.keypoints[:1].repeat(len(d.frame), axis=0)) for d in take.seen]
    assert min(o.half_s for o in together(replace(take, seen=still))[1:]) > 0.15


def test_a_camera_of_another_take_is_not_told_and_does_not_shift_the_others() -> None:
    take, other = rough(1, 5), rough(7, 5)
    found = together(replace(take, seen=[*take.seen[:4], other.seen[4]]))
    assert found[4].half_s > 0.15
    assert np.abs(errors_s(found, take)[:4]).max() < 0.025


def test_the_step_uses_people_under_the_calibration() -> None:
    take = rough(2)
    names = [clock.camera for clock in take.clocks]
    lines = [Timeline(30.0, 120, 0.0)] * 4
    verdicts, reported, reference = offsets.estimate_clocks(names, lines, [], {}, take.seen, take.lenses)
    off_s = np.array([v.offset_s for v in verdicts]) - (take.start_s - take.start_s[reference])
    assert np.abs(off_s).max() < 0.02
    assert all("people" in f["sentence"] for c, f in enumerate(reported) if c != reference)
