# SPDX-License-Identifier: Apache-2.0
"""People are counted before anybody is followed: in recorded keypoints, or in a few pictures of a few cameras."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.footage.source import FootageSource, open_source
from studiorecon.plan import headcount
from studiorecon.plan.discovery import open_dataset
from studiorecon.plan.headcount import people_seen, seen_twice

from tests.made.footage import smooth_pictures, write_video

FILM = FootageSource(Path("nowhere.mp4"), (64, 48), 30.0, 100, 0, (), ())


def recorded(folder: Path, *people: int) -> Path:
    """OpenPose's files of one camera, with so many people in one frame after the other."""
    folder.mkdir()
    for frame, count in enumerate(people):
        person = {"pose_keypoints_2d": [10.0, 20.0, 0.9] * 25}
        (folder / f"{frame:06d}_keypoints.json").write_text(json.dumps({"people": [person] * count}))
    return folder


@pytest.mark.parametrize(("counts", "people"), [([3], 3), ([2, 1], 1), ([1, 3, 2, 0], 2), ([2, 2, 5], 2), ([0, 0], 0)])
def test_somebody_is_whom_two_cameras_see(counts: list[int], people: int) -> None:
    assert seen_twice(counts) == people


def test_recorded_keypoints_are_counted_without_a_look_at_the_film(tmp_path: Path) -> None:
    keypoints = {
        "a": recorded(tmp_path / "a", 2, 2, 3, 2, 0),
        "b": recorded(tmp_path / "b", 2, 2, 2, 7),
        "c": recorded(tmp_path / "c", 0, 0),
    }
    assert people_seen(dict.fromkeys(keypoints, FILM), keypoints, 0, 5) == 2


def test_a_keypoint_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    broken = tmp_path / "cam7.json"
    broken.write_text("{")
    with pytest.raises(UserError, match=r"cam7\.json"):
        people_seen({"cam7": FILM}, {"cam7": broken}, 0, 5)


def test_a_few_pictures_of_the_part_that_is_used_are_looked_at(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Three of each of four cameras, however many there are, and those beyond what is used count for nothing."""
    looked: list[tuple[str, list[int]]] = []

    def glimpsed(source: FootageSource, wanted: list[int]) -> Iterator[np.ndarray]:
        looked.append((source.path.stem, wanted))
        return (np.zeros((48, 64, 3), np.uint8) for _ in wanted)

    crowds = iter([2, 2, 9] * 4)
    monkeypatch.setattr(headcount, "glimpses", glimpsed)
    monkeypatch.setattr(headcount, "newcomers", lambda *_: [object()] * next(crowds))
    monkeypatch.setattr(headcount, "trust", lambda _: 0.9)
    cameras = {f"cam{k}": replace(FILM, path=Path(f"cam{k}.mp4")) for k in range(8)}
    assert people_seen(cameras, {}, 40, 60) == 2
    assert [camera for camera, _ in looked] == ["cam0", "cam2", "cam5", "cam7"]
    assert all(wanted == [50, 70, 90] for _, wanted in looked)


def test_nobody_is_seen_where_nobody_is(tmp_path: Path) -> None:
    film = write_video(tmp_path / "a.mp4", smooth_pictures(6))
    assert people_seen({"a": open_source(film, 30.0)}, {}, 0, 6) == 0


@pytest.mark.real
@pytest.mark.parametrize(
    ("take", "keypoints", "people"), [("single", True, 1), ("single", False, 2), ("multi", False, 2)]
)
def test_real_people(take: str, keypoints: bool, people: int, real_data: Path, root: Path) -> None:
    """One man, and somebody who stands behind the scene; two participants before onlookers."""
    data: Any = open_dataset(
        real_data / "pose2sim_balancing" / take, root / "tests" / "captures" / f"pose2sim_{take}.yaml"
    )
    films = {camera: open_source(path, 30.0) for camera, path in data.footage.items()}
    frames = min(film.frames for film in films.values())
    assert people_seen(films, data.keypoints if keypoints else {}, 0, frames) == people
