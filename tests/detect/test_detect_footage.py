# SPDX-License-Identifier: Apache-2.0
"""What footage the detector looks at: films that announce nothing, parts of films, single pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from studiorecon.detect import people
from studiorecon.detector.windows import changed
from studiorecon.footage.source import open_source
from studiorecon.scene.raw_detections import read_raw_detections

from tests.made.footage import smooth_pictures, write_streamed, write_video


@pytest.fixture
def backgrounds(monkeypatch: pytest.MonkeyPatch) -> list[list[np.ndarray]]:
    """The pictures of the room that the detector was given, of every film that it looked at."""
    given: list[list[np.ndarray]] = []
    looked = people.people_in

    def noted(pictures: Any, network: Any, backgrounds: list[np.ndarray], fps: float, few: bool) -> Any:
        given.append(backgrounds)
        return looked(pictures, network, backgrounds, fps, False)

    monkeypatch.setattr(people, "people_in", noted)
    return given


def networks(root: Path) -> list[Path]:
    folder = root / "resources/detector"
    return [folder / name for name in ("pose_detection.onnx", "pose_landmark_full.onnx", "confidence.json")]


@pytest.mark.parametrize("written", [write_video, write_streamed])
def test_a_film_that_announces_no_frames_is_looked_at_like_any_other(
    written: Any, root: Path, tmp_path: Path, backgrounds: list[list[np.ndarray]]
) -> None:
    film = written(tmp_path / "a.mkv", np.repeat(smooth_pictures(1), 12, axis=0))
    source = open_source(film, 30.0)
    assert source.frames == 12
    people.run("a", film, [], 30.0, [], networks(root), [], "auto", tmp_path / "a.npz")
    assert read_raw_detections(tmp_path / "a.npz").looked == (0, 12)
    ((background,),) = backgrounds
    assert background.shape == (64, 96, 3), "what differs from the usual picture is looked at too"


def test_what_differs_from_the_users_plate_is_looked_at(
    root: Path, tmp_path: Path, backgrounds: list[list[np.ndarray]], capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a film in which nothing ever moves, nothing differs from what is usual; a plate of half its size counts, one
    of another shape does not."""
    picture = smooth_pictures(1)[0]
    film = write_video(tmp_path / "a.mkv", np.repeat(picture[None], 12, axis=0))
    room = picture.copy()
    room[20:40, 30:50] ^= 128
    for name, plate in (("half", cv2.resize(room, None, fx=0.5, fy=0.5)), ("other", room[:, :64])):
        cv2.imwrite(str(tmp_path / f"{name}.png"), plate[..., ::-1])
        people.run("a", film, [], 30.0, [tmp_path / f"{name}.png"], networks(root), [], "auto", tmp_path / "a.npz")
    (usual, plate), (alone,) = backgrounds
    np.testing.assert_array_equal(usual, alone)
    assert plate.shape == usual.shape
    assert changed(picture, plate)
    assert not changed(picture, usual)
    assert "another shape than the film" in capsys.readouterr().out


def test_a_single_picture_is_a_capture_too(root: Path, tmp_path: Path) -> None:
    folder = tmp_path / "a"
    folder.mkdir()
    cv2.imwrite(str(folder / "0001.png"), smooth_pictures(1)[0])
    people.run("a", folder, [], 30.0, [], networks(root), [], "auto", tmp_path / "a.npz")
    found = read_raw_detections(tmp_path / "a.npz")
    assert (found.looked, len(found.frame)) == ((0, 1), 0)
