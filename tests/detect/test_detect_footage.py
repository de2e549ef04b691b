# SPDX-License-Identifier: Apache-2.0
"""What footage the detector looks at: films that announce nothing, sideways ones, single pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from studiorecon.clocks import moments as choose
from studiorecon.clocks.offsets import Take
from studiorecon.detect import people
from studiorecon.detector.blazepose import LANDMARKS, MASK_PX, Landmarks
from studiorecon.detector.crops import Region
from studiorecon.detector.film_rotation import quarter_turns
from studiorecon.detector.network_files import DetectorFiles
from studiorecon.footage.source import open_source
from studiorecon.scene.raw_detections import RawDetections, read_raw_detections

from tests.made.footage import smooth_pictures, write_streamed, write_video


def networks(root: Path) -> list[Path]:
    folder = root / "resources/detector"
    return [folder / name for name in ("movenet_multipose.onnx", "pose_landmark_full.onnx", "confidence.json")]


def detected(source: Path, root: Path, folder: Path) -> RawDetections:
    """What both steps find in one film or folder."""
    known, found, files = folder / "known.npz", folder / "a.npz", DetectorFiles(networks(root))
    choose.run(choose.Settings(sync="never"), Take(["a"], [source]), 1, folder / "lags.json", ["a"], files, [known])
    people.run("a", source, [known], [], 30.0, files, found)
    return read_raw_detections(found)


@pytest.mark.parametrize("written", [write_video, write_streamed])
def test_a_film_that_announces_no_frames_is_looked_at_like_any_other(written: Any, root: Path, tmp_path: Path) -> None:
    film = written(tmp_path / "a.mkv", np.repeat(smooth_pictures(1), 12, axis=0))
    source = open_source(film, 30.0)
    assert source.frames == 12
    assert detected(film, root, tmp_path).looked == [(0, 12)]


def test_a_single_picture_is_a_capture_too(root: Path, tmp_path: Path) -> None:
    folder = tmp_path / "a"
    folder.mkdir()
    cv2.imwrite(str(folder / "0001.png"), smooth_pictures(1)[0])
    found = detected(folder, root, tmp_path)
    assert (found.looked, len(found.frame)) == ([(0, 1)], 0)


class OfTheUpright:
    """Sees somebody whose head (white) is above the hips (grey), and nobody in any other picture."""

    placer = property(lambda self: self)
    title = "upright"

    def look(self, picture: np.ndarray, region: Region) -> Landmarks:
        head, hips = (np.argwhere(picture[..., 0] == level)[0, ::-1] + 0.5 for level in (255, 200))
        up = hips[1] - head[1] > abs(hips[0] - head[0])
        keypoints = np.full((LANDMARKS, 3), 0.9)
        keypoints[:, :2] = hips
        keypoints[0, :2] = head
        points_m = np.zeros((LANDMARKS, 3))
        points_m[0] = 0.0, -0.5, 0.1
        mask = np.full((MASK_PX, MASK_PX), 255, np.uint8)
        around = Region.around(hips, head)
        return Landmarks(keypoints, float(up), points_m, mask, around, around)

    def detect_new_people(self, picture: np.ndarray, known: Any = (), closely: bool = False) -> list[Landmarks]:
        seen = self.look(picture, Region(np.zeros(2), 1.0, 0.0))
        return [seen] if seen.presence and not known else []

    def surest(self, picture: np.ndarray) -> list[float]:
        return [self.look(np.rot90(picture, turns), Region(np.zeros(2), 1.0, 0.0)).presence for turns in range(4)]


@pytest.mark.parametrize("turns", range(4))
def test_people_are_looked_for_upright_and_reported_in_the_films_own_pixels(
    turns: int, root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(DetectorFiles, "detector", lambda _: OfTheUpright())
    picture = np.zeros((120, 200, 3), np.uint8)
    picture[30, 50], picture[70, 60] = 255, 200
    picture = np.rot90(picture, turns)
    (tmp_path / "a").mkdir()
    for number in range(4):
        cv2.imwrite(str(tmp_path / "a" / f"{number}.png"), picture)
    found = detected(tmp_path / "a", root, tmp_path)
    assert found.frame.tolist() == [0, 1, 2, 3]
    head, hips = (np.argwhere(picture[..., 0] == level)[0, ::-1] + 0.5 for level in (255, 200))
    np.testing.assert_allclose(found.keypoints[0, [0, 24], :2], [head, hips], atol=1e-9)
    up = np.array([[0, -1], [-1, 0], [0, 1], [1, 0]])[turns]
    np.testing.assert_allclose(found.points_m[0, 0], [*(0.5 * up), 0.1], atol=1e-9)
    # The mask is a picture of the upright body: its middle is the hips', and its upper half holds the head.
    affine = found.mask_from_picture[0]
    middle, upper = np.stack([hips, head]) @ affine[:, :2].T + affine[:, 2]
    np.testing.assert_allclose(middle, MASK_PX / 2)
    np.testing.assert_allclose(upper, [MASK_PX / 2, MASK_PX / 2 - 0.4 * MASK_PX], atol=1e-6)


@pytest.mark.parametrize("pictures", [1, 4])
def test_no_picture_is_searched_twice_for_how_it_is_turned(
    pictures: int, root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[np.ndarray] = []

    class Counting(OfTheUpright):
        def detect_new_people(self, picture: np.ndarray, known: Any = (), closely: bool = False) -> list[Landmarks]:
            shown.extend([] if closely else [picture])
            return super().detect_new_people(picture, known, closely)

    monkeypatch.setattr(DetectorFiles, "detector", lambda _: Counting())
    (tmp_path / "a").mkdir()
    for number in range(pictures):
        picture = np.zeros((120, 200, 3), np.uint8)
        picture[30, 50 + 9 * number], picture[70, 60 + 9 * number] = 255, 200
        cv2.imwrite(str(tmp_path / "a" / f"{number}.png"), picture)
    assert len(detected(tmp_path / "a", root, tmp_path).frame) == pictures
    assert len(shown) == 1


@pytest.mark.parametrize(
    ("moved", "turns"), [(1.0, 0), (10.0, 1), (np.nan, 1)], ids=["furniture", "people", "one picture alone"]
)
def test_a_film_is_turned_for_people_who_move_and_not_for_its_furniture(moved: float, turns: int) -> None:
    class Fair(OfTheUpright):
        """As sure of furniture as of a seated woman."""

        def look(self, picture: np.ndarray, region: Region) -> Landmarks:
            seen = super().look(picture, region)
            return replace(seen, presence=seen.presence * (0.72 if np.isfinite(moved) else 1.0))

    picture = np.zeros((120, 200, 3), np.uint8)
    picture[30, 50], picture[70, 60] = 255, 200
    apart = [np.full((120, 200), moved).T] * 3
    assert quarter_turns(Fair(), [np.rot90(picture, 3)] * 3, apart, 1.0)[0] == turns  # type: ignore[arg-type]


def test_somebody_who_leans_by_fifty_degrees_does_not_turn_the_film() -> None:
    class OfAll(OfTheUpright):
        def look(self, picture: np.ndarray, region: Region) -> Landmarks:
            return replace(super().look(picture, region), presence=1.0)

    picture = np.zeros((200, 200, 3), np.uint8)
    picture[round(100 - 40 * np.cos(0.87)), round(100 - 40 * np.sin(0.87))], picture[100, 100] = 255, 200
    moved = [np.full((200, 200), 20.0)] * 3
    assert quarter_turns(OfAll(), [picture] * 3, moved, 1.0)[0] == 0  # type: ignore[arg-type]
