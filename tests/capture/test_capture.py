# SPDX-License-Identifier: Apache-2.0
"""Capture: what comes in is what goes on, and what cannot be used is named."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.capture import frames as frames_step
from studiorecon.capture import manifest as manifest_step
from studiorecon.clocks.timeline import clock_as_filmed, common_moments, read_timeline
from studiorecon.configuration.settings import load
from studiorecon.errors import UserError
from studiorecon.footage.frames import decode
from studiorecon.footage.source import digest, open_source, timing_irregularities
from studiorecon.footage.video import read_frame, read_stack, write_lossless
from studiorecon.scene.capture import Footage, read_footage, read_manifest, write_footage
from studiorecon.scene.clocks import write_clocks

from tests.made.footage import WH, as_counted, calibrated, footage, smooth_pictures, write_video


@pytest.fixture
def run_frames(default_settings, tmp_path: Path):
    def run(
        source: Path, first: int = 0, count: int = 0, calibration: Path | None = None, camera: str = "a", **settings
    ) -> Footage:
        options = load(frames_step.Settings, default_settings("capture", **settings), "capture")
        out = tmp_path / "out"
        calibration = calibration or calibrated(tmp_path)
        try:
            clocks = common_moments([clock_as_filmed(camera, read_timeline(open_source(source, 30.0)))], first, count)
        except UserError:
            clocks = as_counted(camera, 30.0, first, count or 1)
        write_clocks(out / "clocks.json", clocks)
        frames_step.run(
            options, source, calibration, out / "clocks.json", camera, 0, count, out / "a.mkv", out / "a.json"
        )
        return read_footage(out / "a.json")

    return run


class TestFrames:
    def test_a_pinhole_video_of_working_size_passes_unchanged(self, tmp_path: Path, run_frames) -> None:
        frames = smooth_pictures(6)
        write_lossless(tmp_path / "a.mkv", iter(frames), 24)
        footage = run_frames(tmp_path / "a.mkv")
        np.testing.assert_array_equal(read_stack(tmp_path / "out/a.mkv"), frames)
        assert (footage.frames, footage.fps, footage.wh, footage.changes) == (6, 24.0, WH, [])

    def test_the_chosen_frames_are_taken(self, tmp_path: Path, run_frames) -> None:
        frames = smooth_pictures(9)
        write_lossless(tmp_path / "a.mkv", iter(frames), 24)
        footage = run_frames(tmp_path / "a.mkv", first=2, count=4)
        np.testing.assert_array_equal(read_stack(tmp_path / "out/a.mkv"), frames[2:6])
        assert (footage.first_source_frame, footage.frames) == (2, 4)

    @pytest.mark.parametrize("rotation", [90, 180, -90])
    def test_the_rotation_tag_is_applied(self, tmp_path: Path, rotation: int) -> None:
        frames = smooth_pictures(3)
        source = open_source(write_video(tmp_path / "a.mp4", frames, rotation=rotation), 30)
        upright = np.rot90(frames[1], rotation // 90)
        assert source.wh == (upright.shape[1], upright.shape[0])
        np.testing.assert_allclose(next(decode(source, 1, 1)).astype(int), upright.astype(int), atol=30)

    def test_a_recorder_that_dropped_frames_is_named_and_what_it_lacks_is_shown_from_beside(
        self, tmp_path: Path, run_frames
    ) -> None:
        """Frames 5 and 6 of the moment are not in the file: the pictures before and after them stand in."""
        shown = [k for k in range(14) if k not in (5, 6)]
        pictures = smooth_pictures(14)
        write_video(tmp_path / "a.mp4", pictures[shown], times=shown)
        footage = run_frames(tmp_path / "a.mp4")
        (reported,) = [change for change in footage.changes if "do not come evenly" in change]
        assert "1 of 11 steps differ from the usual 33 ms, most after frame 4 (100 ms)" in reported
        assert (footage.frames, footage.source_frames) == (14, (0, 1, 2, 3, 4, 4, 5, 5, 6, 7, 8, 9, 10, 11))
        found = read_stack(tmp_path / "out/a.mkv").astype(int)
        assert [int(np.abs(pictures - f).mean((1, 2, 3)).argmin()) for f in found] == [
            0,
            1,
            2,
            3,
            4,
            4,
            7,
            7,
            8,
            9,
            10,
            11,
            12,
            13,
        ]

    def test_the_jitter_of_a_phone_is_no_gap(self) -> None:
        times = np.arange(90) / 30 + np.random.default_rng(0).uniform(-0.004, 0.004, 90)
        assert timing_irregularities(times, 0) is None
        assert (
            timing_irregularities([], 0)
            is timing_irregularities([0.0], 0)
            is timing_irregularities([1.0, 1.0, 1.0], 0)
            is None
        )
        assert "1 of 88 steps" in timing_irregularities(np.delete(times, 50), 0)

    def test_portrait_footage_is_sized_by_its_longer_side(self) -> None:
        assert frames_step.working_size((1088, 1920), 480) == (272, 480)
        assert frames_step.working_size((1920, 1080), 480) == (480, 270)
        assert frames_step.working_size((320, 240), 480) == (320, 240)
        assert frames_step.working_size((1920, 1080), 0) == (1920, 1080)

    def test_shrinking_averages_and_undistortion_straightens(self, tmp_path: Path, run_frames) -> None:
        fine = np.zeros((128, 192, 3), np.uint8)
        fine[::2] = 200
        write_lossless(tmp_path / "a.mkv", iter([fine, fine]), 24)
        footage = run_frames(tmp_path / "a.mkv", width=48)
        assert footage.wh == (48, 32)
        inner = read_stack(tmp_path / "out/a.mkv")[0, 4:-4, 4:-4]
        np.testing.assert_allclose(inner, 100, atol=12)  # aliasing would give 0 or 200
        footage = run_frames(tmp_path / "a.mkv", calibration=calibrated(tmp_path, distortion=-0.1))
        assert any("distortion removed" in c for c in footage.changes)

    def test_a_folder_of_pictures_counts_by_number(self, tmp_path: Path, run_frames) -> None:
        frames = smooth_pictures(11)
        (tmp_path / "pictures").mkdir()
        for number, frame in enumerate(frames):
            cv2.imwrite(str(tmp_path / "pictures" / f"f{number}.png"), frame[..., ::-1])
        footage = run_frames(tmp_path / "pictures")
        np.testing.assert_array_equal(read_stack(tmp_path / "out/a.mkv"), frames)
        assert footage.fps == 30.0
        assert digest(open_source(tmp_path / "pictures", 30)) == footage.source_sha256


class TestRefusals:
    """Every unusable input is one sentence with file and remedy, and leaves finished results alone."""

    def test_of_a_cut_off_recording_the_sound_part_is_used(self, tmp_path: Path, run_frames) -> None:
        write_lossless(tmp_path / "whole.mkv", iter(smooth_pictures(40)), 30)
        whole = (tmp_path / "whole.mkv").read_bytes()
        (tmp_path / "a.mkv").write_bytes(whole[: int(len(whole) * 0.6)])
        run_frames(tmp_path / "whole.mkv")
        pictures = read_stack(tmp_path / "out/a.mkv")
        footage = run_frames(tmp_path / "a.mkv")
        assert 10 < footage.frames < 40
        np.testing.assert_array_equal(read_stack(tmp_path / "out/a.mkv"), pictures[: footage.frames])
        assert any("40 frames are announced" in change for change in footage.changes)

    def test_too_few_frames(self, tmp_path: Path, run_frames) -> None:
        write_lossless(tmp_path / "a.mkv", iter(smooth_pictures(5)), 30)
        with pytest.raises(UserError, match=r"have 5 frames in common, but capture\.yaml requests frames 3 to 9"):
            run_frames(tmp_path / "a.mkv", first=3, count=7)
        with pytest.raises(UserError, match=r"have 5 frames in common, but capture\.yaml requests frames 8 and after"):
            run_frames(tmp_path / "a.mkv", first=8)

    def test_another_shape_than_the_calibration(self, tmp_path: Path, run_frames) -> None:
        write_lossless(tmp_path / "a.mkv", iter(smooth_pictures(2, (64, 96))), 30)
        with pytest.raises(UserError, match=r"96×64.*64×96.*pixel_maps"):
            run_frames(tmp_path / "a.mkv")

    def test_a_camera_without_calibration(self, tmp_path: Path, run_frames) -> None:
        write_lossless(tmp_path / "a.mkv", iter(smooth_pictures(2)), 30)
        with pytest.raises(UserError, match="has no camera b, but a"):
            run_frames(tmp_path / "a.mkv", camera="b")


class TestBetweenSteps:
    """Working videos that are not what capture made are named by whoever reads them."""

    @pytest.fixture
    def captured(self, default_settings, tmp_path: Path) -> Path:
        """Two cameras of one size, length and rate."""
        options, out = load(frames_step.Settings, default_settings("capture"), "capture"), tmp_path / "capture"
        for camera, shift in (("a", 0), ("b", 5)):
            source = tmp_path / f"{camera}.mkv"
            write_lossless(source, iter(smooth_pictures(25)[shift : shift + 20]), 24)
            clock = clock_as_filmed(camera, read_timeline(open_source(source, 30.0)))
            write_clocks(tmp_path / "clocks.json", common_moments([clock], 0, 0))
            frames_step.run(
                options,
                source,
                calibrated(tmp_path, name=camera),
                tmp_path / "clocks.json",
                camera,
                0,
                0,
                out / f"{camera}.mkv",
                out / f"{camera}.json",
            )
        return out

    @pytest.mark.parametrize("damage", ["exchanged", "cut", "shorter", "size", "rate"])
    def test_a_video_that_capture_did_not_make_is_named(self, damage: str, captured: Path) -> None:
        video = captured / "a.mkv"
        assert len(read_stack(video)) == 20
        whole, pictures = video.read_bytes(), smooth_pictures(20)
        if damage == "exchanged":
            (captured / "b.mkv").replace(video)
        elif damage == "cut":
            video.write_bytes(whole[: len(whole) // 2])
        elif damage == "shorter":
            write_lossless(video, iter(pictures[:15]), 24)
        elif damage == "size":
            write_lossless(video, iter(pictures[:, :32, :48]), 24)
        else:
            write_lossless(video, iter(pictures), 25)
        for read in (read_stack, lambda path: read_frame(path, 19)):
            with pytest.raises(UserError, match=r"a\.mkv .*delete it, and the next run makes it again"):
                read(video)


class TestManifest:
    @pytest.fixture
    def run(self, tmp_path: Path):
        def run(*cameras: Footage):
            for camera in cameras:
                write_footage(tmp_path / f"{camera.camera}.json", camera)
            paths = [tmp_path / f"{camera.camera}.json" for camera in cameras]
            manifest_step.run("scene", paths, tmp_path / "manifest.json")
            return read_manifest(tmp_path / "manifest.json")

        return run

    def test_cameras_keep_their_order_and_role(self, run) -> None:
        manifest = run(footage("b"), footage("a", held_out=True))
        assert [f.camera for f in manifest.footage] == ["b", "a"]
        assert ([f.camera for f in manifest.training], [f.camera for f in manifest.held_out]) == (["b"], ["a"])

    def test_footage_of_two_lengths_was_decoded_by_two_clocks(self, run) -> None:
        with pytest.raises(UserError, match=r"b\.json .*it has 58 frames at 30 per second.*delete it"):
            run(footage("a"), footage("b", frames=58))
