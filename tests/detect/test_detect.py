# SPDX-License-Identifier: Apache-2.0
"""The detector: its files, what it sees in a picture, and how people are followed through pictures."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from studiorecon.detector.blazepose import LANDMARKS, LAYOUT, MASK_PX, BlazePose, Landmarks, anchors
from studiorecon.detector.crops import Region, sampled
from studiorecon.detector.following import Walker, detect_people
from studiorecon.detector.looking import detect_exhaustively, detect_new_people
from studiorecon.detector.windows import changed, grid, small, usual
from studiorecon.errors import UserError
from studiorecon.footage.frames import stills
from studiorecon.footage.source import open_source
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.scene.raw_detections import RawDetections, is_detector_file, read_raw_detections, write_raw_detections

FILES = ("pose_detection.onnx", "pose_landmark_full.onnx")


def test_the_networks_are_those_that_were_baked(root: Path) -> None:
    folder = root / "resources/detector"
    told = dict(reversed(line.split()) for line in (folder / "checksums.sha256").read_text().splitlines())
    assert set(told) == {p.name for p in folder.glob("*.onnx")}
    for name, digest in told.items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest, name


def test_a_missing_network_and_another_one_are_refused(root: Path, tmp_path: Path) -> None:
    folder = root / "resources/detector"
    with pytest.raises(UserError, match=r"nowhere\.onnx is missing"):
        BlazePose(tmp_path / "nowhere.onnx", folder / FILES[1])
    with pytest.raises(UserError, match="another network"):
        BlazePose(folder / FILES[1], folder / FILES[1])


def test_the_layout_names_what_the_landmarks_are() -> None:
    names = LAYOUTS[LAYOUT].keypoints
    assert len(names) == LANDMARKS
    assert [names[k] for k in (0, 2, 5, 11, 16, 23, 28, 31)] == [
        "nose",
        "left_eye",
        "right_eye",
        "left_shoulder",
        "right_wrist",
        "left_hip",
        "right_ankle",
        "left_big_toe",
    ]
    assert len(LAYOUTS[LAYOUT].pairs) == 16


def test_anchors_are_cell_middles_in_the_networks_order() -> None:
    found = anchors()
    assert found.shape == (2254, 2)
    np.testing.assert_allclose(found[[0, 2, 56]], [[0.5 / 28, 0.5 / 28], [1.5 / 28, 0.5 / 28], [0.5 / 28, 1.5 / 28]])
    np.testing.assert_allclose(found[-1], 6.5 / 7)


@pytest.mark.parametrize(("side", "turn_rad"), [(50.0, 0.0), (300.0, 0.7), (900.0, -2.0)])
def test_a_crop_shows_what_the_region_covers(side: float, turn_rad: float) -> None:
    picture = np.zeros((700, 900, 3), np.uint8)
    region = Region(np.array([430.0, 340.0]), side, turn_rad)
    into = region.crop_from_picture(256)
    # A disc at a known place of the crop, drawn where the map says it is in the picture.
    place = np.linalg.solve(into[:, :2], np.array([160.0, 90.0]) - into[:, 2])
    cv2.circle(
        picture,
        np.round((place - 0.5) * 256).astype(int).tolist(),
        round(side / 20 * 256),
        (255,) * 3,
        -1,
        cv2.LINE_AA,
        8,
    )
    crop = sampled(picture, region, 256)[..., 0].astype(float)
    rows, columns = np.mgrid[0:256, 0:256] + 0.5
    middle = np.array([(crop * columns).sum(), (crop * rows).sum()]) / crop.sum()
    np.testing.assert_allclose(middle, [160, 90], atol=0.6)


def test_a_region_puts_the_circles_point_on_top() -> None:
    hips, circle = np.array([100.0, 200.0]), np.array([160.0, 150.0])
    region = Region.around(hips, circle)
    into = region.crop_from_picture(256)
    top = into[:, :2] @ circle + into[:, 2]
    assert top[0] == pytest.approx(128)
    assert top[1] == pytest.approx(128 - 128 / 1.25)


def test_windows_cover_every_place_at_every_scale() -> None:
    for wh in ((480, 272), (1088, 1920), (3840, 2160)):
        sides = sorted({side for _, side in grid(wh)})
        assert len(sides) == (4 if max(wh) > 3000 else 3)
        for side in sides:
            covered = np.zeros((wh[1] // 16, wh[0] // 16), bool)
            for corner, own in grid(wh):
                if own == side:
                    x, y = np.maximum(corner, 0)
                    covered[
                        int(y / 16) : int((corner[1] + own) / 16) + 1, int(x / 16) : int((corner[0] + own) / 16) + 1
                    ] = True
            assert covered.all(), (wh, side)


def test_what_came_into_the_picture_gets_a_window() -> None:
    rng = np.random.default_rng(0)
    empty = [rng.integers(90, 110, (272, 480, 3), dtype=np.uint8) for _ in range(5)]
    somebody = empty[0].copy()
    somebody[60:200, 300:350] = 220
    ((corner, side),) = changed(somebody, usual([small(p) for p in empty]))
    assert (corner < [300, 60]).all()
    assert (corner + side > [350, 200]).all()
    assert changed(empty[1], usual([small(p) for p in empty])) == []


class MadeNetwork:
    """Sees a bright square as a person: exactly, but only with its region near it."""

    def __init__(self) -> None:
        self.looks = self.windows = 0

    def detect(self, picture: np.ndarray, corner: np.ndarray, side: float, least: float) -> list[tuple[float, Region]]:
        self.windows += 1
        places = [np.array(c[::-1]) + 0.5 for c in np.argwhere(picture[..., 0] == 255)]
        return [
            (0.9, Region(p, 60.0, 0.0))
            for p in places
            if (p > corner).all() and (p < corner + side).all() and side < 250
        ]

    def look(self, picture: np.ndarray, region: Region) -> Landmarks:
        self.looks += 1
        places = np.argwhere(picture[..., 0] == 255)[:, ::-1] + 0.5
        gaps = np.linalg.norm(places - region.centre, axis=1) if len(places) else np.array([np.inf])
        own = places[gaps.argmin()] if gaps.min() < region.side / 3 else region.centre
        keypoints = np.column_stack(
            [own + np.random.default_rng(1).uniform(-20, 20, (LANDMARKS, 2)), np.full(LANDMARKS, 0.9)]
        )
        presence = 1.0 if gaps.min() < region.side / 3 else 0.0
        guess, mask = np.zeros((LANDMARKS, 3)), np.zeros((MASK_PX, MASK_PX), np.uint8)
        return Landmarks(keypoints, presence, guess, mask, region, replace(region, centre=own))


def walk(frames: int, *walkers: tuple[int, int, float]) -> list[np.ndarray]:
    """Pictures with a dot per walker (first frame, last frame, pixels per frame)."""
    pictures = [np.zeros((200, 400, 3), np.uint8) for _ in range(frames)]
    for k, (first, last, speed) in enumerate(walkers):
        for t in range(first, last + 1):
            pictures[t][60 + 80 * k, int(60 + speed * (t - first))] = 255
    return pictures


def test_people_are_followed_forwards_and_back_through_all_pictures() -> None:
    pictures = walk(40, (0, 39, 4.0), (7, 33, -1.0))
    network = MadeNetwork()
    seen = list(detect_people(pictures, network, [], fps=30.0))  # type: ignore[arg-type]
    assert [len(s) for s in seen] == [1 + (7 <= t <= 33) for t in range(40)]
    # Looked for twice a second only, and one look per person and picture beside.
    assert network.windows <= 4 * len(grid((400, 200)))
    assert network.looks < 2.2 * sum(map(len, seen))


def test_how_often_is_looked_follows_the_clock_and_not_the_frame_count() -> None:
    slow, fast = MadeNetwork(), MadeNetwork()
    assert all(len(s) == 1 for s in detect_people(walk(20, (0, 19, 12.0)), slow, [], fps=10.0))  # type: ignore[arg-type]
    assert all(len(s) == 1 for s in detect_people(walk(120, (0, 119, 2.0)), fast, [], fps=60.0))  # type: ignore[arg-type]
    assert fast.windows <= slow.windows


def test_found_people_survive_the_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    mask = rng.integers(0, 255, (8, 8), dtype=np.uint8)
    rows = [(t, rng.random((33, 3)), 0.9, rng.random((33, 3)), mask, rng.random((2, 3))) for t in (3, 4)]
    for given in (rows, []):
        found = RawDetections.of("left", LAYOUT, 33, given, (3, 9), "made")
        write_raw_detections(tmp_path / "left.npz", found)
        assert is_detector_file(tmp_path / "left.npz")
        back = read_raw_detections(tmp_path / "left.npz", masks=True)
        for name in RawDetections.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(back, name), getattr(found, name), err_msg=name)


@pytest.mark.real
def test_a_real_man_and_a_bystander_are_found_where_openpose_found_them(root: Path, real_data: Path) -> None:
    folder = root / "resources/detector"
    source = open_source(real_data / "pose2sim_balancing/single/videos/cam03.mp4", 30.0)
    (picture,) = stills(source, [0])
    network = BlazePose(folder / FILES[0], folder / FILES[1])
    seen = detect_new_people(network, picture, grid(source.wh), [])
    assert len(seen) == 1
    names = LAYOUTS[LAYOUT].keypoints
    there = {n: seen[0].keypoints[names.index(n)] for n in names}
    # Read off the picture by hand: he is seen from behind, head 500 px from the top.
    np.testing.assert_allclose(there["left_shoulder"][:2], [588, 624], atol=30)
    np.testing.assert_allclose(there["right_ankle"][:2], [700, 1275], atol=40)
    # The mask covers him and not the wall.
    mask = seen[0].mask
    assert 0.05 < (mask > 127).mean() < 0.5


def test_a_region_follows_a_speed_and_not_a_number_of_pictures() -> None:
    """Somebody at 120 pixels per second: a twelfth of a second later they are expected at nearly the same place, seen
    once in that time or ten times."""
    seen = MadeNetwork().look(np.zeros((10, 10, 3), np.uint8), Region(np.zeros(2), 60.0, 0.0))
    slow = Walker(seen, np.array([10.0, 0.0])).region(12.0).centre
    fast = Walker(seen, np.array([1.0, 0.0])).region(120.0).centre
    assert slow[0] == pytest.approx(8.1, abs=0.1)
    assert fast[0] == pytest.approx(0.98, abs=0.01)


def test_a_picture_without_neighbours_is_looked_at_in_turned_windows_and_the_surest_look_counts() -> None:
    class Bent(MadeNetwork):
        """Sees somebody only in turned windows, and is sure of them at the second look."""

        def detect(self, *window: Any) -> list[tuple[float, Region]]:
            upright = window[4] == 0
            return [] if upright else [(0.5, region) for _, region in super().detect(*window[:4])]

        def look(self, picture: np.ndarray, region: Region) -> Landmarks:
            seen = super().look(picture, region)
            first = abs(region.side - 60) < 1e-6
            full = np.full((MASK_PX, MASK_PX), 255, np.uint8)
            surer = replace(seen.next_region, side=61.0)
            return replace(seen, presence=seen.presence * (0.6 if first else 1.0), mask=full, next_region=surer)

    picture = walk(1, (0, 0, 4.0))[0]
    assert detect_new_people(MadeNetwork(), picture, grid((400, 200)), []) != []  # type: ignore[arg-type]
    (found,) = detect_exhaustively(Bent(), picture)  # type: ignore[arg-type]
    assert found.presence == 1.0
    assert detect_exhaustively(Bent(), np.zeros_like(picture)) == []  # type: ignore[arg-type]
