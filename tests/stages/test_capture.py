# SPDX-License-Identifier: Apache-2.0
"""Capture: what comes in is what goes on, and what cannot be used is named."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from itertools import zip_longest
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from studiorecon.body.presence import people_regions
from studiorecon.capture import frames as frames_step
from studiorecon.capture import manifest as manifest_step
from studiorecon.capture import plate as plate_step
from studiorecon.capture.timeline import clock_of, common_moments, timeline_of
from studiorecon.errors import Refusal
from studiorecon.images.footage import decode, digest, open_source, uneven
from studiorecon.images.plate import noise_levels, write_plate
from studiorecon.images.stills import read_plate
from studiorecon.images.video import read_stack, write_lossless
from studiorecon.scene.camera import Lens
from studiorecon.scene.capture import Footage, read_footage, read_manifest, write_footage
from studiorecon.scene.clocks import as_counted, write_clocks
from studiorecon.scene.files import write_json
from studiorecon.scene.people import Detections, write_detections
from studiorecon.settings import load

WH = (96, 64)


def smooth_pictures(count: int, wh: tuple[int, int] = WH, seed: int = 0) -> np.ndarray:
    """(count, H, W, 3) uint8 soft random colours, all different."""
    rng = np.random.default_rng(seed)
    return np.stack([cv2.resize(rng.integers(0, 256, (4, 6, 3), np.uint8), wh, interpolation=cv2.INTER_CUBIC) for _ in range(count)])


def write_video(path: Path, frames: np.ndarray, fps: int = 30, rotation: int = 0, times: Sequence[int] = ()) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=fps, options={"crf": "8", "g": "5"})
        stream.width, stream.height, stream.pix_fmt = frames.shape[2], frames.shape[1], "yuv420p"
        if rotation:
            stream.set_display_rotation(rotation)
        for frame, time in zip_longest(frames, times):
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame))
            if time is not None:
                picture.pts, picture.time_base = time, Fraction(1, fps)
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return path


def calibrated(folder: Path, wh: tuple[int, int] = WH, distortion: float = 0.0, name: str = "a") -> Path:
    intrinsics = np.array([[80.0, 0, wh[0] / 2], [0, 80, wh[1] / 2], [0, 0, 1]])
    lens = Lens(name, wh, intrinsics, "opencv", np.array([distortion, 0, 0, 0, 0]), np.eye(4), np.eye(2, 3))
    write_json(folder / "calibration.json", {"lenses": [lens.as_json()]})
    return folder / "calibration.json"


@pytest.fixture
def run_frames(default_settings, tmp_path: Path):
    def run(source: Path, first: int = 0, count: int = 0, calibration: Path | None = None, camera: str = "a", **settings) -> Footage:
        options = load(frames_step.Settings, default_settings("capture", **settings), "capture")
        out = tmp_path / "out"
        calibration = calibration or calibrated(tmp_path)
        try:
            clocks = common_moments([clock_of(camera, timeline_of(open_source(source, 30.0)))], first, count)
        except Refusal:
            clocks = as_counted(camera, 30.0, first, count or 1)
        write_clocks(out / "clocks.json", clocks)
        frames_step.run(options, source, calibration, out / "clocks.json", camera, 0, count, out / "a.mkv", out / "a.json")
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

    def test_a_recorder_that_dropped_frames_is_named_and_what_it_lacks_is_shown_from_beside(self, tmp_path: Path, run_frames) -> None:
        """Frames 5 and 6 of the moment are not in the file: the pictures before and after them stand in."""
        shown = [k for k in range(14) if k not in (5, 6)]
        pictures = smooth_pictures(14)
        write_video(tmp_path / "a.mp4", pictures[shown], times=shown)
        footage = run_frames(tmp_path / "a.mp4")
        (told,) = [change for change in footage.changes if "do not come evenly" in change]
        assert "1 of 11 steps differ from the usual 33 ms, most after frame 4 (100 ms)" in told
        assert (footage.frames, footage.source_frames) == (14, (0, 1, 2, 3, 4, 4, 5, 5, 6, 7, 8, 9, 10, 11))
        found = read_stack(tmp_path / "out/a.mkv").astype(int)
        assert [int(np.abs(pictures - f).mean((1, 2, 3)).argmin()) for f in found] == [0, 1, 2, 3, 4, 4, 7, 7, 8, 9, 10, 11, 12, 13]

    def test_the_jitter_of_a_phone_is_no_gap(self) -> None:
        times = np.arange(90) / 30 + np.random.default_rng(0).uniform(-0.004, 0.004, 90)
        assert uneven(times, 0) is None
        assert uneven([], 0) is uneven([0.0], 0) is uneven([1.0, 1.0, 1.0], 0) is None
        assert "1 of 88 steps" in uneven(np.delete(times, 50), 0)

    def test_portrait_footage_is_sized_by_its_longer_side(self) -> None:
        assert frames_step.working_size((1088, 1920), 480) == (272, 480)
        assert frames_step.working_size((1920, 1080), 480) == (480, 270)
        assert frames_step.working_size((320, 240), 480) == (320, 240)
        assert frames_step.working_size((1920, 1080), 0) == (1920, 1080)

    def test_shrinking_averages_and_undistortion_straightens(self, tmp_path: Path, run_frames) -> None:
        fine = np.zeros((128, 192, 3), np.uint8)
        fine[::2] = 200
        write_lossless(tmp_path / "a.mkv", iter([fine]), 24)
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

    def test_missing_file(self, tmp_path: Path, run_frames) -> None:
        with pytest.raises(Refusal, match=r"nowhere\.mp4 is missing; put the video back"):
            run_frames(tmp_path / "nowhere.mp4")

    def test_not_a_video(self, tmp_path: Path, run_frames) -> None:
        (tmp_path / "a.mp4").write_bytes(b"these are not frames" * 100)
        with pytest.raises(Refusal, match=r"a\.mp4 cannot be read as a video.*copy it again"):
            run_frames(tmp_path / "a.mp4")

    def test_a_cut_off_mp4(self, tmp_path: Path, run_frames) -> None:
        whole = write_video(tmp_path / "whole.mp4", smooth_pictures(30)).read_bytes()
        (tmp_path / "a.mp4").write_bytes(whole[: len(whole) // 2])
        with pytest.raises(Refusal, match=r"a\.mp4.*copy it again"):
            run_frames(tmp_path / "a.mp4")

    def test_a_cut_off_recording_and_its_sound_part(self, tmp_path: Path, run_frames) -> None:
        write_lossless(tmp_path / "whole.mkv", iter(smooth_pictures(40)), 30)
        whole = (tmp_path / "whole.mkv").read_bytes()
        (tmp_path / "a.mkv").write_bytes(whole[: int(len(whole) * 0.6)])
        footage = run_frames(tmp_path / "whole.mkv", count=5)
        before = (tmp_path / "out/a.mkv").read_bytes()
        with pytest.raises(Refusal, match=r"a\.mkv.*copy it again.*frames:"):
            run_frames(tmp_path / "a.mkv")
        assert (tmp_path / "out/a.mkv").read_bytes() == before
        assert run_frames(tmp_path / "a.mkv", count=5).frames == footage.frames

    def test_too_few_frames(self, tmp_path: Path, run_frames) -> None:
        write_lossless(tmp_path / "a.mkv", iter(smooth_pictures(5)), 30)
        with pytest.raises(Refusal, match="have 5 frames in common, but frames 3 to 9 were asked for"):
            run_frames(tmp_path / "a.mkv", first=3, count=7)
        with pytest.raises(Refusal, match="have 5 frames in common, but frames 8 and after"):
            run_frames(tmp_path / "a.mkv", first=8)

    def test_another_shape_than_the_calibration(self, tmp_path: Path, run_frames) -> None:
        write_lossless(tmp_path / "a.mkv", iter(smooth_pictures(2, (64, 96))), 30)
        with pytest.raises(Refusal, match=r"96×64.*64×96.*pixel_maps"):
            run_frames(tmp_path / "a.mkv")

    def test_a_camera_without_calibration(self, tmp_path: Path, run_frames) -> None:
        write_lossless(tmp_path / "a.mkv", iter(smooth_pictures(2)), 30)
        with pytest.raises(Refusal, match="has no camera b; it has a"):
            run_frames(tmp_path / "a.mkv", camera="b")

    def test_folders_without_pictures_or_with_broken_ones(self, tmp_path: Path, run_frames) -> None:
        folder = tmp_path / "pictures"
        folder.mkdir()
        with pytest.raises(Refusal, match="holds no pictures"):
            run_frames(folder)
        cv2.imwrite(str(folder / "0.png"), smooth_pictures(1)[0])
        (folder / "1.png").write_bytes(b"")
        with pytest.raises(Refusal, match=r"1\.png is not a readable picture"):
            run_frames(folder)
        cv2.imwrite(str(folder / "1.png"), smooth_pictures(1, (48, 32))[0])
        with pytest.raises(Refusal, match=r"1\.png is 48×32, but the first picture"):
            run_frames(folder)


def footage(camera: str, frames: int = 60, fps: float = 30.0, wh: tuple[int, int] = WH, held_out: bool = False) -> Footage:
    intrinsics = [[80.0, 0, wh[0] / 2], [0, 80, wh[1] / 2], [0, 0, 1]]
    return Footage(camera, held_out, wh, intrinsics, fps, frames, 0, f"videos/{camera}.mp4", "", wh, 0, 0.0, [])


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
        with pytest.raises(Refusal, match=r"b\.mp4 has 58 frames at 30 per second and videos/a\.mp4 60.*run capture\.frames again"):
            run(footage("a"), footage("b", frames=58))


def passing_block(frames: int, background: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """A textured block crosses the left half, another never leaves the right: (T, H, W, 3) pictures, (T, H, W) where they are."""
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


class TestPlate:
    @pytest.fixture
    def settings(self, default_settings) -> plate_step.PlateSettings:
        return load(plate_step.Settings, default_settings("capture"), "capture").plate

    def test_whoever_passes_leaves_no_trace_and_whoever_stays_is_unknown(self, settings: plate_step.PlateSettings) -> None:
        background = smooth_pictures(1, seed=4)[0]
        frames, there = passing_block(40, background, 1.5)
        colour, measured = plate_step.temporal_plate(frames, there, settings)
        assert not measured[20:50, 70:80].any()
        assert measured[:, :68].mean() > 0.99
        error = np.abs(colour - background)[measured]
        assert np.median(error) < 0.6
        assert np.percentile(error, 99) < 4

    def test_pictures_that_take_turns_are_undecided(self, settings: plate_step.PlateSettings) -> None:
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
        named = {0: (50, 12), 5: (56, 20), 6: (44, 20), 7: (60, 28), 9: (62, 36), 11: (54, 38), 12: (46, 38), 13: (54, 48), 15: (54, 58)}
        for k, (x, y) in named.items():
            keypoints[0, k] = (x, y, 0.9)
        detections = Detections("a", "coco17", np.array([3]), np.array([0]), keypoints)
        regions = people_regions(detections, np.arange(8), (64, 96), 0.03, 1)
        assert [bool(r.any()) for r in regions] == [False, False, True, True, True, False, False, False]
        for x, y in named.values():
            assert regions[3, y, x]
        assert regions[3, 30, 50]  # the middle of the torso
        assert regions[3].mean() < 0.2

    def test_a_given_plate_fills_what_the_footage_never_shows(self, tmp_path: Path, default_settings) -> None:
        background = smooth_pictures(1, seed=4)[0]
        frames, there = passing_block(40, background, 1.0)
        write_lossless(tmp_path / "a.mkv", iter(frames), 30)
        write_footage(tmp_path / "a.json", footage("a", 40))
        write_detections(tmp_path / "a.npz", boxed(there))
        # Darker than the footage, and somebody stood at the left when it was taken.
        given = (background * 0.9).astype(np.uint8)
        given[10:30, 5:15] = (250, 250, 0)
        write_plate(tmp_path / "given.png", given, np.ones(given.shape[:2], bool))
        options = load(plate_step.Settings, default_settings("capture"), "capture")
        arguments = options, tmp_path / "a.mkv", tmp_path / "a.json", calibrated(tmp_path), [tmp_path / "a.npz"]
        plate_step.run(*arguments, [], tmp_path / "alone.png")
        assert not read_plate(tmp_path / "alone.png")[1][25:45, 71:79].any()
        plate_step.run(*arguments, [tmp_path / "given.png"], tmp_path / "plate.png")
        rgb, measured = read_plate(tmp_path / "plate.png")
        assert measured[25:45, 71:79].all()
        np.testing.assert_allclose(rgb[25:45, 71:79] * 255, background[25:45, 71:79], atol=12)
        np.testing.assert_allclose(rgb[12:18, 6:14] * 255, background[12:18, 6:14], atol=4)

    def test_whoever_sways_undetected_in_front_of_a_given_plate_is_not_painted_into_it(self, tmp_path: Path, default_settings) -> None:
        background = smooth_pictures(1, seed=4)[0]
        pictures = np.repeat(background[None], 40, axis=0)
        for t, picture in enumerate(pictures):
            left = 60 + round(3 * np.sin(t / 4))
            picture[15:55, left : left + 18] = (20, 200, 90)
        write_lossless(tmp_path / "a.mkv", iter(pictures), 30)
        write_footage(tmp_path / "a.json", footage("a", 40))
        given = background.copy()
        given[10:30, 5:20] = (250, 250, 0)  # somebody stood there when the plate was taken
        write_plate(tmp_path / "given.png", given, np.ones(given.shape[:2], bool))
        options = load(plate_step.Settings, default_settings("capture"), "capture")
        plate_step.run(
            options, tmp_path / "a.mkv", tmp_path / "a.json", calibrated(tmp_path), [], [tmp_path / "given.png"], tmp_path / "plate.png"
        )
        rgb, measured = read_plate(tmp_path / "plate.png")
        assert measured[15:55, 56:82].all()
        np.testing.assert_allclose(rgb[15:55, 56:82] * 255, background[15:55, 56:82], atol=12)
        np.testing.assert_allclose(rgb[12:28, 7:18] * 255, background[12:28, 7:18], atol=4)

    def test_whoever_keeps_to_a_spot_and_waves_is_not_painted_into_a_given_plate(self, tmp_path: Path, default_settings) -> None:
        background = smooth_pictures(1, seed=4)[0]
        pictures = np.repeat(background[None], 24, axis=0)
        pictures[:, 10:55, 60:78] = (20, 200, 90)
        for t, picture in enumerate(pictures):
            picture[16:40, 67 + round(5 * np.sin(t)) : 75] = (200, 150, 120)  # an arm before the chest: it bares no wall
        pictures[:, 35:55, 10:25] = (30, 30, 160)  # a crate that was put there after the plate
        write_lossless(tmp_path / "a.mkv", iter(pictures), 12)
        write_footage(tmp_path / "a.json", footage("a", 24))
        write_plate(tmp_path / "given.png", background, np.ones(background.shape[:2], bool))
        options = load(plate_step.Settings, default_settings("capture"), "capture")
        plate_step.run(
            options, tmp_path / "a.mkv", tmp_path / "a.json", calibrated(tmp_path), [], [tmp_path / "given.png"], tmp_path / "plate.png"
        )
        rgb, measured = read_plate(tmp_path / "plate.png")
        assert measured[10:55, 58:80].all()
        np.testing.assert_allclose(rgb[10:55, 58:80] * 255, background[10:55, 58:80], atol=12)
        np.testing.assert_allclose(rgb[37:53, 12:23] * 255, np.broadcast_to((30, 30, 160), (16, 11, 3)), atol=4)

    def test_a_plate_of_another_room_is_refused(self, tmp_path: Path, default_settings) -> None:
        frames, _ = passing_block(20, smooth_pictures(1, seed=4)[0], 1.0)
        write_lossless(tmp_path / "a.mkv", iter(frames), 30)
        write_footage(tmp_path / "a.json", footage("a", 20))
        write_plate(tmp_path / "given.png", smooth_pictures(1, seed=9)[0], np.ones(WH[::-1], bool))
        options = load(plate_step.Settings, default_settings("capture"), "capture")
        with pytest.raises(Refusal, match=r"given\.png differs from the footage of camera a by \d+ grey levels"):
            plate_step.run(
                options, tmp_path / "a.mkv", tmp_path / "a.json", calibrated(tmp_path), [], [tmp_path / "given.png"], tmp_path / "plate.png"
            )


def boxed(there: np.ndarray) -> Detections:
    """Detections whose outline covers the block that never leaves."""
    points = {5: (79, 24), 6: (71, 24), 11: (79, 46), 12: (71, 46), 0: (75, 21)}
    keypoints = np.zeros((len(there), 17, 3))
    keypoints[..., :2] = np.nan
    for k, (x, y) in points.items():
        keypoints[:, k] = (x, y, 1.0)
    return Detections("a", "coco17", np.arange(len(there)), np.zeros(len(there), int), keypoints)
