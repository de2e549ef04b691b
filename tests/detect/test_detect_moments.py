# SPDX-License-Identifier: Apache-2.0
"""People are looked for in some moments first, in the same ones by every camera's clock, and in every frame once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from studiorecon.clocks import moments as choose
from studiorecon.clocks.posterior import Source
from studiorecon.detect import people
from studiorecon.detector.film_detection import FilmDetector
from studiorecon.detector.network_files import DetectorFiles
from studiorecon.footage.frames import decode
from studiorecon.footage.source import open_source
from studiorecon.scene.clocks import Clock, Clocks
from studiorecon.scene.raw_detections import read_raw_detections, unseen

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
            if t % 40 < 40 * shown
        ]

    monkeypatch.setattr(FilmDetector, "rows", rows)
    monkeypatch.setattr(FilmDetector, "turned", lambda self, _: self)
    known, found, files = tmp_path / "known.npz", tmp_path / "found.npz", cast("DetectorFiles", Networks())
    take = choose.Take(["a", "b"], [film, film])
    choose.run(choose.Settings(sync="never"), take, 0, tmp_path / "lags.json", ["a"], files, [known])
    few = len(searched)
    assert (few < FRAMES / 3) == (shown == 1.0), "more where fewer moments show somebody"
    people.run("a", film, [known], [], 30.0, files, found)
    assert len(searched) < FRAMES + 40, "beside the frames before and after each stretch none twice"
    before, after = read_raw_detections(known), read_raw_detections(found)
    assert after.frame.tolist() == [t for t in range(FRAMES) if t % 40 < 40 * shown]
    kept = np.isin(after.frame, before.frame)
    np.testing.assert_array_equal(after.keypoints[kept], before.keypoints)
    assert not unseen(after.looked, 0, FRAMES)


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


class Shown:
    """Stands for ``Search`` of a film: notes the stretches, and shows nobody but in ``moments`` of it."""

    def __init__(self, camera: str, moments: int, looked: Sequence[tuple[int, int]] = ()) -> None:
        self.camera, self.moments, self.looked = camera, moments, looked
        self.found = SimpleNamespace(frame=np.zeros(moments), looked=looked)

    def beyond(self, parts: Sequence[tuple[int, int]]) -> Shown:
        """The same after the stretches ``parts`` are searched too."""
        new = [one for part in parts for one in unseen(self.looked, *part)]
        return Shown(self.camera, self.moments, [*self.looked, *new])

    def shows_few(self) -> bool:
        return sum(count for _, count in self.looked) < self.moments

    def tracked(self) -> float:
        """Seconds that were searched about the middle."""
        return sum(count for first, count in self.looked if 205 <= first < 420) / 10


@pytest.mark.parametrize(
    ("needed_s", "motion_tells", "seconds"),
    [(0.0, False, 8), (9.0, False, 13), (9.0, True, 8), (99.0, False, 23)],
    ids=["at once", "of more", "and motion", "of nothing"],
)
def test_more_is_searched_while_offsets_are_unknown(
    monkeypatch: pytest.MonkeyPatch, needed_s: float, motion_tells: bool, seconds: float
) -> None:
    """Five seconds in the middle and two stretches of 1.5 s; then motion; then the middle is doubled up to 20 s."""
    filmed, compared = tuple(Clock(name, 10.0, 600) for name in ("a", "b")), list[int]()
    link = choose.Lag(Source("made"), 0, 1, 0.0, 0.01, 0.01)
    films: dict[str, Any] = {"a": Shown("a", 1), "b": Shown("b", 1)}

    def lags(seen: Sequence[float], *_: Any) -> tuple[list[choose.Lag], dict[int, str]]:
        return [link] if min(seen) >= needed_s else [], {}

    def searched(shown: dict[str, Shown], parts: dict[str, list[tuple[int, int]]]) -> dict[str, Shown]:
        return {camera: one.beyond(parts[camera]) for camera, one in shown.items()}

    def motion(*_: Any) -> choose.Evidence:
        compared.append(1)
        return choose.Evidence([link] if motion_tells else [], {"motion": {}})

    monkeypatch.setattr(choose, "people_lags", lags)
    monkeypatch.setattr(choose, "search_on", searched)
    monkeypatch.setattr(choose.OffsetSearch, "with_motion", motion)
    search = choose.OffsetSearch(choose.Take(["a", "b"], []), [], [], filmed, uses_people=True, first_s=5.0)
    done, _ = search.run(films, choose.Evidence([], {}))
    assert sum(count for _, count in done[0].found.looked) == 10 * seconds
    assert done[0].found.looked == done[1].found.looked
    assert len(compared) == (needed_s > 5)


def test_parts_not_yet_looked_at() -> None:
    assert unseen([(10, 5), (2, 3)], 0, 20) == [(0, 2), (5, 5), (15, 5)]
    assert unseen([(0, 30)], 5, 10) == []
    assert unseen([], 5, 10) == [(5, 10)]
    assert unseen([(0, 6), (12, 9)], 5, 10) == [(6, 6)]
