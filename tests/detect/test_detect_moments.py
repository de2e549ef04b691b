# SPDX-License-Identifier: Apache-2.0
"""People are looked for in some moments first, in the same ones by every camera's clock, and in every frame once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.clocks import moments as choose
from studiorecon.detect import moments, people
from studiorecon.detector.film_detection import FilmDetector
from studiorecon.footage.frames import decode
from studiorecon.footage.source import open_source
from studiorecon.scene.clocks import Clock, Clocks
from studiorecon.scene.moments import read_moments, unseen
from studiorecon.scene.raw_detections import read_raw_detections

from tests.made.footage import smooth_pictures, write_video

FRAMES, FPS = 750, 30


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_video(tmp_path_factory.mktemp("film") / "a.mp4", smooth_pictures(FRAMES, (48, 32)), FPS)


@dataclass
class Networks:
    """Stands for the detector's files: nothing is opened."""

    def detector(self) -> Any:
        return type("Network", (), {"placer": type("Placer", (), {"title": "made"})()})()

    def worth(self) -> dict[str, list[float]]:
        return {}


def test_a_stretch_deep_in_a_film_shows_the_frames_that_decoding_all_of_it_shows(film: Path) -> None:
    source = open_source(film, 30.0)
    whole = list(decode(source, 0, 0))
    for first, count in ((601, 40), (700, 50), (610, 1)):
        np.testing.assert_array_equal(list(decode(source, first, count)), whole[first : first + count])


@pytest.mark.parametrize("shown", [1.0, 0.25], ids=["always somebody", "a quarter of the time"])
def test_every_frame_is_looked_at_once_and_what_is_known_is_kept(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shown: float
) -> None:
    searched: list[int] = []

    def rows(self: FilmDetector, pictures: Iterable[np.ndarray], begin: int) -> list[tuple]:
        frames = list(range(begin, begin + len(list(pictures))))
        searched.extend(frames)
        return [
            (
                t,
                np.full((33, 3), len(searched) / 1000),
                0.9,
                np.zeros((33, 3)),
                np.zeros((2, 2), np.uint8),
                np.zeros((2, 3)),
            )
            for t in frames
            if t % 4 < 4 * shown
        ]

    monkeypatch.setattr(FilmDetector, "rows", rows)
    monkeypatch.setattr(FilmDetector, "turned", lambda self, _: self)
    first, known, found = tmp_path / "moments.json", tmp_path / "known.npz", tmp_path / "found.npz"
    settings = choose.Settings(sync="never")
    choose.run(settings, ["a", "b"], [film, film], "{}", 0, 0, 0, tmp_path / "lags.json", first)
    assert sum(count for _, _, count in read_moments(first, "a")) > 0.9 * FRAMES, "all of it, where nobody is seen"
    moments.run("a", film, first, 30.0, Networks(), known)  # type: ignore[arg-type]
    few = len(searched)
    assert (few < FRAMES / 2) == (shown == 1.0), "more where fewer frames show somebody"
    people.run("a", film, known, [], 30.0, Networks(), found)  # type: ignore[arg-type]
    assert len(searched) < FRAMES + 40, "beside the frames before and after each stretch none twice"
    before, after = read_raw_detections(known), read_raw_detections(found)
    assert after.frame.tolist() == [t for t in range(FRAMES) if t % 4 < 4 * shown]
    kept = np.isin(after.frame, before.frame)
    np.testing.assert_array_equal(after.keypoints[kept], before.keypoints)
    assert not unseen(after.looked, 0, FRAMES)


def test_a_short_film_is_looked_at_at_once(tmp_path: Path) -> None:
    film = write_video(tmp_path / "a.mp4", smooth_pictures(40, (48, 32)), 10)
    choose.run(choose.Settings(sync="never"), ["a"], [film], "{}", 0, 0, 0, tmp_path / "lags.json", tmp_path / "m.json")
    assert read_moments(tmp_path / "m.json", "a") == [(0, 0, 40)]


def test_cameras_that_began_apart_are_looked_at_at_the_same_moments() -> None:
    """A lag by sound is sure; one by motion may be wrong, and then both readings are looked at."""
    filmed = tuple(Clock(name, fps, round(600 * fps)) for name, fps in (("a", 30.0), ("b", 25.0)))
    late = (filmed[0], Clock("b", 25.0, 15000, offset_s=12.0))
    sure, unsure = (Clocks(30.0, 12.0, 17000, clocks) for clocks in (late, filmed))
    chosen = choose.stretches([sure], 1.5)
    for (_, a, a_count), (_, b, b_count) in zip(chosen["a"], chosen["b"], strict=True):
        assert abs(a / 30 - (12 + b / 25)) < 0.05
        assert abs(a_count / 30 - b_count / 25) < 0.1
    begins_s = np.sort([first / 30 for _, first, _ in chosen["a"][:5]])
    assert np.diff(begins_s).min() > 30, "the first few are spread over the take"
    both = choose.stretches([sure, unsure], 1.5)
    assert {first for _, first, _ in both["b"]} > {first for _, first, _ in chosen["b"]}
    assert both["a"] == chosen["a"]


def test_clocks_that_people_must_give_take_one_long_stretch_in_the_middle() -> None:
    filmed = tuple(Clock(name, 10.0, 268) for name in ("a", "b"))
    chosen = choose.stretches([Clocks(10.0, 0.0, 268, filmed)], 15.0)
    assert chosen["a"] == chosen["b"]
    assert chosen["a"][0][2] == 150
    assert 40 < chosen["a"][0][1] < 90
    assert {count for _, _, count in chosen["a"][1:]} == {15}
    looked = [(first, count) for number, first, count in chosen["a"] if number < 3]
    assert sum(count for _, count in unseen(looked, 0, 268)) > 268 / 4


def test_parts_not_yet_looked_at() -> None:
    assert unseen([(10, 5), (2, 3)], 0, 20) == [(0, 2), (5, 5), (15, 5)]
    assert unseen([(0, 30)], 5, 10) == []
    assert unseen([], 5, 10) == [(5, 10)]
    assert unseen([(0, 6), (12, 9)], 5, 10) == [(6, 6)]
