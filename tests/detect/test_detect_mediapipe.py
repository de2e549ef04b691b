# SPDX-License-Identifier: Apache-2.0
"""What MediaPipe's interfaces return, kept as JSON: planted landmarks come back in pixels, and what is none is told."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.keypoints.layout_choice import choose_layout
from studiorecon.keypoints.readers import read_keypoints

WH = (640, 360)


def person(seed: int) -> list[dict[str, float]]:
    rng = np.random.default_rng(seed)
    return [{"x": x, "y": y, "z": -0.1, "visibility": v} for x, y, v in rng.uniform(0.1, 0.9, (33, 3)).tolist()]


def in_pixels(landmarks: list[dict[str, float]]) -> np.ndarray:
    """The middle of the left upper pixel is (0, 0), as detectors count."""
    return np.array([[one["x"] * WH[0] - 0.5, one["y"] * WH[1] - 0.5, one["visibility"]] for one in landmarks])


def written(folder: Path, content: Any) -> Path:
    path = folder / "cam1.json"
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    "content",
    [
        [{"landmarks": [person(0), person(1)], "worldLandmarks": []}, {"landmarks": []}, {"landmarks": [person(2)]}],
        [{"pose_landmarks": [person(0), person(1)]}, {"pose_landmarks": []}, {"pose_landmarks": [person(2)]}],
        {
            "frames": [
                {"frame": 2, "pose_landmarks": [person(2)]},
                {"frame": 0, "pose_landmarks": [person(0), person(1)]},
            ]
        },
        [{"poseLandmarks": [person(0), person(1)]}, {"poseLandmarks": None}, {"poseLandmarks": [person(2)]}],
    ],
    ids=["javascript", "tasks", "numbered", "protobuf"],
)
def test_landmarks_come_back_in_pixels(tmp_path: Path, content: Any) -> None:
    found = read_keypoints(written(tmp_path, content), WH)
    assert found.program == "MediaPipe"
    assert found.frame.tolist() == [0, 0, 2]
    for own, seed in zip(found.keypoints, (0, 1, 2), strict=True):
        np.testing.assert_allclose(own, in_pixels(person(seed)), atol=1e-9)
    assert choose_layout(found.keypoints, "auto", "cam1.json")[0] == "blazepose33"


def test_one_person_of_the_older_solutions(tmp_path: Path) -> None:
    content = [{"pose_landmarks": {"landmark": person(3)}}, {"pose_landmarks": None}, {"pose_landmarks": person(4)}]
    found = read_keypoints(written(tmp_path, content), WH)
    assert (found.pictures.tolist(), found.frame.tolist()) == ([0, 1, 2], [0, 2])
    np.testing.assert_allclose(found.keypoints[1], in_pixels(person(4)), atol=1e-9)
