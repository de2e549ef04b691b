# SPDX-License-Identifier: Apache-2.0
"""Recorded keypoints against the film: what is mixed up is put right or named, and what is right stays as it is."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.detect import chapters
from studiorecon.detect import keypoints as step
from studiorecon.errors import UserError
from studiorecon.keypoints.layout_choice import choose_layout
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.keypoints.numbering import possible_numberings
from studiorecon.keypoints.unmatched import without_record
from studiorecon.scene.keypoint_verdict import read_keypoint_verdict
from studiorecon.scene.recorded_keypoints import read_recorded

from benchmarks.keypoints import ROWS, outcome, verdict
from tests.defaults import loaded
from tests.made.footage import write_video
from tests.made.walkers import Take, body, take


@pytest.fixture(scope="module")
def takes() -> list[Take]:
    return [take(0, 72), take(1, 72)]


@pytest.mark.parametrize("row", ROWS)
def test_what_is_mixed_up_is_put_right_or_named(takes: list[Take], row: str) -> None:
    own, other = takes
    change, wanted = ROWS[row]
    found = verdict(own, change(own, other), other)
    assert outcome(own, found) == ("refused" if wanted == "refused" else "right"), (found.refusal, found.notes)
    if wanted == "kept":
        assert not found.notes
        np.testing.assert_array_equal(found.recorded.keypoints, own.recorded.keypoints)
    elif row != "frozen":
        assert found.notes or "camera a" in found.refusal
    if row == "of another film":
        return
    if row.startswith("shares"):
        np.testing.assert_allclose(found.recorded.keypoints[..., :2], own.recorded.keypoints[..., :2], atol=1e-6)
    if wanted == "mended" and row not in ("12 frames late", "numbered from 1, last ones missing"):
        assert len(found.recorded.frame) == len(own.recorded.frame)


@pytest.mark.parametrize("stored", [(0.75, 1.0), (45 / 64, 1.0), (0.5, 1.0)], ids=["4:3", "64:45", "2:1"])
def test_keypoints_of_the_stored_picture_of_an_anamorphic_film(takes: list[Take], stored: tuple[float, float]) -> None:
    own = takes[0]
    stored_wh = round(own.wh[0] * stored[0]), own.wh[1]
    points = own.recorded.keypoints.copy()
    points[..., 0] *= stored_wh[0] / own.wh[0]
    given = replace(own.recorded, keypoints=points)
    found = verdict(own, given, takes[1], stored_wh)
    assert not found.refusal
    assert any("as it is stored" in sentence for sentence in found.notes)
    np.testing.assert_allclose(found.recorded.keypoints[..., :2], own.recorded.keypoints[..., :2], atol=0.5)


def test_exchanged_films_are_named(takes: list[Take]) -> None:
    """The keypoints of b lie on what moves in the film of a, and those of a do not."""
    own, other = takes
    found = verdict(own, other.recorded, replace(other, recorded=own.recorded))
    assert "matches the keypoints of camera b" in found.refusal


@pytest.mark.parametrize("seed", range(4))
def test_people_who_stand_still_raise_no_alarm(seed: int) -> None:
    own = take(100 + seed, 60, moving=0.0)
    found = verdict(own, own.recorded, own)
    assert not found.refusal
    assert not found.notes


FILMS_OF_NOTHING = {
    "frozen": lambda pictures, rng: np.repeat(pictures[:1], len(pictures), 0),
    "black": lambda pictures, rng: np.zeros_like(pictures),
    "noise": lambda pictures, rng: rng.integers(0, 256, pictures.shape, dtype=np.uint8),
}


@pytest.mark.parametrize("film", FILMS_OF_NOTHING)
def test_a_film_in_which_nobody_of_the_keypoints_moves_is_named(takes: list[Take], film: str) -> None:
    own = takes[0]
    pictures = FILMS_OF_NOTHING[film](np.array(own.pictures), np.random.default_rng(0))
    found = verdict(own, own.recorded, takes[1])
    assert not found.notes
    found = verdict(replace(own, pictures=list(pictures)), own.recorded, takes[1])
    assert "people move in the keypoints of camera a" in " ".join([*found.notes, found.refusal])


@pytest.mark.parametrize("part", [slice(0, 36), slice(20, 72), slice(8, 64)])
def test_frames_whose_people_are_missing_are_named(takes: list[Take], part: slice) -> None:
    own = takes[0]
    missing = ~np.isin(own.recorded.frame, np.arange(72)[part])
    found = verdict(own, own.recorded.only(~missing), takes[1])
    assert ("have no person in" in " ".join(found.notes)) == (np.unique(own.recorded.frame[missing]).size > 18)


@pytest.mark.parametrize(
    ("recorded", "named"),
    [
        (np.arange(36, 72), "frames 0–35 of its film's 72"),
        (np.arange(40), "frames 40–71 of"),
        (np.r_[0:20, 45:72], "frames 20–44 of"),
        (np.r_[16:20, 36:40, 56:57], "frames 0–15, 20–35, 40–55 and 1 more"),
        (np.r_[0:30, 44:72], ""),
        (np.arange(0, 72, 5), ""),
    ],
)
def test_frames_without_a_record_are_named_where_no_track_bridges_them(recorded: np.ndarray, named: str) -> None:
    messages = " ".join(without_record("a", recorded, 72, 14.5))
    assert (named in messages) if named else not messages


@pytest.mark.parametrize("part", [slice(0, 30), slice(36, 72), slice(20, 50)])
def test_frames_of_another_camera_are_named(takes: list[Take], part: slice) -> None:
    own, other = takes
    theirs = np.isin(other.recorded.frame, np.arange(72)[part])
    kept = ~np.isin(own.recorded.frame, np.arange(72)[part])
    frame, points = (
        np.concatenate([getattr(own.recorded, name)[kept], getattr(other.recorded, name)[theirs]])
        for name in ("frame", "keypoints")
    )
    order = np.argsort(frame, kind="stable")
    found = verdict(own, replace(own.recorded, frame=frame[order], keypoints=points[order]), other)
    ((first, last),) = [map(int, m) for m in re.findall(r"except in frames (\d+)–(\d+)", " ".join(found.notes))]
    assert abs(first - part.start) <= 6
    assert abs(last - part.stop) <= 6


@pytest.mark.parametrize("at", [26, 36, 44])
@pytest.mark.parametrize("lacking", ["keypoints", "film"])
def test_frames_that_one_of_the_two_lacks_are_named_with_their_place(takes: list[Take], lacking: str, at: int) -> None:
    own, seen = takes[0], takes[0].recorded
    if lacking == "film":
        own = replace(own, pictures=own.pictures[:at] + own.pictures[at + 5 :])
    else:
        seen = seen.only((seen.frame < at) | (seen.frame >= at + 5))
        seen = replace(seen, pictures=seen.pictures[:-5], frame=seen.frame - 5 * (seen.frame > at))
    (sentence,) = verdict(own, seen, takes[1]).notes
    place, count = map(int, re.findall(r"from about frame (\d+) .* about (\d) frames there", sentence)[0])
    assert f"{lacking} lack" in sentence
    assert abs(place - at) <= 6
    assert abs(count - 5) <= 1


def test_an_empty_room_is_no_fault(takes: list[Take]) -> None:
    own = takes[0]
    nobody = own.recorded.only(np.zeros(len(own.recorded.frame), bool))
    found = verdict(own, nobody, own)
    assert not found.refusal
    assert not len(found.recorded.frame)


PICTURES = np.arange(48)


@pytest.mark.parametrize(
    ("pictures", "given", "frames", "certain"),
    [
        (PICTURES, None, (0, 47), True),
        (PICTURES + 1, None, (0, 47), True),
        (PICTURES[:40] + 1, None, (1, 40), False),
        (PICTURES[:40] + 9, None, (8, 47), False),
        (PICTURES[8:] + 1, None, (8, 47), False),
        (PICTURES[8:] + 1, 1, (8, 47), True),
        (PICTURES + 1, 0, (1, 48), True),
        (np.round(PICTURES * 1000 / 30), None, (0, 47), True),
        (np.round(PICTURES[:40:2] * 1000 / 30), None, (0, 38), True),
        (np.round(PICTURES[:40] * 1e6 / 30) + 1714557600 * 10**6, None, (0, 39), True),
        (np.round(PICTURES[4:] * 1e9 / 30) + 1714557600 * 10**9, 1714557600 * 10**9, (4, 47), True),
        (np.arange(100), None, (0, 99), False),
    ],
)
def test_numbers_are_read_as_the_film_s_length_has_it(
    pictures: np.ndarray, given: int | None, frames: tuple[int, int], certain: bool
) -> None:
    found = possible_numberings(pictures.astype(np.int64), 48, 30.0, given, False)
    assert (found.possible[0].frame_of[[0, -1]].tolist(), found.certain) == (list(frames), certain)


@pytest.mark.parametrize("given", ["auto", "body_25", "body_25b"])
def test_a_given_layout_that_limbs_contradict_is_named(given: str) -> None:
    at = dict(zip(LAYOUTS["coco17"].keypoints, body(100, 200, 150, 0.3)))
    person = [[*at[name], 0.9] if name in at else [0, 0, 0] for name in LAYOUTS["body_25"].keypoints]
    chosen, sentence = choose_layout(np.array([person]), given, "k.json")
    assert chosen == ("body_25" if given == "auto" else given)
    assert bool(sentence) == (given != "body_25")


def people_of(own: Take, first: int, stop: int) -> np.ndarray:
    """(T, P, 17, 3) what the frames ``first`` to ``stop`` - 1 of a take show."""
    seen = own.recorded
    most = np.bincount(seen.frame, minlength=stop).max()
    found = np.zeros((stop - first, most, *seen.keypoints.shape[1:]))
    for t in range(first, stop):
        now = seen.keypoints[seen.frame == t]
        found[t - first, : len(now)] = now
    return found


def read_from_files(folder: Path, film: Path, people: list[np.ndarray]) -> tuple[str, np.ndarray, np.ndarray]:
    """Refusal, frames and keypoints of a film's keypoints, one file of them for each of its chapters."""
    files = [folder / f"{k}.npz" for k in range(len(people))]
    for path, keypoints in zip(files, people):
        np.savez(path, keypoints=keypoints)
    written = [folder / name for name in ("seen.npz", "recorded.npz", "a.json")]
    step.run(loaded(step.Settings), "a", files, "coco17", "auto", film, 30.0, "[]", *written, [], [])
    recorded = read_recorded(written[1])
    return read_keypoint_verdict(written[2]).refusal, recorded.frame, recorded.keypoints


