# SPDX-License-Identifier: Apache-2.0
"""Between which pictures a keypoint is moved depends on the time between them, not on how many were left out."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.keypoints.resampling import resample_keypoints
from studiorecon.scene.clocks import Clock, Clocks
from studiorecon.scene.people import Detections

SPEED_PX_S, LATE = 240.0, 0.4


@pytest.mark.parametrize(
    ("fps", "missing", "joined"),
    [(120.0, 5, True), (120.0, 15, False), (30.0, 1, True), (30.0, 4, False), (10.0, 0, True), (10.0, 1, False)],
)
def test_a_gap_is_bridged_by_its_length_in_seconds(fps: float, missing: int, joined: bool) -> None:
    """Somebody who walks evenly, in pictures that come 0.4 frames late; some are missing after number 10."""
    there = np.array([k for k in range(40) if not 10 < k <= 10 + missing])
    times_s = (there + LATE) / fps
    points = np.zeros((len(there), 17, 3))
    points[..., 0], points[..., 1], points[..., 2] = SPEED_PX_S * times_s[:, None] + np.arange(17), 50.0, 0.9
    seen = Detections("a", "coco17", there, np.zeros(len(there), int), points)
    clocks = Clocks(fps, 3 / fps, 30, (Clock("a", fps, 40, offset_s=LATE / fps),))
    moved = resample_keypoints(seen, clocks, 100)
    # The last picture before the gap is asked for at a moment within it, or the first after it.
    wanted = SPEED_PX_S * (moved.frame + 3) / fps
    off = np.abs(moved.keypoints[:, 0, 0] - wanted)
    beside = np.isin(moved.frame + 3, [10, 11 + missing])
    assert off[~beside].max() < 1e-6
    assert (off[beside].max() < 1e-6) == joined
