# SPDX-License-Identifier: Apache-2.0
"""DeepLabCut's and MediaPipe's tables: planted keypoints, written in another order and under other names, come back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studiorecon.keypoints.deeplabcut import canonical_name
from studiorecon.keypoints.layout_choice import choose_layout
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.keypoints.readers import read_keypoints
from studiorecon.plan.discovery import open_dataset

# MediaPipe's PoseLandmark, in its order.
MEDIAPIPE = [
    "NOSE", "LEFT_EYE_INNER", "LEFT_EYE", "LEFT_EYE_OUTER", "RIGHT_EYE_INNER", "RIGHT_EYE", "RIGHT_EYE_OUTER",
    "LEFT_EAR", "RIGHT_EAR", "MOUTH_LEFT", "MOUTH_RIGHT", "LEFT_SHOULDER", "RIGHT_SHOULDER", "LEFT_ELBOW",
    "RIGHT_ELBOW", "LEFT_WRIST", "RIGHT_WRIST", "LEFT_PINKY", "RIGHT_PINKY", "LEFT_INDEX", "RIGHT_INDEX",
    "LEFT_THUMB", "RIGHT_THUMB", "LEFT_HIP", "RIGHT_HIP", "LEFT_KNEE", "RIGHT_KNEE", "LEFT_ANKLE", "RIGHT_ANKLE",
    "LEFT_HEEL", "RIGHT_HEEL", "LEFT_FOOT_INDEX", "RIGHT_FOOT_INDEX",
]  # fmt: skip


def write(path: Path, parts: list[str], keypoints: np.ndarray, individuals: bool = False) -> Path:
    """``keypoints`` (T, P, K, 3) as pandas writes DeepLabCut's table; NaN is an empty cell."""
    people = [f"person{p}" for p in range(keypoints.shape[1])]
    columns = [(who, part, c) for who in people for part in parts for c in ("x", "y", "likelihood")]
    lines = [["scorer", *("net" for _ in columns)]]
    lines += [["individuals", *(c[0] for c in columns)]] if individuals else []
    lines += [["bodyparts", *(c[1] for c in columns)], ["coords", *(c[2] for c in columns)]]
    for t, row in enumerate(keypoints.reshape(len(keypoints), -1)):
        lines.append([str(t), *("" if np.isnan(v) else f"{v:.17g}" for v in row)])
    path.write_text("\n".join(",".join(line) for line in lines) + "\n")
    return path


def planted(frames: int, people: int, count: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.concatenate(
        [rng.uniform(10, 900, (frames, people, count, 2)), rng.uniform(0.3, 1, (frames, people, count, 1))], axis=-1
    )


def test_mediapipe_s_names_are_ours() -> None:
    assert tuple(canonical_name(name) for name in MEDIAPIPE) == LAYOUTS["blazepose33"].keypoints


@pytest.mark.parametrize(
    ("theirs", "ours"),
    [
        ("RBigToe", "right_big_toe"),
        ("LShoulder", "left_shoulder"),
        ("shoulder_left", "left_shoulder"),
        ("Nose", "nose"),
        ("left ankle", "left_ankle"),
        ("rightKnee", "right_knee"),
        ("R_Hip", "right_hip"),
        ("Neck", "neck"),
    ],
)
def test_names_of_other_programs(theirs: str, ours: str) -> None:
    assert canonical_name(theirs) == ours


def test_mediapipe_s_table_comes_back(tmp_path: Path) -> None:
    given = planted(4, 1, 33)
    found = read_keypoints(write(tmp_path / "camDLC.csv", MEDIAPIPE, given))
    assert found.program == "DeepLabCut"
    assert found.frame.tolist() == [0, 1, 2, 3]
    np.testing.assert_array_equal(found.keypoints, given[:, 0])
    assert choose_layout(given[:, 0], "auto", "x")[0] == "blazepose33"


def test_several_people_in_any_order_of_parts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = list(LAYOUTS["coco17"].keypoints)
    order = np.random.default_rng(1).permutation(17)
    given = planted(3, 2, 17)
    given[1, 1] = np.nan  # the second person is not seen in frame 1
    written = np.concatenate([given[:, :, order], given[:, :, :1]], 2)
    path = write(tmp_path / "k.csv", [names[k] for k in order] + ["tail"], written, True)
    found = read_keypoints(path)
    assert found.frame.tolist() == [0, 0, 1, 2, 2]
    np.testing.assert_array_equal(found.keypoints, given[[0, 0, 1, 2, 2], [0, 1, 0, 0, 1]])
    assert "tail are not in the layout coco17" in capsys.readouterr().out + capsys.readouterr().err


def test_deeplabcut_s_own_file_names_are_found(tmp_path: Path) -> None:
    for name in ("videos/a.mp4", "videos/b.mp4", "keypoints/aDLC_resnet50_x.csv", "keypoints/aDLC_resnet50_x.h5"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert {c: p.name for c, p in open_dataset(tmp_path).keypoints.items()} == {"a": "aDLC_resnet50_x.csv"}