@pytest.fixture(scope="module")
def long_take(tmp_path_factory: pytest.TempPathFactory) -> tuple[Take, Path]:
    """A film of several groups of pictures."""
    own = take(3, 360, 1, (160, 90))
    return own, write_video(tmp_path_factory.mktemp("long") / "a.mp4", np.array(own.pictures))


@pytest.mark.parametrize("change", ["as they are", "mirrored", "20 frames late"])
def test_a_long_film_is_compared_in_frames_that_are_sought(
    change: str, long_take: tuple[Take, Path], tmp_path: Path
) -> None:
    own, film = long_take
    people = people_of(own, 0, len(own.pictures))
    if change == "mirrored":
        people[..., 0] = np.where(people[..., 2] > 0, own.wh[0] - people[..., 0], 0)
    if change == "20 frames late":
        people = np.concatenate([people[:20], people[:-20]])
    refusal, frame, keypoints = read_from_files(tmp_path, film, [people])
    assert ("mirrored" in refusal) == (change == "mirrored")
    if not refusal:
        right = own.recorded.keypoints[own.recorded.frame == 300][0]
        np.testing.assert_allclose(keypoints[np.flatnonzero(frame == 300)[0]], right, atol=1e-6)


def test_people_before_frames_are_named_and_read_once_exchanged(takes: list[Take], tmp_path: Path) -> None:
    own = takes[0]
    film = write_video(tmp_path / "a.mp4", np.array(own.pictures))
    people = people_of(own, 0, len(own.pictures))
    with pytest.raises(UserError, match="exchange the first two axes"):
        read_from_files(tmp_path, film, [people.transpose(1, 0, 2, 3)])
    assert len(read_from_files(tmp_path, film, [people])[1]) == len(own.recorded.frame)


@pytest.mark.parametrize("exchanged", [False, True])
def test_chapters_are_compared_as_one_film(exchanged: bool, takes: list[Take], tmp_path: Path) -> None:
    own, cut = takes[0], 30
    parts = [
        write_video(tmp_path / f"{k}.mp4", np.array(own.pictures[part]))
        for k, part in enumerate((slice(cut), slice(cut, None)))
    ]
    chapters.run("a", parts, tmp_path / "a.ffconcat")
    people = [people_of(own, 0, cut), people_of(own, cut, len(own.pictures))]
    order = -1 if exchanged else 1
    refusal, frame, _ = read_from_files(tmp_path, tmp_path / "a.ffconcat", people[::order])
    messages = refusal + " ".join(read_keypoint_verdict(tmp_path / "a.json").notes)
    assert bool(messages) == exchanged
    if not exchanged:
        with pytest.raises(UserError, match="different numbers of keypoints"):
            read_from_files(tmp_path, tmp_path / "a.ffconcat", [people[0], people[1][:, :, :16]])
    assert exchanged or set(frame.tolist()) == set(own.recorded.frame.tolist())
