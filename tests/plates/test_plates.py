# SPDX-License-Identifier: Apache-2.0
"""Plates: the room without people, and only what the pictures show of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studiorecon.body.person_boxes import people_regions
from studiorecon.configuration.settings import load
from studiorecon.errors import UserError
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import write_lossless
from studiorecon.images.plate import noise_levels, write_plate
from studiorecon.plates import clean as plate_step
from studiorecon.scene.capture import write_footage
from studiorecon.scene.people import Detections, write_detections

from tests.made.footage import calibrated, footage, smooth_pictures


def passing_block(frames: int, background: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """A textured block crosses the left half, another never leaves the right: (T, H, W, 3) pictures, (T, H, W) where
    they are."""
    rng = np.random.default_rng(3)
    pictures = np.repeat(background[None], frames, axis=0).astype(np.float64)
    there = np.zeros(pictures.shape[:3], bool)
    for t in range(frames):
        left = 1 + round(t * 40 / frames)
        there[t, 20:50, left : left + 8] = True
        there[t, 20:50, 70:80] = True
        pictures[t][there[t]] = rng.integers(0, 256, (int(there[t].sum()), 3))
    # The one who never leaves wears one colour: to statistics alone it is background.
    pictures[:, 20:50, 70:80] = (180, 40, 60)
    return np.clip(np.rint(pictures + rng.normal(0, noise, pictures.shape)), 0, 255).astype(np.uint8), there


def filmed(folder: Path, frames: np.ndarray, seen: Detections | None, fps: float) -> None:
    write_lossless(folder / "a.mkv", iter(frames), fps)
    write_footage(folder / "a.json", footage("a", len(frames)))
    if seen:
        write_detections(folder / "a.npz", seen)


def plate_of(folder: Path, settings: plate_step.Settings, given: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
    """The plate of what was filmed, and where it is measured; with one that was given."""
    if given is not None:
        write_plate(folder / "given.png", given, np.ones(given.shape[:2], bool))
    plate_step.run(
        settings, folder / "a.mkv", folder / "a.json", calibrated(folder), [*folder.glob("a.npz")],
        [*folder.glob("given.png")], folder / "plate.png",
    )  # fmt: skip
    return read_plate(folder / "plate.png")


class TestPlate:
    @pytest.fixture
    def settings(self, default_settings) -> plate_step.Settings:
        return load(plate_step.Settings, default_settings("plates"), "plates")

    def test_a_person_who_passes_leaves_no_trace_and_a_person_who_stays_is_unknown(
        self, settings: plate_step.Settings
    ) -> None:
        background = smooth_pictures(1, seed=4)[0]
        frames, there = passing_block(40, background, 1.5)
        colour, measured = plate_step.temporal_plate(frames, there, settings)
        assert not measured[20:50, 70:80].any()
        assert measured[:, :68].mean() > 0.99
        error = np.abs(colour - background)[measured]
        assert np.median(error) < 0.6
        assert np.percentile(error, 99) < 4

    def test_pictures_that_take_turns_are_undecided(self, settings: plate_step.Settings) -> None:
        frames = np.zeros((20, 8, 8, 3), np.uint8)
        frames[::2] = 200
        _, measured = plate_step.temporal_plate(frames, np.zeros(frames.shape[:3], bool), settings)
        assert not measured.any()

    def test_noise_is_estimated(self) -> None:
        rng = np.random.default_rng(0)
        for sigma in (1.0, 3.0, 6.0):
            frames = np.clip(np.rint(128 + rng.normal(0, sigma, (10, 60, 60, 3))), 0, 255).astype(np.uint8)
            assert noise_levels(frames) == pytest.approx(sigma, rel=0.1)

    def test_detected_people_are_covered(self) -> None:
        keypoints = np.full((1, 17, 3), np.nan)
        keypoints[..., 2] = 0
        named = {
            0: (50, 12),
            5: (56, 20),
            6: (44, 20),
            7: (60, 28),
            9: (62, 36),
            11: (54, 38),
            12: (46, 38),
            13: (54, 48),
            15: (54, 58),
        }
        for k, (x, y) in named.items():
            keypoints[0, k] = (x, y, 0.9)
        detections = Detections("a", "coco17", np.array([3]), np.array([0]), keypoints)
        regions = people_regions(detections, np.arange(8), (64, 96), 0.03, 1)
        assert [bool(r.any()) for r in regions] == [False, False, True, True, True, False, False, False]
        for x, y in named.values():
            assert regions[3, y, x]
        assert regions[3, 30, 50]  # the middle of the torso
        assert regions[3].mean() < 0.2

    def test_a_camera_that_follows_the_light_leaves_no_holes(
        self, tmp_path: Path, settings: plate_step.Settings
    ) -> None:
        background = (30 + 0.6 * smooth_pictures(1, seed=4)[0]).astype(np.uint8)
        frames, there = passing_block(40, background, 1.0)
        swing = 1 + 0.2 * np.sin(np.linspace(0, 2 * np.pi, 40))
        pictures = np.clip(np.rint(frames * swing[:, None, None, None]), 0, 255).astype(np.uint8)
        filmed(tmp_path, pictures, boxed(there), 30)
        rgb, measured = plate_of(tmp_path, settings)
        beside = np.s_[:, :68]
        assert measured[beside].mean() > 0.97
        assert np.median(np.abs(rgb * 255 - background)[beside][measured[beside]]) < 1.5

    def test_a_given_plate_fills_what_the_footage_never_shows(
        self, tmp_path: Path, settings: plate_step.Settings
    ) -> None:
        background = smooth_pictures(1, seed=4)[0]
        frames, there = passing_block(40, background, 1.0)
        filmed(tmp_path, frames, boxed(there), 30)
        # Darker than the footage, and somebody stood at the left when it was taken.
        given = (background * 0.9).astype(np.uint8)
        given[10:30, 5:15] = (250, 250, 0)
        assert not plate_of(tmp_path, settings)[1][25:45, 71:79].any()
        rgb, measured = plate_of(tmp_path, settings, given)
        assert measured[25:45, 71:79].all()
        np.testing.assert_allclose(rgb[25:45, 71:79] * 255, background[25:45, 71:79], atol=12)
        np.testing.assert_allclose(rgb[12:18, 6:14] * 255, background[12:18, 6:14], atol=4)

    def test_a_person_who_sways_undetected_in_front_of_a_given_plate_is_not_painted_into_it(
        self, tmp_path: Path, settings: plate_step.Settings
    ) -> None:
        background = smooth_pictures(1, seed=4)[0]
        pictures = np.repeat(background[None], 40, axis=0)
        for t, picture in enumerate(pictures):
            left = 60 + round(3 * np.sin(t / 4))
            picture[15:55, left : left + 18] = (20, 200, 90)
        filmed(tmp_path, pictures, None, 30)
        given = background.copy()
        given[10:30, 5:20] = (250, 250, 0)  # somebody stood there when the plate was taken
        rgb, measured = plate_of(tmp_path, settings, given)
        assert measured[15:55, 56:82].all()
        np.testing.assert_allclose(rgb[15:55, 56:82] * 255, background[15:55, 56:82], atol=12)
        np.testing.assert_allclose(rgb[12:28, 7:18] * 255, background[12:28, 7:18], atol=4)

    def test_a_person_who_keeps_to_a_spot_and_waves_is_not_painted_into_a_given_plate(
        self, tmp_path: Path, settings: plate_step.Settings
    ) -> None:
        background = smooth_pictures(1, seed=4)[0]
        pictures = np.repeat(background[None], 24, axis=0)
        pictures[:, 10:55, 60:78] = (20, 200, 90)
        for t, picture in enumerate(pictures):
            picture[16:40, 67 + round(5 * np.sin(t)) : 75] = (
                200,
                150,
                120,
            )  # an arm before the chest: it bares no wall
        pictures[:, 35:55, 10:25] = (30, 30, 160)  # a crate that was put there after the plate
        filmed(tmp_path, pictures, None, 12)
        rgb, measured = plate_of(tmp_path, settings, background)
        assert measured[10:55, 58:80].all()
        np.testing.assert_allclose(rgb[10:55, 58:80] * 255, background[10:55, 58:80], atol=12)
        np.testing.assert_allclose(rgb[37:53, 12:23] * 255, np.broadcast_to((30, 30, 160), (16, 11, 3)), atol=4)

    def test_a_plate_of_another_room_is_refused(self, tmp_path: Path, settings: plate_step.Settings) -> None:
        frames, _ = passing_block(20, smooth_pictures(1, seed=4)[0], 1.0)
        filmed(tmp_path, frames, None, 30)
        given = smooth_pictures(1, seed=9)[0]
        with pytest.raises(UserError, match=r"given\.png differs from the footage of camera a by \d+ grey levels"):
            plate_of(tmp_path, settings, given)
        plate_of(tmp_path, settings, frames[0])
        (tmp_path / "given.png").unlink()
        plate_of(tmp_path, settings)


def boxed(there: np.ndarray) -> Detections:
    """Detections whose outline covers the block that never leaves."""
    points = {5: (79, 24), 6: (71, 24), 11: (79, 46), 12: (71, 46), 0: (75, 21)}
    keypoints = np.zeros((len(there), 17, 3))
    keypoints[..., :2] = np.nan
    for k, (x, y) in points.items():
        keypoints[:, k] = (x, y, 1.0)
    return Detections("a", "coco17", np.arange(len(there)), np.zeros(len(there), int), keypoints)
