# SPDX-License-Identifier: Apache-2.0
"""Damaged files end in a sentence, in a right result, or in one that says what is missing from it; nothing is silent
that can be known."""

from __future__ import annotations

import mmap
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.camera_files.raw_camera import RawCamera, check_camera, check_focal_px
from studiorecon.errors import UserError
from studiorecon.plan.discovery import open_dataset
from studiorecon.scene.capture_yaml import read_description
from studiorecon.scene.names import check_name
from studiorecon.scene.schema import real
from studiorecon.scene.step_files import read

from tests.faults import captures
from tests.faults.campaign import Subject, differing, most_held_mb, outcomes, reading, verdict, wrong
from tests.faults.rules import HARMLESS, NAMES, Variant
from tests.made.file_contents import npz
from tests.made.nouns import NOUNS
from tests.made.user_files import READERS, Reader

EVERY = {**NOUNS, **READERS}
assert len(EVERY) == len(NOUNS) + len(READERS)
# The plain suite takes one damage in so many; the night takes all, and more changed bytes.
SAMPLE, SAMPLED_BYTES, NIGHTLY_BYTES = 7, 10, 2000


@pytest.mark.parametrize("name", EVERY)
def test_a_sample_of_damage(name: str) -> None:
    ended = list(outcomes(name, EVERY[name], SAMPLED_BYTES, SAMPLE, sum(map(ord, name))))
    assert not [one for one in ended if wrong(one[2])]
    assert ended


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_every_damage(name: str) -> None:
    assert not [one for one in outcomes(name, EVERY[name], NIGHTLY_BYTES) if wrong(one[2])]


@pytest.mark.parametrize("name", NOUNS)
def test_a_whole_file_and_another_one_are_read(name: str, tmp_path: Path) -> None:
    subject = Subject.of_noun(name, NOUNS[name], tmp_path)
    right = reading(subject)
    assert not differing(right[0], subject.read(subject.path))
    assert verdict(subject, Variant("", "", subject.whole), right) == "right"
    assert subject.other != subject.whole


@pytest.mark.parametrize("kind", HARMLESS)
@pytest.mark.parametrize("reader", [r for r in READERS.values() if r.text], ids=lambda reader: reader.name)
def test_what_editors_do_to_text_does_no_harm(reader: Reader, kind: str, tmp_path: Path) -> None:
    right = reader.right(reader.written(tmp_path, reader.whole))
    assert not differing(right, reader.right(reader.written(tmp_path, HARMLESS[kind](reader.whole))))


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="only Linux tells")
def test_memory_that_is_held_for_a_moment_is_seen() -> None:
    before = most_held_mb(anew=True)
    with mmap.mmap(-1, 160_000_000) as memory:  # np.ones would be given a hole that earlier tests left in the heap
        for page in range(0, len(memory), mmap.PAGESIZE):
            memory[page] = 1
    assert most_held_mb() - before > 140
    assert most_held_mb(anew=True) - before < 60


def test_two_readings_that_differ_are_told_apart() -> None:
    one = {"a": np.array([1.0, np.nan]), "b": ["x", 3]}
    assert not differing(one, {"a": np.array([1.0, np.nan]), "b": ["x", 3]})
    for other in ({"a": np.array([1.0, 2.0]), "b": ["x", 3]}, {"a": one["a"], "b": ["y", 3]}, {"a": one["a"]}):
        assert differing(one, other)


def test_a_damaged_file_is_named_with_its_field_and_what_is_expected(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(npz(first=np.zeros((3, 2)), second=np.zeros(4)))
    with pytest.raises(UserError, match=r"a\.npz .*second .*\(4,\).*N = 3.*delete it"):
        read(path, {"first": real("N 2"), "second": real("N")})


@pytest.mark.slow
@pytest.mark.timeout(3600)  # three minutes of the processor, which others may want too
def test_nothing_that_changes_a_whole_capture_is_silent() -> None:
    wrong_ones = [one for one in captures.outcomes(every=4) if captures.wrong(*one)]
    assert not wrong_ones


@pytest.mark.parametrize(
    ("brought", "sentence"),
    [
        ({"videos/.cam3.mp4.icloud": b"bplist00"}, "cam3.mp4 from iCloud"),
        ({"capture.yaml": b"frames:\n\tfirst: 2\n"}, "line 2: a tab; indent with blanks"),
        ({"capture.yaml": b"starts: {cam1: 0,5}\n"}, "5 has no value; write a number with a point"),
        ({"capture.yaml": b"starts: {cam1: 3, CAM1: 4}\n"}, "starts has camera cam1 twice"),
        ({"capture.yml": b"people: 2\n", "Capture.yaml": b"people: 0\n"}, r"Capture\.yaml and capture\.yml; keep one"),
        ({"capture.yaml": b"people: " + b"9" * 5000}, r"Exceeds the limit .* digits\)$"),
        ({"videos/manifest.mp4": b"x"}, "has the name of a table of results"),
    ],
)
def test_what_clouds_and_editors_do_to_a_capture_is_named(
    brought: dict[str, bytes], sentence: str, tmp_path: Path
) -> None:
    (tmp_path / "videos").mkdir()
    for name, content in {"videos/cam1.mp4": b"a", "videos/cam2.mp4": b"bc", **brought}.items():
        (tmp_path / name).write_bytes(content)
    with pytest.raises(UserError, match=sentence):
        open_dataset(tmp_path)


def test_the_suffix_that_an_editor_adds_is_no_hindrance(tmp_path: Path) -> None:
    (tmp_path / "capture.yaml.txt").write_text("people: 0\n")
    assert read_description(tmp_path, None) == {"people": 0}


def test_a_focal_length_of_no_lens_is_refused_and_one_within_the_named_range_is_taken() -> None:
    with pytest.raises(UserError, match=r"900000; for pictures of 1920×1080 it must be from 172\.8 to 192000 pixels"):
        check_focal_px({"a": 900_000.0}, {"a": (1920, 1080), "b": (1920, 1080)})
    assert check_focal_px({"a": 900.0}, {"a": (1920, 1080)}) == {"a": 900.0}


def test_focal_lengths_that_no_square_pixels_have_are_named() -> None:
    lens = RawCamera("a", (1920, 1080), np.diag([2000.0, 1000.0, 1.0]), "opencv", np.zeros(8), np.eye(4))
    centred = replace(lens, intrinsics=lens.intrinsics + np.array([[0, 0, 960], [0, 0, 540], [0, 0, 0]]))
    (note,) = check_camera("a", centred, "a.toml")[1]
    assert "fx 2000 and fy 1000 mean pixels 2 times as high as wide" in note


def test_packed_films_are_named(tmp_path: Path) -> None:
    (tmp_path / "videos.zip").write_bytes(b"PK")
    with pytest.raises(UserError, match=r"videos\.zip is packed: unpack it"):
        open_dataset(tmp_path)


@pytest.mark.parametrize("name", NAMES)
def test_hostile_names_are_refused(name: str) -> None:
    with pytest.raises(UserError, match="cannot be used"):
        check_name(name, "the scene", "rename it")


@pytest.mark.parametrize(
    "name",
    ["cam 1", "GX010042", "video (1)", "Küche", "cam_01.left", "カメラ1", "cam" * 19, "0" * 19 + "1", "ab" * 25 + "x"],
)
def test_ordinary_names_are_taken(name: str) -> None:
    assert check_name(name, "the scene", "rename it") == name
