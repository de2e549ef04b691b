# SPDX-License-Identifier: Apache-2.0
"""Hands: those that recorded keypoints bring."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.keypoints.hands import with_recorded_hands
from studiorecon.keypoints.layout_choice import choose_layout
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.keypoints.readers import read_keypoints
from studiorecon.keypoints.resampling import correct_rolling_shutter
from studiorecon.scene.people import Detections, read_detections, write_detections

RNG = np.random.default_rng(0)


def points(count: int) -> np.ndarray:
    return RNG.uniform(5, 90, (count, 3)) * [1, 1, 0.01]


def seen(layout: str, frames: int = 4) -> Detections:
    keypoints = np.array([points(len(LAYOUTS[layout].keypoints)) for _ in range(frames)])
    return Detections("cam1", layout, np.arange(frames), np.zeros(frames, int), keypoints)


BODY, LEFT, RIGHT = points(25), points(21), points(21)
NONE = np.zeros((21, 3))


@pytest.mark.parametrize(
    ("written", "left", "right"),
    [
        ({"hand_left_keypoints_2d": LEFT, "hand_right_keypoints_2d": RIGHT}, LEFT, RIGHT),
        ({"hand_left_keypoints_2d": [], "hand_right_keypoints_2d": RIGHT}, NONE, RIGHT),
        ({"hand_left_keypoints_2d": None, "hand_right_keypoints_2d": RIGHT}, NONE, RIGHT),
        ({"hand_left_keypoints": LEFT, "hand_right_keypoints": RIGHT}, LEFT, RIGHT),
    ],
)
def test_openpose_hands_follow_the_body(tmp_path: Path, written: dict[str, Any], left: Any, right: Any):
    person = {"pose_keypoints_2d": BODY} | written
    flat = {k: v.reshape(-1).tolist() if isinstance(v, np.ndarray) else v for k, v in person.items()}
    bare = {"pose_keypoints_2d": flat["pose_keypoints_2d"], "hand_left_keypoints_2d": [], "hand_right_keypoints_2d": []}
    (tmp_path / "film_000000000000_keypoints.json").write_text(json.dumps({"people": [flat, bare]}))
    found = read_keypoints(tmp_path).keypoints
    np.testing.assert_allclose(found[0], np.concatenate([BODY, left, right]))
    np.testing.assert_allclose(found[1], np.concatenate([BODY, NONE, NONE]))
    assert choose_layout(found, "body_25", "cam1")[0] == "body_25_hands"


def test_half_a_hand_is_refused(tmp_path: Path):
    person = {"pose_keypoints_2d": BODY.reshape(-1).tolist(), "hand_left_keypoints_2d": LEFT[:7].reshape(-1).tolist()}
    (tmp_path / "film_000000000000_keypoints.json").write_text(json.dumps({"people": [person]}))
    with pytest.raises(UserError, match="7 keypoints"):
        read_keypoints(tmp_path)


@pytest.mark.parametrize("layout", ["body_25_hands", "wholebody133", "halpe136", "body_135"])
def test_recorded_hands_are_read_by_side(layout: str, tmp_path: Path):
    given = seen(layout)
    found = with_recorded_hands(given)
    assert found.hands is not None
    names = LAYOUTS[layout].keypoints
    for side, word in enumerate(("left", "right")):
        tip = [k for k, name in enumerate(names) if name.startswith(f"{word}_hand_")][-1]
        np.testing.assert_allclose(found.hands[:, side, 20], given.keypoints[:, tip], rtol=1e-6)
    if layout == "body_135":
        wrist = given.keypoints[:, names.index("left_wrist")]
        np.testing.assert_allclose(found.hands[:, 0, 0], wrist, rtol=1e-6)
    write_detections(tmp_path / "cam1.npz", found)
    back = read_detections(tmp_path / "cam1.npz").hands
    assert back is not None
    assert back.dtype == np.float32
    np.testing.assert_array_equal(back, found.hands)


def test_no_hands_where_none_is_recorded():
    assert with_recorded_hands(seen("body_25")).hands is None
    whole = seen("wholebody133")
    whole.keypoints[:, 91:] = [np.nan, np.nan, 0]
    assert with_recorded_hands(whole).hands is None


def test_a_rolling_shutter_moves_hands_with_the_body():
    given = with_recorded_hands(seen("wholebody133", 8))
    step = 3.0 * np.arange(8)[:, None, None]
    given = replace(given, keypoints=given.keypoints[:1].repeat(8, 0) + [1, 0, 0] * step)
    given = with_recorded_hands(given)
    moved = correct_rolling_shutter(given, 0.02, 100, 30)
    assert moved.hands is not None
    assert given.hands is not None
    assert np.abs(moved.hands[2:6] - given.hands[2:6]).max() > 0.1
    np.testing.assert_allclose(moved.hands[:, 0, 5], moved.keypoints[:, 91 + 5], atol=1e-4)
