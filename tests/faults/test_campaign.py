# SPDX-License-Identifier: Apache-2.0
"""Damaged files end in a sentence, in a right result, or in one that says what is missing from it; nothing is silent
that can be known."""

from __future__ import annotations

import json
import mmap
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.keypoints.readers import MAX_PEOPLE_PER_PICTURE, read_keypoints
from studiorecon.scene.names import check_name
from studiorecon.scene.numbered_files import missing_numbers_text, pictures_in
from studiorecon.scene.schema import real
from studiorecon.scene.step_files import read
from studiorecon.scene.user_files import read_npz

from tests.faults import captures
from tests.faults.campaign import Subject, most_held_mb, outcomes, reading, same, verdict, wrong
from tests.faults.rules import HARMLESS, NAMES, Variant
from tests.made.file_contents import npy, npz
from tests.made.nouns import NOUNS
from tests.made.user_files import OPENPOSE, READERS, Reader

EVERY = {**NOUNS, **READERS}
assert len(EVERY) == len(NOUNS) + len(READERS)
# The plain suite takes one damage in so many; the night takes all, and more changed bytes.
SAMPLE, SAMPLED_BYTES, NIGHTLY_BYTES = 7, 10, 2000


@pytest.mark.parametrize("name", EVERY)
def test_a_sample_of_damage(name: str) -> None:
    ended = list(outcomes(EVERY[name], SAMPLED_BYTES, SAMPLE, sum(map(ord, name))))
    assert not [one for one in ended if wrong(name, *one)]
    assert ended


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_every_damage(name: str) -> None:
    assert not [one for one in outcomes(EVERY[name], NIGHTLY_BYTES) if wrong(name, *one)]


@pytest.mark.parametrize("name", NOUNS)
def test_a_whole_file_and_another_one_are_read(name: str, tmp_path: Path) -> None:
    subject = Subject.of_noun(NOUNS[name], tmp_path)
    right = reading(subject)
    assert same(right[0], subject.read(subject.path))
    assert verdict(subject, Variant("", "", subject.whole), right) == "right"
    assert subject.other != subject.whole


@pytest.mark.parametrize("kind", HARMLESS)
@pytest.mark.parametrize("reader", [r for r in READERS.values() if r.text], ids=lambda reader: reader.name)
def test_what_editors_do_to_text_does_no_harm(reader: Reader, kind: str, tmp_path: Path) -> None:
    right = reader.right(reader.written(tmp_path, reader.whole))
    assert same(right, reader.right(reader.written(tmp_path, HARMLESS[kind](reader.whole))))


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
    assert same(one, {"a": np.array([1.0, np.nan]), "b": ["x", 3]})
    for other in ({"a": np.array([1.0, 2.0]), "b": ["x", 3]}, {"a": one["a"], "b": ["y", 3]}, {"a": one["a"]}):
        assert not same(one, other)


def test_a_damaged_file_is_named_with_its_field_and_what_is_expected(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(npz(first=np.zeros((3, 2)), second=np.zeros(4)))
    with pytest.raises(UserError, match=r"a\.npz .*second .*\(4,\).*N = 3.*delete it"):
        read(path, {"first": real("N 2"), "second": real("N")})


VALUES = {
    "no number": ([np.nan, 2, 0.9], "1 of 40 keypoints are not numbers"),
    "infinite score": ([1, 2, np.inf], "1 of 40 keypoints are not numbers"),
    "outside of any picture": ([1e30, 2, 0.9], "1 of 40 keypoints are not numbers or outside of any picture"),
    "score below 0": ([1, 2, -0.5], "1 of 40 scores are below 0"),
    "gap": ([np.nan, np.nan, np.nan], ""),
    "missing": ([0, 0, -1], ""),
}


@pytest.mark.parametrize("case", VALUES)
def test_keypoints_that_are_nowhere_are_left_out_and_counted(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    value, said = VALUES[case]
    points = np.tile([10.0, 20.0, 0.8], (2, 1, 20, 1))
    points[1, 0, 3] = value
    (tmp_path / "k.npz").write_bytes(npz(keypoints=points))
    found = read_keypoints(tmp_path / "k.npz")
    assert said in (out := capsys.readouterr().out)
    assert bool(out) == bool(said)
    assert not found.keypoints[1, 3, 2] > 0
    np.testing.assert_array_equal(np.delete(found.keypoints.reshape(40, 3), 23, 0), np.tile([10, 20, 0.8], (39, 1)))


@pytest.mark.parametrize("kind", [complex, bool, "U4", "M8[s]", [("x", "f4")]], ids=str)
def test_arrays_of_no_real_numbers_are_named_by_their_kind(kind: Any, tmp_path: Path) -> None:
    array = np.zeros((2, 1, 17, 3), kind)
    (tmp_path / "k.npz").write_bytes(npz(keypoints=array))
    with pytest.raises(UserError, match=r"k\.npz: keypoints: the array holds .*; it must hold real numbers"):
        read_keypoints(tmp_path / "k.npz")


def test_keypoints_without_scores_all_count_and_it_is_said(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    people = [[{"keypoints": [[10.0, 20.0]] * 17}], [{"keypoints": [[11.0, 20.0]] * 17}]]
    (tmp_path / "k.json").write_text(json.dumps(people))
    assert (read_keypoints(tmp_path / "k.json").keypoints[..., 2] == 1).all()
    assert "k.json has no scores" in capsys.readouterr().out


@pytest.mark.slow
def test_nothing_that_changes_a_whole_capture_is_silent() -> None:
    wrong_ones = [one for one in captures.outcomes(every=4) if captures.wrong(*one)]
    assert not wrong_ones


def test_a_crowd_beyond_the_limit_is_refused_with_its_frame(tmp_path: Path) -> None:
    people = OPENPOSE["people"][1:] * (MAX_PEOPLE_PER_PICTURE + 1)
    (tmp_path / "cam_0007.json").write_text(json.dumps({"people": people}))
    with pytest.raises(UserError, match=r"frame 7: 501 detections .* at most 500"):
        read_keypoints(tmp_path)


def test_an_array_that_promises_more_than_it_holds_reserves_nothing(tmp_path: Path) -> None:
    whole = npy(np.zeros((4, 4)))
    promised = whole.replace(b"(4, 4)", b"(4, 9999999999)").replace(b" " * 9 + b"\n", b"\n", 1)
    with zipfile.ZipFile(tmp_path / "k.npz", "w") as archive:
        archive.writestr("keypoints.npy", promised)
    with pytest.raises(UserError, match=r"promises|not a readable array"):
        read_npz(tmp_path / "k.npz")


def test_numbered_pictures_come_in_the_order_of_their_numbers_and_gaps_are_named(tmp_path: Path) -> None:
    for number in (*range(12), 14, 15, 20):
        (tmp_path / f"{number}.png").touch()
    found = pictures_in(tmp_path)
    assert [int(p.stem) for p in found] == [*range(12), 14, 15, 20]
    assert missing_numbers_text(found) == "12, 13, 16 and 3 more"
    assert missing_numbers_text(found[:12]) == ""


@pytest.mark.parametrize("name", NAMES)
def test_hostile_names_are_refused(name: str) -> None:
    with pytest.raises(UserError, match="cannot be used"):
        check_name(name, "the scene", "rename it")


@pytest.mark.parametrize("name", ["cam 1", "GX010042", "video (1)", "Küche", "cam_01.left", "カメラ1"])
def test_ordinary_names_are_taken(name: str) -> None:
    assert check_name(name, "the scene", "rename it") == name
