# SPDX-License-Identifier: Apache-2.0
"""Recorded keypoints against the film: what is mixed up is put right or named, and what is right stays as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.keypoints.numbering import numberings

from benchmarks.keypoints import ROWS, outcome, verdict
from tests.made.walkers import Take, take


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
    found = numberings(pictures.astype(np.int64), 48, 30.0, given, False)
    assert (found.possible[0].frame_of[[0, -1]].tolist(), found.certain) == (list(frames), certain)
