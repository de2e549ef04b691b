# SPDX-License-Identifier: Apache-2.0
"""Every value of capture.yaml is what it must be, or refused in a sentence that leads to one that is taken."""

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


# What is wrong, words of the sentence, and what the sentence asks for instead.
BROKEN = {
    "a leading zero": ("frames: {first: 010}", "plain decimal", "frames: {first: 10}"),
    "sexagesimal": ("starts: {'02': 12:30}", "plain decimal", "starts: {'02': 750}"),
    "quoted number": ("focal_px: '1200'", "plain decimal", "focal_px: 1200"),
    "underscores": ("focal_px: 1_200", "plain decimal", "focal_px: 1200"),
    "one frame": ("frames: {count: 1}", "at least 2", "frames: {count: 2}"),
    "below zero": ("frames: {first: -3}", "from 0 to", "frames: {first: 0}"),
    "key twice": ("people: 1\npeople: 0", "twice", "people: 1"),
    "key in two spellings": ("starts: {02: 1, '02': 3}", "twice", "starts: {02: 3}"),
    "misspelt key": ("heldout: [no]", "did you mean held_out", "held_out: [no]"),
    "capital key": ("Focal_px: 900", "did you mean focal_px", "focal_px: 900"),
    "no such camera": ("starts: {03: 13}", "01, 02, no", "starts: {02: 13}"),
    "zero left out": ("starts: {2: 13}", "leading zeros", "starts: {02: 13}"),
    "truth of YAML 1.1": ("people: off", "0 for an empty room", "people: 0"),
    "offset beyond any picture": (
        "pixel_maps: {01: {scale: 1, offset: [90000, 0]}}",
        "at most 16384",
        "pixel_maps: {01: {scale: 1, offset: [9, 0]}}",
    ),
    "scale beyond any picture": (
        "pixel_maps: {01: {scale: 400, offset: [0, 0]}}",
        "0.05 to 20",
        "pixel_maps: {01: {scale: 4, offset: [0, 0]}}",
    ),
    "three offsets": (
        "pixel_maps: {01: {scale: 1, offset: [0, 0, 0]}}",
        "must have the form",
        "pixel_maps: {01: {scale: 0.99, offset: [0.0, 7.2]}}",
    ),
    "height in centimetres": ("height_m: 178", "metres, 0.5 to 2.8", "height_m: 1.78"),
    "height not finite": ("height_m: .nan", "metres", "height_m: 1.78"),
    "distance to itself": ("distance_m: [01, 01, 3]", "two cameras", "distance_m: [01, 02, 3]"),
    "focal length in millimetres": ("focal_px: 24", "not millimetres", "focal_px: 1200"),
    "no such layout": ("keypoint_layout: coco-17", "did you mean coco17", "keypoint_layout: coco17"),
    "no such calibration": ("calibration: a.toml", "does not exist", "people: 1"),
    "no such folder": ("keypoints: here", "not a folder", "people: 1"),
    "no mapping": ("frames: 5", "must have the form", "frames: {first: 5}"),
    "a word for a number": ("starts: {02: early}", "such as 13 or 12.6", "starts: {02: 13}"),
    "a number for all starts": ("starts: 13", "must have the form", "starts: {02: 13}"),
    "no YAML": (": : :", "not valid YAML", "people: 1"),
    "identities of nobody": ("identities: here.tsv", "here.tsv is missing", "people: 1"),
    "nobody to train on": ("held_out: [01, 02]", "at least 2", "held_out: [01]"),
    "chapters of no film": ("chapters: {x: [videos/03.mp4]}", "not in", "chapters: {x: [videos/02.mp4]}"),
}


@pytest.mark.parametrize(("text", "words", "mended"), BROKEN.values(), ids=BROKEN)
def test_a_mistake_is_mended_by_what_the_sentence_asks(folder: Path, text: str, words: str, mended: str) -> None:
    file = folder / "capture.yaml"
    file.write_text(text + "\n")
    with pytest.raises(UserError) as refused:
        open_dataset(folder)
    assert words in str(refused.value)
    file.write_text(mended + "\n")
    open_dataset(folder)


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
