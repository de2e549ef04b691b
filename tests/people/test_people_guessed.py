# SPDX-License-Identifier: Apache-2.0
"""The detector's metric guess: places in the other one of two cameras, and left and right where cameras disagree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.detector.blazepose import LAYOUT
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.people.expected_keypoints import agreement, plan_second_look, swap_left_right
from studiorecon.people.monocular_guess import guess_in_world, is_left_right_swapped, project_guess, right_to_left
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

from tests.made.cameras import arc, ring

NAMES = LAYOUTS[LAYOUT].keypoints
FRAMES, FPS, SIZE = 20, 20.0, 1.15
_HEIGHTS_M = {"hip": 0.95, "knee": 0.5, "ankle": 0.1, "heel": 0.03, "toe": 0.02, "shoulder": 1.45, "elbow": 1.15}
_HEIGHTS_M |= {"wrist": 0.95, "finger": 0.85, "thumb": 0.87}


def somebody(turn_rad: float) -> np.ndarray:
    """(33, 3) landmarks of somebody at the origin who faces x, turned: tall by ``SIZE``."""
    rng = np.random.default_rng(0)
    body = np.array(
        [
            [
                0.14 if "toe" in n else 0.05 * rng.standard_normal(),
                {"left": 0.2, "right": -0.2}.get(n.split("_")[0], 0.0) * (0.3 if "eye" in n or "mouth" in n else 1.0),
                next((z for part, z in _HEIGHTS_M.items() if part in n), 1.62),
            ]
            for n in NAMES
        ]
    )
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    return SIZE * body @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T


def seen(camera: Camera, frames: range, noise_px: float = 2.0, noise_m: float = 0.03) -> Detections:
    """One track of somebody who turns slowly, with the guess of somebody of usual size."""
    rng = np.random.default_rng([7, int(camera.name[1:])])
    keypoints, guess = [], []
    for t in frames:
        points = somebody(0.02 * t)
        pixels = camera.project(points)[0] + rng.normal(0, noise_px, (33, 2))
        keypoints.append(np.concatenate([pixels, np.full((33, 1), 0.9)], axis=1))
        hips = points[[NAMES.index("left_hip"), NAMES.index("right_hip")]].mean(0)
        own = (points - hips) @ camera.camera_from_world[:3, :3].T / SIZE
        guess.append(own + rng.normal(0, noise_m, own.shape))
    return Detections(
        camera.name, LAYOUT, np.array(frames), np.zeros(len(frames), int), np.array(keypoints), points_m=np.array(guess)
    )


def with_sides_exchanged(found: Detections, which: np.ndarray) -> Detections:
    """Landmarks and guess as a network has them that takes front for back."""
    keypoints, guess = found.keypoints.copy(), np.array(found.points_m)
    keypoints[which], guess[which] = swap_left_right(LAYOUT, keypoints[which]), swap_left_right(LAYOUT, guess[which])
    return replace(found, keypoints=keypoints, points_m=guess)


def test_a_guess_lies_on_its_landmarks_and_left_is_left() -> None:
    for camera in ring():
        found = seen(camera, range(FRAMES))
        points = guess_in_world(found, camera)
        pixels, depth = camera.project(points)
        assert np.abs(pixels - found.keypoints[..., :2]).max() < 60
        assert np.median(np.linalg.norm(pixels - found.keypoints[..., :2], axis=-1)) < 15
        # Somebody who is taller than usual seems as much nearer.
        assert np.median(depth) == pytest.approx(4.0 / SIZE, rel=0.06)
        truth = np.array([[-np.sin(0.02 * t), np.cos(0.02 * t), 0] for t in range(FRAMES)])
        assert ((right_to_left(found, camera) * truth).sum(1) > 0.9).all()


def test_of_two_cameras_one_knows_where_somebody_is_whom_the_other_missed() -> None:
    cameras = arc(80)
    missed = [t for t in range(FRAMES) if not 8 <= t < 12]
    pair = [seen(cameras[0], range(FRAMES)), seen(cameras[1], range(FRAMES)).only(np.array(missed))]
    who = {(c.name, 0): "p0" for c in cameras}
    expected = project_guess("p0", 1, cameras, pair, who, FRAMES)
    whole = seen(cameras[1], range(FRAMES))
    shares = [agreement(whole.keypoints[t], expected.pixels[t], expected.near_share) for t in range(FRAMES)]
    assert min(shares) > 0.8
    plan = plan_second_look(pair[1], [expected], who, FRAMES)
    assert [look for look in plan.searches if look[2] < 0] == [(t, 0, -1) for t in range(8, 12)]
    assert not plan.drop.any()


def test_of_two_cameras_that_disagree_the_one_that_contradicts_itself_is_put_right() -> None:
    cameras = arc(80)
    wrong = np.isin(np.arange(FRAMES), [9, 10])
    pair = [with_sides_exchanged(seen(cameras[0], range(FRAMES)), wrong), seen(cameras[1], range(FRAMES))]
    who = {(c.name, 0): "p0" for c in cameras}
    for view, expected in ((0, wrong), (1, np.zeros(FRAMES, bool))):
        other = project_guess("p0", view, cameras, pair, who, FRAMES)
        plan = plan_second_look(pair[view], [other], who, FRAMES)
        assert (plan.swap_sides == wrong).all(), "each takes the other for wrong"
        itself = is_left_right_swapped(pair[view], cameras[view], ["p0"] * FRAMES, FPS)
        assert (plan.swap_sides & itself == expected).all()


def test_without_a_guess_nothing_is_known() -> None:
    cameras = arc(80)
    pair = [replace(seen(c, range(FRAMES)), points_m=None) for c in cameras]
    who = {(c.name, 0): "p0" for c in cameras}
    assert np.isnan(project_guess("p0", 0, cameras, pair, who, FRAMES).pixels).all()
    assert not is_left_right_swapped(pair[0], cameras[0], ["p0"] * FRAMES, FPS).any()
    apart = [seen(cameras[0], range(10)), seen(cameras[1], range(10, FRAMES))]
    assert np.isnan(project_guess("p0", 0, cameras, apart, who, FRAMES).pixels).all(), "nothing tells the person's size"
