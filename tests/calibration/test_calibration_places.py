# SPDX-License-Identifier: Apache-2.0
"""Where films lie in the calibrated picture: black bars, films that are already undistorted, and a real take of both
kinds of pixels."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from studiorecon.calibration.choose import choose_lenses
from studiorecon.calibration.files import Settings, read_calibration
from studiorecon.calibration.formats.reading import Reading
from studiorecon.camera_files.raw_camera import RawCamera
from studiorecon.footage.frames import seek_frames
from studiorecon.footage.source import open_source
from studiorecon.geometry.crop_hypotheses import area_inside_bars
from studiorecon.geometry.distortion import distort
from studiorecon.geometry.lens import calibration_from_video
from studiorecon.keypoints.detections import to_pinhole
from studiorecon.keypoints.motion import SMALL_PX, Motion, measure_motion
from studiorecon.keypoints.numbering import possible_numberings
from studiorecon.keypoints.readers import read_keypoints
from studiorecon.rig.lens_model import reinterpret_lens
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.people import Detections
from studiorecon.scene.schema import record

from tests.made.cameras import detect, walk
from tests.made.readings import PEOPLE, reading, rig


def test_black_bars_are_found_in_bright_and_dark_pictures():
    pictures = [np.full((60, 80, 3), level, np.uint8) for level in (5, 90, 200)]
    assert area_inside_bars(pictures).tolist() == [0, 0, 80, 60]
    for picture in pictures:
        picture[:7] = picture[54:] = 9
    assert area_inside_bars(pictures).tolist() == [0, 7, 80, 54]
    assert area_inside_bars(pictures[:1]).tolist() == [0, 0, 80, 60]


@pytest.mark.parametrize("in_calibration", [False, True])
@pytest.mark.parametrize(
    ("film_wh", "scale", "offset"),
    [
        (
            (1080, 1920),
            1080 / 1088,
            (0.0, (1920 - 1920 * 1080 / 1088) / 2),
        ),
        ((1920, 1920), 1.0, (416.0, 0.0)),
    ],
)
def test_black_bars_place_a_film_and_people_tell_whose_pixels_keypoints_are_in(film_wh, scale, offset, in_calibration):
    cameras, names = rig(("a", "b", "c", "d"), (1088, 1920)), list("abcd")
    seen = detect(cameras, PEOPLE, 0.3, np.random.default_rng(0))
    recorded = seen if in_calibration else [_placed_at(d, scale, offset) for d in seen]
    size = np.array([1088, 1920]) * scale
    area = np.array([*offset, *(offset + size)]).round()
    found = choose_lenses(
        reading(cameras),
        "x.toml",
        names,
        [film_wh] * 4,
        recorded,
        {},
        Settings(unit="m", up="z"),
        areas=dict.fromkeys(names, area),
        recorded=names,
    )
    for lens in found.lenses:
        back = lens.calibration_from_video @ [*(np.array(offset) + 100 * scale), 1.0]
        assert np.allclose(back, 100, atol=1.0)
        assert lens.keypoints_calibrated == in_calibration
        pixels = to_pinhole(recorded[0], found.lenses[0], film_wh)[1].keypoints
        there = pixels[..., 2] > 0
        assert np.allclose(pixels[there], _placed_at(seen[0], scale, offset).keypoints[there], atol=1.0)
    assert sum("as people show" in note for note in found.notes) == 4


def _placed_at(seen: Detections, scale: float, offset: tuple[float, float]) -> Detections:
    return replace(seen, keypoints=seen.keypoints * [scale, scale, 1] + [*offset, 0])


WIDE = np.array([-0.35, 0.12, 0, 0, 0, 0, 0, 0])


@pytest.mark.parametrize("with_films", [False, True])
@pytest.mark.parametrize("straight_keypoints", [False, True])
@pytest.mark.parametrize("straight_films", [False, True])
def test_people_and_motion_show_what_was_already_undistorted(straight_keypoints, straight_films, with_films):
    cameras, names = rig(("a", "b", "c", "d")), list("abcd")
    raw = [RawCamera(c.name, c.wh, c.intrinsics, "opencv", WIDE, c.camera_from_world) for c in cameras]
    # A lens bends most near the edges, so these people walk there.
    walkers = [walk([-1.6, -1.0, 0], [0.05, 0.02, 0], 24), walk([1.4, 1.3, 0], [0.01, -0.08, 0], 24, 2.0)]
    straight = detect(cameras, walkers, 0.5, np.random.default_rng(0))
    bent = [_bent(d, c, WIDE) for d, c in zip(straight, cameras)]
    seen = straight if straight_keypoints else bent
    filmed = straight if straight_films else bent
    motions = {c.name: _motion_of(d, c.wh) for c, d in zip(cameras, filmed)} if with_films else {}

    def found(**how):
        options = Settings(unit="m", up="z", **how)
        reading_ = Reading("t", tuple(raw), "m", ())
        return choose_lenses(reading_, "x", names, [c.wh for c in cameras], seen, {}, options, motions=lambda: motions)

    chosen = found()
    # Without a film of their own, keypoints are taken for the film's.
    films_are_straight = straight_films if with_films else straight_keypoints
    for lens, camera, own in zip(chosen.lenses, cameras, seen):
        assert (lens.distortion == 0).all() == films_are_straight
        assert (lens.of_keypoints.distortion == 0).all() == straight_keypoints
        same = to_pinhole(own, lens, camera.wh)[1].keypoints
        np.testing.assert_allclose(same, to_pinhole(own, lens.of_keypoints, camera.wh)[1].keypoints)
        read = record(Lens, json.loads(json.dumps(lens.as_json(), default=list)))
        np.testing.assert_array_equal(read.of_keypoints.distortion, lens.of_keypoints.distortion)
        # The doctor tries the other model too.
        assert (
            reinterpret_lens(lens, "fisheye").of_keypoints.distortion.tolist()
            == lens.of_keypoints.distortion[:4].tolist()
        )
    assert any("already undistorted" in note for note in chosen.notes) == (straight_keypoints or films_are_straight)
    # The remedy in that sentence.
    assert all((lens.of_keypoints.distortion == WIDE).all() for lens in found(lens="opencv").lenses)


def _motion_of(seen: Detections, wh: tuple[int, int]) -> Motion:
    """The motion of a film in which lines between people's joints move."""
    frames = np.unique(seen.frame)
    scale = SMALL_PX / max(wh)
    pictures = np.full((len(frames), round(wh[1] * scale), round(wh[0] * scale), 3), 90, np.uint8)
    for picture, frame in zip(pictures, frames):
        for body in seen.keypoints[seen.frame == frame]:
            joints = (body[body[:, 2] > 0, :2] * scale).round().astype(int)
            for joint in joints.tolist():
                cv2.circle(picture, joint, 3, (220, 220, 220), -1)
    return measure_motion(frames.tolist(), list(pictures), wh)


