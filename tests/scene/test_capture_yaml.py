# SPDX-License-Identifier: Apache-2.0
"""Values of capture.yaml are what they must be, and keys without effect are named."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from studiorecon.errors import UserError
from studiorecon.plan.discovery import open_dataset


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "videos").mkdir()
    for number, name in enumerate(("01", "02", "no")):
        (tmp_path / "videos" / f"{name}.mp4").write_bytes(bytes(number + 1))
    return tmp_path


def test_names_are_read_as_they_are_written(folder: Path) -> None:
    (folder / "capture.yaml").write_text(
        "held_out: [no]\nstarts: {02: 1e1, NO: -3}\nkeypoint_first_frame: 1716900000000\n"
    )
    found = open_dataset(folder)
    assert found.held_out == ("no",)
    assert found.starts == {"01": 0.0, "02": 10.0, "no": -3.0}
    assert set(found.keypoint_first_frame.values()) == {1716900000000}


@pytest.mark.parametrize(
    ("text", "idle"),
    [
        ("focal_px: 900", True),
        ("height_m: 1.8", True),
        ("keypoint_layout: coco17", True),
        ("keypoint_first_frame: 1", True),
        ("frames: {first: 1}", False),
    ],
)
def test_a_key_without_effect_is_named(folder: Path, text: str, idle: bool) -> None:
    (folder / "poses_bounds.npy").write_bytes(b"")
    (folder / "capture.yaml").write_text(text + "\n")
    assert [text.partition(":")[0] in note for note in open_dataset(folder).notes] == [True] * idle


@pytest.mark.parametrize(
    "name", ["videos/02.mp4", "keypoints/01.json", "plates/01.png", "capture.yaml", "identities.tsv"]
)
@pytest.mark.parametrize("kind", ["dangling", "looping"])
def test_a_link_to_nowhere_is_named(folder: Path, name: str, kind: str) -> None:
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    path.symlink_to(path if kind == "looping" else "nowhere")
    with pytest.raises(UserError, match=path.name):
        open_dataset(folder)
    path.unlink()
    open_dataset(folder)


def test_a_pipe_in_a_film_s_place_is_named(folder: Path) -> None:
    os.mkfifo(folder / "videos/03.mp4")
    with pytest.raises(UserError, match="no regular file"):
        open_dataset(folder)
