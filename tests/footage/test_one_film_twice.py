# SPDX-License-Identifier: Apache-2.0
"""One film under two cameras' names: copied, linked, encoded again, cut."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.clocks import offsets
from studiorecon.errors import UserError
from studiorecon.footage.duplicate_films import compare_views, same_view, static_image
from studiorecon.footage.frames import decode
from studiorecon.footage.source import open_source
from studiorecon.footage.video import write_watchable
from studiorecon.plan.discovery import open_dataset
from studiorecon.scene.clocks import read_clocks

FRAMES = 40


def room(seed: int) -> np.ndarray:
    """A textured wall (120, 160, 3) uint8."""
    rough = np.random.default_rng(seed).integers(0, 255, (24, 32, 3), dtype=np.uint8)
    return cv2.resize(rough, (160, 120), interpolation=cv2.INTER_CUBIC)


def film(path: Path, seed: int, first: int = 0, crf: int = 18) -> Path:
    """Somebody, a grey block, walks before the wall; from frame ``first`` on."""
    pictures = []
    for t in range(first, FRAMES):
        picture = room(seed).copy()
        picture[40:110, 10 + 3 * t : 30 + 3 * t] = 90
        pictures.append(picture)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_watchable(path, pictures, 30.0, crf)
    return path


@pytest.mark.parametrize("how", ["copy", "link", "symlink"])
def test_copies_and_links_stop_before_anything_runs(tmp_path: Path, how: str) -> None:
    one, other = film(tmp_path / "videos/a.mp4", 0), tmp_path / "videos/b.mp4"
    film(tmp_path / "videos/c.mp4", 1)
    {"copy": shutil.copy, "link": lambda a, b: b.hardlink_to(a), "symlink": lambda a, b: b.symlink_to(a)}[how](
        one, other
    )
    with pytest.raises(
        UserError, match=r"videos/a\.mp4 and .*videos/b\.mp4 are one film under two names; bring .*of b"
    ):
        open_dataset(tmp_path)


@pytest.mark.parametrize(("first", "crf"), [(0, 34), (12, 18)], ids=["encoded again", "cut"])
def test_the_same_pictures_in_another_file_await_the_footage(tmp_path: Path, first: int, crf: int) -> None:
    sources = [film(tmp_path / "a.mp4", 0), film(tmp_path / "b.mp4", 0, first, crf), film(tmp_path / "c.mp4", 1)]
    lags, clocks, findings = (tmp_path / f"{name}.json" for name in ("lags", "clocks", "sync"))
    take = offsets.Take(["a", "b", "c"], sources)
    offsets.run(offsets.Settings(sync="never"), take, [], lags, clocks, findings)
    assert read_clocks(clocks).refusal.startswith("cameras a and b show the same picture: both have one film")


def test_cameras_of_one_room_are_not_one_film(tmp_path: Path) -> None:
    sources = {c: open_source(film(tmp_path / f"{c}.mp4", seed), 0.0) for seed, c in enumerate("abcd")}
    assert compare_views(sources)[0] == ""


def test_a_phone_taped_to_another_is_another_camera() -> None:
    """The wall a fiftieth of the picture to the side, as from 10 cm beside at 5 m."""
    wall = room(0)
    assert same_view(static_image([wall]), static_image([np.clip(wall * 0.8 + 20, 0, 255).astype(np.uint8)]))
    assert not same_view(static_image([wall]), static_image([np.roll(wall, 3, axis=1)]))


def test_pictures_without_anything_in_them_say_nothing() -> None:
    black = np.zeros((120, 160, 3), np.uint8)
    assert not same_view(static_image([black]), static_image([black]))


def test_a_film_that_cannot_be_read_is_reported_and_the_others_are_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sources = {c: open_source(film(tmp_path / f"{c}.mp4", 0, 3 * k), 0.0) for k, c in enumerate("abc")}
    whole = (tmp_path / "a.mp4").read_bytes()
    (tmp_path / "a.mp4").write_bytes(whole[:200])
    assert compare_views(sources)[0].startswith("cameras b and c show the same picture")
    assert "a.mp4" in capsys.readouterr().out


CHANGES = {
    "steady": lambda picture: picture,
    "darker": lambda picture: picture // 2,
    "moved a little": lambda picture: np.roll(picture, 3, axis=1),
    "closer": lambda picture: cv2.resize(picture[6:-6, 8:-8], picture.shape[1::-1]),
    "mirrored": lambda picture: picture[:, ::-1],
    "another film": lambda picture: room(1),
}


@pytest.mark.parametrize("part", [slice(20, 40), slice(36, 40), slice(9, 22)])
@pytest.mark.parametrize("change", CHANGES)
def test_a_view_that_changes_within_a_film_is_named(change: str, part: slice, tmp_path: Path) -> None:
    film(tmp_path / "a.mp4", 0)
    pictures = list(decode(open_source(tmp_path / "a.mp4", 0.0), 0, 0))
    pictures[part] = [CHANGES[change](picture) for picture in pictures[part]]
    write_watchable(tmp_path / "b.mp4", pictures, 30.0, 18)
    said = compare_views({"b": open_source(tmp_path / "b.mp4", 0.0)})[1]
    assert len(said) == (change not in ("steady", "darker"))
    for sentence in said:
        frame = int(sentence.removeprefix("camera b shows another view in frame ").split()[0])
        assert part.start <= frame < part.stop
