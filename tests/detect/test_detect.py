# SPDX-License-Identifier: Apache-2.0
"""The detector: its files, what it sees in a picture, and how people are followed through pictures."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.detector.blazepose import LANDMARKS, LAYOUT, MASK_PX, Landmarks
from studiorecon.detector.crops import Region, sample_region
from studiorecon.detector.frame_detection import Detector
from studiorecon.detector.movenet import MoveNet, Sighting
from studiorecon.detector.network_files import DetectorFiles
from studiorecon.detector.tracking import Walker, detect_people
from studiorecon.errors import UserError
from studiorecon.footage.frames import read_stills
from studiorecon.footage.source import open_source
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.scene.raw_detections import RawDetections, is_detector_file, read_raw_detections, write_raw_detections

FILES = ("movenet_multipose.onnx", "pose_landmark_full.onnx")


def test_the_networks_are_those_that_were_baked(root: Path) -> None:
    folder = root / "resources/detector"
    reported = dict(reversed(line.split()) for line in (folder / "checksums.sha256").read_text().splitlines())
    assert set(reported) == {p.name for p in folder.glob("*.onnx")}
    for name, digest in reported.items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest, name


def test_a_missing_network_and_another_one_are_refused(root: Path, tmp_path: Path) -> None:
    folder = root / "resources/detector"
    with pytest.raises(UserError, match=r"nowhere\.onnx is missing"):
        DetectorFiles([tmp_path / "nowhere.onnx", folder / FILES[1]]).detector()
    for finder, placer in ((FILES[1], FILES[1]), (FILES[0], FILES[0])):
        with pytest.raises(UserError, match=r"is not (MoveNet|BlazePose)"):
            DetectorFiles([folder / finder, folder / placer]).detector()


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
    crop = sample_region(picture, region, 256)[..., 0].astype(float)
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


# COCO's points of somebody upright, from the hips, in pixels.
UPRIGHT = np.array(
    [
        *([0, -50], [2, -52], [-2, -52], [4, -50], [-4, -50], [8, -40], [-8, -40], [12, -20], [-12, -20]),
        *([14, 0], [-14, 0], [5, 0], [-5, 0], [6, 20], [-6, 20], [6, 40], [-6, 40]),
    ]
)


class MadeFinder:
    """Sees a bright dot as the hips of somebody, a faint one only from near."""

    def __init__(self) -> None:
        self.passes = self.close = 0

    def find(self, picture: np.ndarray, longer_px: int, least: float) -> list[Sighting]:
        near = longer_px > 1000
        self.passes += 1
        self.close += near
        return [
            Sighting(0.5, np.column_stack([place + UPRIGHT / (1 + near), np.full(len(UPRIGHT), 0.5)]))
            for place in np.argwhere(picture[..., 0] >= (99 if near else 255))[:, ::-1] + 0.5
        ]


class MadePlacer:
    """Places the person of a dot exactly, but only with a region near it."""

    def __init__(self) -> None:
        self.looks = 0

    def look(self, picture: np.ndarray, region: Region) -> Landmarks:
        self.looks += 1
        places = np.argwhere(picture[..., 0] > 0)[:, ::-1] + 0.5
        gaps = np.linalg.norm(places - region.centre, axis=1) if len(places) else np.array([np.inf])
        own = places[gaps.argmin()] if gaps.min() < region.side / 3 else region.centre
        keypoints = np.column_stack([np.tile(own, (LANDMARKS, 1)), np.full(LANDMARKS, 0.9)])
        keypoints[[LAYOUTS[LAYOUT].keypoints.index(name) for name in LAYOUTS["coco17"].keypoints], :2] += UPRIGHT
        presence = 1.0 if gaps.min() < region.side / 3 else 0.0
        guess, mask = np.zeros((LANDMARKS, 3)), np.zeros((MASK_PX, MASK_PX), np.uint8)
        return Landmarks(keypoints, presence, guess, mask, region, replace(region, centre=own))


def made() -> tuple[Detector, MadeFinder, MadePlacer]:
    finder, placer = MadeFinder(), MadePlacer()
    return Detector(finder, placer), finder, placer  # type: ignore[arg-type]


def walk(frames: int, *walkers: tuple[int, int, float]) -> list[np.ndarray]:
    """Pictures with a dot per walker (first frame, last frame, pixels per frame)."""
    pictures = [np.zeros((200, 400, 3), np.uint8) for _ in range(frames)]
    for k, (first, last, speed) in enumerate(walkers):
        for t in range(first, last + 1):
            pictures[t][60 + 80 * k, int(60 + speed * (t - first))] = 255
    return pictures


def test_people_are_followed_forwards_and_back_through_all_pictures() -> None:
    pictures = walk(40, (0, 39, 4.0), (7, 33, -1.0))
    detector, finder, placer = made()
    seen = list(detect_people(pictures, detector, fps=30.0))
    assert [len(s) for s in seen] == [1 + (7 <= t <= 33) for t in range(40)]
    # Looked for twice a second only, and one look per person and picture beside.
    assert finder.passes <= 4 * 3
    assert placer.looks < 2.2 * sum(map(len, seen))


def test_how_often_is_looked_follows_the_clock_and_not_the_frame_count() -> None:
    (slow, ten, _), (fast, sixty, _) = made(), made()
    assert all(len(s) == 1 for s in detect_people(walk(20, (0, 19, 12.0)), slow, fps=10.0))
    assert all(len(s) == 1 for s in detect_people(walk(120, (0, 119, 2.0)), fast, fps=60.0))
    assert sixty.passes <= ten.passes


@pytest.mark.parametrize(("shake_px", "share"), [(0.0, 0.6), (6.0, 1.0)], ids=["even walk", "shaking"])
def test_pictures_between_are_interpolated_only_where_the_way_is_smooth(shake_px: float, share: float) -> None:
    """At 60 per second an even walk costs little more than half of the looks, and each picture has its person where
    they are; who shakes is placed in all pictures."""
    pictures, frames = [], 90
    x = 60 + 2.0 * np.arange(frames) + shake_px * (np.arange(frames) // 2 % 2)
    for t in range(frames):
        pictures.append(np.zeros((200, 400, 3), np.uint8))
        pictures[-1][100, round(x[t])] = 255
    detector, _, placer = made()
    seen = list(detect_people(pictures, detector, fps=60.0))
    hips = [LAYOUTS[LAYOUT].keypoints.index(f"{side}_hip") for side in ("left", "right")]
    for t, one in enumerate(seen):
        assert len(one) == 1
        assert one[0].keypoints[hips, 0].mean() == pytest.approx(np.round(x[t]) + 0.5, abs=1.1)
    assert share * frames * 0.8 < placer.looks < share * frames + 20


def test_whom_only_a_close_look_finds_is_looked_for_closely_as_long_as_that_finds_more() -> None:
    """Close looks are dear: every five seconds, and at every look while they add people."""
    empty, nobody, _ = made()
    assert not any(detect_people(walk(100), empty, fps=10.0))
    assert nobody.close == 2
    pictures = walk(100, (0, 99, 1.0))
    for t, picture in enumerate(pictures):
        picture[picture > 0] = 99
        if t > 3:
            picture[170, 30] = 99
    detector, finder, _ = made()
    assert [len(s) for s in detect_people(pictures, detector, fps=10.0)] == [1] + [1] * 3 + [2] * 96
    assert finder.close == 4


def test_found_people_survive_the_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    mask = rng.integers(0, 255, (8, 8), dtype=np.uint8)
    rows = [(t, rng.random((33, 3)), 0.9, rng.random((33, 3)), mask, rng.random((2, 3))) for t in (3, 4)]
    for given in (rows, []):
        found = RawDetections.of("left", LAYOUT, 33, given, [(3, 9)], "made")
        write_raw_detections(tmp_path / "left.npz", found)
        assert is_detector_file(tmp_path / "left.npz")
        back = read_raw_detections(tmp_path / "left.npz", masks=True)
        for name in RawDetections.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(back, name), getattr(found, name), err_msg=name)


@pytest.mark.real
def test_a_real_man_and_a_bystander_are_found_where_openpose_found_them(root: Path, real_data: Path) -> None:
    folder = root / "resources/detector"
    source = open_source(real_data / "pose2sim_balancing/single/videos/cam03.mp4", 30.0)
    (picture,) = read_stills(source, [0])
    seen = DetectorFiles([folder / name for name in FILES]).detector().detect_new_people(picture)
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
    seen = MadePlacer().look(np.zeros((10, 10, 3), np.uint8), Region(np.zeros(2), 60.0, 0.0))
    slow = Walker(seen, np.array([10.0, 0.0]), 0).region(12.0).centre
    fast = Walker(seen, np.array([1.0, 0.0]), 0).region(120.0).centre
    assert slow[0] == pytest.approx(8.1, abs=0.1)
    assert fast[0] == pytest.approx(0.98, abs=0.01)


def test_who_is_known_or_seen_at_two_sizes_is_placed_once() -> None:
    picture = walk(1, (0, 0, 0.0), (0, 0, 0.0))[0]
    detector, _, placer = made()
    both = detector.detect_new_people(picture)
    assert len(both) == 2
    assert placer.looks == 4
    assert len(detector.detect_new_people(picture, both[:1])) == 1
    assert placer.looks == 6
    assert detector.detect_new_people(picture, both) == []
    assert placer.looks == 6


def test_the_finder_reads_the_maps_as_the_original_graph_does(root: Path) -> None:
    """Six people that TensorFlow made of the whole graph (``resources/bake_finder.py``), among them some of low
    score."""
    with np.load(Path(__file__).with_name("movenet_original.npz")) as file:
        picture, theirs = file["picture"], file["people"]
    wh = np.array([picture.shape[1], picture.shape[0]])
    ours = MoveNet(root / "resources/detector" / FILES[0]).find(picture, max(wh), 0.05)
    theirs = theirs[theirs[:, -1] > 0.05]
    assert len(ours) == len(theirs) >= 2
    for own, other in zip(ours, theirs[np.argsort(-theirs[:, -1])]):
        assert own.score == pytest.approx(other[-1], abs=1e-3)
        points = other[:51].reshape(17, 3)
        np.testing.assert_allclose(own.keypoints[:, 2], points[:, 2], atol=2e-3)
        np.testing.assert_allclose(own.keypoints[:, :2] / wh, points[:, 1::-1], atol=2e-3)


def test_people_of_forty_pixels_are_found_closely(root: Path) -> None:
    """Two made people, shrunk, in a large picture: the usual look misses one."""
    with np.load(Path(__file__).with_name("movenet_original.npz")) as file:
        whole, people = file["picture"], file["people"]
    tallest = max(people[:2, 53] - people[:2, 51]) * whole.shape[0]
    small = cv2.resize(whole, None, fx=40 / tallest, fy=40 / tallest, interpolation=cv2.INTER_AREA)
    picture = np.full((720, 1280, 3), 110, np.uint8)
    top, left = 500, 640
    picture[top : top + small.shape[0], left : left + small.shape[1]] = small
    network = MoveNet(root / "resources/detector" / FILES[0])
    assert len(network.find(picture, 640, 0.1)) < 2
    found = network.find(picture, 1280, 0.2)
    for person in people[:2]:
        hips = np.array([left, top]) + person[:51].reshape(17, 3)[11:13, 1::-1].mean(0) * small.shape[1::-1]
        assert min(np.linalg.norm(one.keypoints[11:13, :2].mean(0) - hips) for one in found) < 6
