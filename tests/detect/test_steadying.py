# SPDX-License-Identifier: Apache-2.0
"""A detector's tremble is taken out, and no motion with it."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.keypoints.temporal_smoothing import smooth_keypoints
from studiorecon.scene.people import Detections


def of(path: np.ndarray, frame: np.ndarray | None = None, confidence: float = 0.9) -> Detections:
    """One track whose 17 keypoints all go along ``path`` (N, 2)."""
    keypoints = np.concatenate([np.repeat(path[:, None], 17, 1), np.full((len(path), 17, 1), confidence)], axis=-1)
    frame = np.arange(len(path)) if frame is None else frame
    return Detections("a", "coco17", frame, np.zeros(len(path), int), keypoints)


def test_tremble_goes_and_an_even_walk_stays_where_it_is() -> None:
    """At 60 per second less than two thirds of the tremble stay; the walk is not moved, nor at its ends."""
    rng, t = np.random.default_rng(0), np.arange(120)
    walk = np.stack([300 + 4.0 * t, 200 - 1.5 * t], axis=-1)
    np.testing.assert_allclose(smooth_keypoints(of(walk), 60.0).keypoints, of(walk).keypoints, atol=1e-9)
    noisy = of(walk)
    noisy.keypoints[..., :2] += rng.normal(0, 3.0, noisy.keypoints[..., :2].shape)
    left = smooth_keypoints(noisy, 60.0).keypoints[..., :2] - walk[:, None]
    assert left.std() < 0.65 * 3.0
    assert np.abs(left.mean()) < 0.2


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
def test_a_limb_that_swings_three_times_a_second_keeps_its_swing(fps: float) -> None:
    t = np.arange(round(2 * fps)) / fps
    swing = np.stack([100 + 50 * np.sin(2 * np.pi * 3 * t), 80 + 0 * t], axis=-1)
    found = smooth_keypoints(of(swing), fps).keypoints[10:-10, 0, 0] - 100
    assert 1 - np.abs(found).max() / np.abs(swing[10:-10, 0] - 100).max() < 0.06


def test_few_pictures_a_second_and_single_moments_stay_as_they_are() -> None:
    rng = np.random.default_rng(1)
    path = rng.normal(200, 30, (20, 2))
    assert smooth_keypoints(of(path), 10.0).keypoints is not None
    np.testing.assert_array_equal(smooth_keypoints(of(path), 10.0).keypoints, of(path).keypoints)
    apart = of(path, np.arange(20) * 9)
    np.testing.assert_allclose(smooth_keypoints(apart, 60.0).keypoints, apart.keypoints, atol=1e-9)


def test_what_is_missing_stays_missing_and_pulls_nobody() -> None:
    t = np.arange(40)
    seen = of(np.stack([300 + 4.0 * t, 200.0 + 0 * t], axis=-1))
    seen.keypoints[20, 3] = [np.nan, np.nan, 0.0]
    found = smooth_keypoints(seen, 60.0).keypoints
    assert np.isnan(found[20, 3, :2]).all()
    assert found[20, 3, 2] == 0
    np.testing.assert_allclose(found[[19, 21], 3, 0], seen.keypoints[[19, 21], 3, 0], atol=1e-9)


def test_two_tracks_are_steadied_apart() -> None:
    t = np.arange(30)
    one, other = of(np.stack([100 + t, 50 + 0 * t], -1)), of(np.stack([400 - 2 * t, 90 + 0 * t], -1))
    both = Detections(
        "a",
        "coco17",
        np.concatenate([one.frame, other.frame]),
        np.repeat([0, 1], 30),
        np.concatenate([one.keypoints, other.keypoints]),
    )
    np.testing.assert_allclose(smooth_keypoints(both, 60.0).keypoints, both.keypoints, atol=1e-9)
