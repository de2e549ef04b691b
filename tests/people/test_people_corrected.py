# SPDX-License-Identifier: Apache-2.0
"""Corrected identities are taken as they stand, and mistakes in them are named."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.people.associate import _lines_of
from studiorecon.people.association.rejected_people import RejectedPerson, report_rejected
from studiorecon.people.corrected_identities import people_table_rows, read_corrected_identities
from studiorecon.scene.people import Detections, read_identities, split_tracks, write_identities


def detections(camera: str, frames_of_tracks: dict[int, list[int]]) -> Detections:
    frame = np.array([f for frames in frames_of_tracks.values() for f in frames])
    track = np.array([t for t, frames in frames_of_tracks.items() for _ in frames])
    return Detections(camera, "coco17", frame, track, np.zeros((len(frame), 17, 3)))


FOUND = [detections("a", {0: [0, 1, 2], 1: [5, 6]}), detections("b", {0: [1, 2, 3], 4: [0]}), detections("c", {2: [0]})]


def write(folder: Path, *lines: tuple[str, int | str, str]) -> Path:
    path = folder / "identities.tsv"
    path.write_text("camera\ttrack\tperson\n" + "".join(f"{c}\t{t}\t{p}\n" for c, t, p in lines))
    return path


def test_corrections_are_taken_and_what_is_left_out_belongs_to_nobody(tmp_path: Path) -> None:
    table = read_corrected_identities(
        write(tmp_path, ("a", 0, "p1"), ("b", 0, "p1"), ("a", 1, "p0"), ("c", 2, "p0"), ("b", 4, "")), FOUND
    )
    assert table == {("a", 0): "p1", ("a", 1): "p0", ("b", 0): "p1", ("b", 4): "", ("c", 2): "p0"}
    assert people_table_rows(table, FOUND) == [("p0", 3, "a,c", 1.0, "corrected"), ("p1", 4, "a,b", 1.0, "corrected")]
    short = read_corrected_identities(write(tmp_path, ("a", 0, "p0"), ("b", 0, "p0")), FOUND)
    assert {key for key, person in short.items() if not person} == {("a", 1), ("b", 4), ("c", 2)}


def test_a_cut_track_is_two_people(tmp_path: Path) -> None:
    lines = [("a", 0, "p0"), ("a", "0@1", "p1"), ("a", "0@2", ""), ("b", "0", "p0"), ("b", "0@3", "p1"), ("b", 4, "p1")]
    table = read_corrected_identities(write(tmp_path, *lines), FOUND)
    cut = [split_tracks(found, table) for found in FOUND]
    who = {
        (found.camera, int(frame)): table[found.camera, int(track)]
        for found in cut
        for frame, track in zip(found.frame, found.track)
    }
    assert {(c, f): p for (c, f), p in who.items() if p} == {
        ("a", 0): "p0", ("a", 1): "p1", ("b", 0): "p1", ("b", 1): "p0", ("b", 2): "p0", ("b", 3): "p1",
    }  # fmt: skip
    assert split_tracks(FOUND[2], table) is FOUND[2]
    assert people_table_rows(table, cut) == [("p0", 3, "a,b", 1.0, "corrected"), ("p1", 3, "a,b", 1.0, "corrected")]
    written = tmp_path / "written.tsv"
    write_identities(written, table)
    assert read_identities(written) == table
    assert "a\t0@1\tp1" in written.read_text()
    # One person's lines cut a track that others share.
    lines_of_p0 = _lines_of("p0", table)
    alone = split_tracks(FOUND[0], lines_of_p0)
    assert [lines_of_p0.get(("a", int(t))) for t in alone.track] == ["p0", "p1", "", None, None]
    for track in ("0@", "@1", "0@-1", "0@1@2", "0@9"):
        with pytest.raises(UserError, match="track"):
            read_corrected_identities(write(tmp_path, ("a", track, "p0"), ("b", 0, "p0")), FOUND)


B = ("b", 0, "p0")


@pytest.mark.parametrize(
    ("lines", "words", "mended"),
    [
        ([("a", 7, "p0"), B], "track 7 of camera a, .*start from people/identities.tsv", [("a", 1, "p0"), B]),
        ([("d", 0, "p0"), B], "track 0 of camera d", [("c", 2, "p0"), B]),
        ([("a", 0, "Anna"), B], "'Anna'; people are called p0", [("a", 0, "p0"), B]),
        ([("a", 0, "Anna"), B], "empty = no person", [("a", 0, ""), ("a", 1, "p0"), B]),
        ([("a", 0, "p0")], "gives p0 tracks of camera a only; .*two cameras", [("a", 0, "p0"), B]),
    ],
)
def test_lines_changed_as_advised_make_a_person(
    tmp_path: Path, lines: list[tuple[str, int, str]], words: str, mended: list[tuple[str, int, str]]
) -> None:
    with pytest.raises(UserError, match=words):
        read_corrected_identities(write(tmp_path, *lines), FOUND)
    rows = people_table_rows(read_corrected_identities(write(tmp_path, *mended), FOUND), FOUND)
    assert [row[0] for row in rows] == ["p0"]


def test_the_lines_of_a_warning_accept_the_person_and_join_two_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    missed = RejectedPerson("r0", 3, 0.1, ("a", "b"), (("a", 0), ("b", 0)), 0.5, -1.0, "too short")
    report_rejected([missed], "p1")
    lines = re.findall(r"([a-d])\t(\d+)\t(p\d+)", capsys.readouterr().out)
    identities = {("a", 0): "", ("a", 1): "p0", ("b", 0): "", ("b", 4): "", ("c", 2): "p0"}
    reported = identities | {(camera, int(track)): person for camera, track, person in lines}
    rows = people_table_rows(
        read_corrected_identities(write(tmp_path, *((*key, who) for key, who in reported.items())), FOUND), FOUND
    )
    assert [(row[0], row[2]) for row in rows] == [("p0", "a,c"), ("p1", "a,b")]
    joined = write(tmp_path, *((*key, who and "p0") for key, who in reported.items()))
    assert [row[2] for row in people_table_rows(read_corrected_identities(joined, FOUND), FOUND)] == ["a,b,c"]