def _bent(seen: Detections, camera: Camera, distortion: np.ndarray) -> Detections:
    rays = (seen.keypoints[..., :2] - camera.principal_px) / camera.focal_px
    pixels = distort(rays, "opencv", distortion) * camera.focal_px + camera.principal_px
    return replace(seen, keypoints=np.concatenate([pixels, seen.keypoints[..., 2:]], -1))


def test_films_of_a_real_take_that_were_scaled_and_padded_are_placed(real_data):
    """Two of four films are scaled by 0.993 between bars of 7 pixels, and the keypoints are in calibrated pixels."""
    take, names = real_data / "pose2sim_balancing", ["cam01", "cam02", "cam03", "cam04"]
    films = [open_source(take / f"single/videos/{name}.mp4", 30.0) for name in names]
    areas = {name: area_inside_bars(seek_frames(film, [0, 50, 99])) for name, film in zip(names[:2], films)}
    people = []
    for name, film in zip(names, films, strict=True):
        own = read_keypoints(take / "pose2d_body25b_single" / name, film.wh)
        usual = possible_numberings(own.pictures, film.frames, film.fps, None, own.counted).possible[0]
        own = own.renumbered(usual.frame_of, film.frames)
        people.append(Detections(name, "body_25b", own.frame, np.zeros_like(own.frame), own.keypoints))
    found = choose_lenses(
        read_calibration([take / "calibration/Calib_scene.toml"]),
        "Calib_scene.toml",
        names,
        [film.wh for film in films],
        people,
        {},
        Settings(),
        areas=areas,
        recorded=names,
    )
    measured = json.loads((take / "derived/video_to_calibration_pixels.json").read_text())["single"]
    for lens in found.lenses:
        wanted = calibration_from_video([measured[lens.name][key] for key in ("s", "tx", "ty")])
        assert np.abs(lens.calibration_from_video @ [540, 960, 1] - wanted @ [540, 960, 1]).max() < 0.5
        assert lens.keypoints_calibrated == (lens.name in names[:2])
