# SPDX-License-Identifier: Apache-2.0
"""``report.recognition``: a film identical to its photos scores perfectly; moved, missing or omitted people lower the
score.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from studiorecon.camera_files.colmap import write_model
from studiorecon.footage.video import write_lossless
from studiorecon.report import recognition
from studiorecon.report.metrics.films import ScoredFilmFiles
from studiorecon.scene.capture import Footage, Manifest, write_manifest
from studiorecon.scene.files import read_json, write_json
from studiorecon.scene.path import PathStep, write_path

from tests.made.scene import ring

WH, FRAMES = (160, 120), 8


def found_in(_network: object, picture: np.ndarray, _worth: object) -> list[np.ndarray]:
    """Replaces the detector: a person is a bright box, 33 points on its diagonal, the last three invisible."""
    rows, columns = np.nonzero(picture[..., 0] > 150)
    if not len(rows):
        return []
    along = np.linspace(0, 1, 33)[:, None]
    low, high = np.array([columns.min(), rows.min()]), np.array([columns.max(), rows.max()]) + 1
    return [np.column_stack([low + along * (high - low), np.r_[np.full(30, 0.9), np.zeros(3)]])]


def picture(shift_px: float | None) -> np.ndarray:
    made = np.full((WH[1], WH[0], 3), 40, np.uint8)
    if shift_px is not None:
        made[20:100, 40 + int(shift_px) : 80 + int(shift_px)] = 220
    return made


@pytest.fixture
def recognised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict]:
    """Scores of a film whose people are shifted by so many pixels from those of the photos (None: are missing)."""
    monkeypatch.setattr(recognition, "detect_keypoints", found_in)
    monkeypatch.setattr(
        recognition.DetectorFiles, "detector", lambda _: SimpleNamespace(placer=SimpleNamespace(title="made"))
    )
    cameras = ring([45, 135], "view")
    write_model(tmp_path / "heldout", cameras)
    lens = np.eye(3).tolist()
    footage = tuple(Footage(c.name, True, WH, lens, 30.0, FRAMES, 0, "v.mp4", "", WH, 0, 0.0, []) for c in cameras)
    write_manifest(tmp_path / "manifest.json", Manifest("made", 30.0, FRAMES, footage))
    write_json(tmp_path / "confidence.json", {})
    write_path(tmp_path / "film.json", [PathStep(c, float(f), c.name) for c in cameras for f in range(FRAMES)], 30.0)

    def scores(photo: float | None, film: Callable[[int], float | None], better: float | None = None) -> dict:
        for camera in cameras:
            write_lossless(tmp_path / f"{camera.name}.mkv", [picture(photo)] * FRAMES, 30.0)
        write_lossless(tmp_path / "film.mkv", [picture(film(i)) for i in range(2 * FRAMES)], 30.0)
        write_lossless(tmp_path / "better.mkv", [picture(better)] * (2 * FRAMES), 30.0)
        recognition.run(
            ScoredFilmFiles(
                tmp_path / "manifest.json",
                tmp_path / "heldout/images.txt",
                tmp_path / "heldout/images.txt",
                [tmp_path / f"{camera.name}.mkv" for camera in cameras],
                [tmp_path / "film.mkv"],
                [tmp_path / "film.json"],
                [tmp_path / "better.mkv"],
            ),
            [tmp_path / "finder.onnx", tmp_path / "landmarks.onnx", tmp_path / "confidence.json"],
            tmp_path / "recognition.json",
        )
        return read_json(tmp_path / "recognition.json")

    return scores


def test_a_film_that_is_its_photos_shows_the_same_people(recognised: Callable[..., dict]) -> None:
    found = recognised(0.0, lambda _: 0.0, better=0.0)
    for version in ("raw", "enhanced"):
        assert found[version]["detection_rate"] == found[version]["pck_0.05"] == found[version]["pck_0.1"] == 1.0
        assert found[version]["people"] == 2 * 4
        assert found[version]["keypoints"] == 2 * 4 * 30, "what the photo does not show is not asked for"
        assert found[version]["reason"] is None


def test_points_are_right_within_their_share_of_the_persons_size(recognised: Callable[..., dict]) -> None:
    # 30 of 33 points along 80 pixels: 70.5 is the longer side of the visible part.
    found = recognised(0.0, lambda _: 5.0, better=9.0)
    assert (found["raw"]["pck_0.05"], found["raw"]["pck_0.1"]) == (0.0, 1.0)
    assert (found["enhanced"]["pck_0.05"], found["enhanced"]["pck_0.1"]) == (0.0, 0.0)


def test_who_is_missing_in_half_of_the_film_is_found_in_the_other_half(recognised: Callable[..., dict]) -> None:
    found = recognised(0.0, lambda index: 0.0 if index < FRAMES else None)["raw"]
    assert found["detection_rate"] == found["pck_0.05"] == 0.5
    assert found["missing"] == 4 * 30


def test_photos_of_nobody_say_so(recognised: Callable[..., dict]) -> None:
    found = recognised(None, lambda _: 0.0)["raw"]
    assert found["pck_0.05"] is None
    assert found["reason"] == "the detector finds no person in the photos"


def test_without_a_film_of_a_cameras_own_view_nothing_is_measured(tmp_path: Path, root: Path) -> None:
    write_model(tmp_path, ring([45], "view"))
    write_manifest(tmp_path / "manifest.json", Manifest("made", 30.0, FRAMES, ()))
    folder = root / "resources/detector"
    networks = [folder / "movenet_multipose.onnx", folder / "pose_landmark_full.onnx", folder / "confidence.json"]
    images = tmp_path / "images.txt"
    recognition.run(ScoredFilmFiles(tmp_path / "manifest.json", images, images), networks, tmp_path / "found.json")
    found = read_json(tmp_path / "found.json")
    assert found["raw"]["detection_rate"] is None
    assert "no film" in found["enhanced"]["reason"]
    assert found["detector"] == "pose_landmark_full"
