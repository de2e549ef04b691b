# SPDX-License-Identifier: Apache-2.0
"""One thing about one camera, or about all lengths, was mixed up: it is named, with what was probably mixed up."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from studiorecon.calibration import doctor
from studiorecon.cameras import refine
from studiorecon.errors import UserError
from studiorecon.geometry import rotations
from studiorecon.rig.outlier_camera import find_outlier_camera
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

from tests.made.cameras import LIMITS, detect, ring, walk

FRAMES = 60
Rig = tuple[list[Camera], list[Detections]]


def capture(count: int = 4, seed: int = 0) -> Rig:
    """Cameras on an uneven ring, and two people who walk in it."""
    rng = np.random.default_rng(seed)
    cameras = [
        replace(c, camera_from_world=c.camera_from_world @ _turned(rng.uniform(-8, 8))) for c in ring(count, 5.0, 1.6)
    ]
    people = [
        walk(np.array([-0.6, -0.4, 0]), np.array([0.02, 0.012, 0]), FRAMES),
        walk(np.array([0.7, 0.5, 0]), np.array([-0.012, -0.02, 0]), FRAMES, 1.0),
    ]
    return cameras, detect(cameras, people, 1.5, rng)


def _turned(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def decided(rig: Rig) -> refine.Refinement:
    cameras, detections = rig
    return refine.decide(cameras, [], detections, FRAMES, 30.0, True, refine.Settings())


def with_lens(rig: Rig, factor: float) -> Rig:
    cameras, detections = rig
    intrinsics = cameras[1].intrinsics.copy()
    intrinsics[[0, 1], [0, 1]] *= factor
    return [cameras[0], replace(cameras[1], intrinsics=intrinsics), *cameras[2:]], detections


def with_pose(rig: Rig, change: Callable[[np.ndarray], np.ndarray], which: tuple[int, ...] = (1,)) -> Rig:
    cameras, detections = rig
    return [
        replace(c, camera_from_world=change(c.camera_from_world)) if i in which else c for i, c in enumerate(cameras)
    ], detections


def with_pixels(rig: Rig, change: Callable[[np.ndarray], np.ndarray]) -> Rig:
    """The pixels (..., 2) of camera 1 changed."""
    cameras, detections = rig
    keypoints = detections[1].keypoints.copy()
    keypoints[..., :2] = change(keypoints[..., :2])
    return cameras, [detections[0], replace(detections[1], keypoints=keypoints), *detections[2:]]


def of_another(rig: Rig) -> Rig:
    cameras, detections = rig
    return cameras, [detections[0], replace(detections[2], camera="c1"), *detections[2:]]


def later(rig: Rig, frames: int) -> Rig:
    cameras, detections = rig
    return cameras, [detections[0], replace(detections[1], frame=detections[1].frame + frames), *detections[2:]]


def scaled(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(pose: np.ndarray) -> np.ndarray:
        changed = pose.copy()
        changed[:3, 3] *= factor
        return changed

    return change


MIXED_UP: dict[str, tuple[Callable[[Rig], Rig], str]] = {
    "focal length in millimetres": (lambda rig: with_lens(rig, 0.036), r"its focal length were about \d+ px"),
    "focal length of half the picture": (lambda rig: with_lens(rig, 0.5), r"its focal length were about (9|10)\d\d px"),
    "focal length twice": (lambda rig: with_lens(rig, 2.0), r"its focal length were about (9|10)\d\d px"),
    "pose in centimetres": (lambda rig: with_pose(rig, scaled(100.0)), "its pose in the calibration were in centi"),
    "pose in inches": (lambda rig: with_pose(rig, scaled(39.37)), "its pose in the calibration were in inches"),
    "pose the other way round": (lambda rig: with_pose(rig, np.linalg.inv), "were world-from-camera"),
    "pose with OpenGL's axes": (
        lambda rig: with_pose(rig, lambda pose: np.diag([1.0, -1, -1, 1]) @ pose),
        "had OpenGL's axes",
    ),
    "mirrored keypoints": (lambda rig: with_pixels(rig, lambda p: [1280, 0] + p * [-1, 1]), "keypoints were mirrored"),
    "picture on its head": (lambda rig: with_pixels(rig, lambda p: [1280, 704] - p), "of the picture turned by 180°"),
    "keypoints counted from the bottom": (
        lambda rig: with_pixels(rig, lambda p: [0, 704] + p * [1, -1]),
        "upside down, counted from the bottom",
    ),
    "keypoints in the order y, x": (lambda rig: with_pixels(rig, lambda p: p[..., ::-1]), "in the order y, x"),
    "keypoints of a letterboxed picture": (
        lambda rig: with_pixels(rig, lambda p: p / 2 + [0, 144]),
        "letterboxed to 640×640",
    ),
    "keypoints of half the size": (lambda rig: with_pixels(rig, lambda p: p / 2), "in pixels of a 640×352 picture"),
    "keypoints of twice the size": (lambda rig: with_pixels(rig, lambda p: p * 2), "in pixels of a 2560×1408 picture"),
    "keypoints 5000 px off": (
        lambda rig: with_pixels(rig, lambda p: p + np.array([5000, 0])),
        "were -5000 px further right",
    ),
    "keypoints of a cropped picture": (lambda rig: with_pixels(rig, lambda p: p - [320, 90]), "320 px further right"),
    "keypoints of another camera": (of_another, "they were those of c2"),
    "twenty frames late": (lambda rig: later(rig, 20), r"its frames were numbered about (18|19|20|21|22) lower"),
}


@pytest.mark.parametrize("case", MIXED_UP)
def test_the_camera_is_named_with_what_was_mixed_up(case: str) -> None:
    change, cause = MIXED_UP[case]
    with pytest.raises(UserError, match=f"camera c1 disagrees with all others: .*{cause}"):
        decided(change(capture()))


def test_an_unknown_cause_names_the_camera_all_the_same() -> None:
    rng = np.random.default_rng(1)
    nonsense = with_pixels(capture(), lambda p: p + rng.normal(0, 300, (len(p), 1, 2)))
    with pytest.raises(UserError, match=re.escape("or leave it out (train: [c0, c2, c3] in capture.yaml)")):
        decided(nonsense)


def yawed(degrees: float) -> Callable[[np.ndarray], np.ndarray]:
    """A camera that was turned about its own axis down."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])
    return lambda pose: turn @ pose


@pytest.mark.parametrize("degrees", [5.0, -8.0])
def test_a_camera_that_was_knocked_is_put_right_and_not_taken_for_a_cropped_picture(degrees: float) -> None:
    truth, detections = capture()
    assert (
        find_outlier_camera(*with_pose((truth, detections), yawed(degrees)), np.arange(FRAMES), 0.25, LIMITS)
        is not None
    )
    found = decided(with_pose((truth, detections), yawed(degrees)))
    assert found.report["moved_cameras"]
    turned = [
        np.degrees(rotations.angle(f.camera_from_world[:3, :3], t.camera_from_world[:3, :3]))
        for f, t in zip(found.training, truth)
    ]
    assert max(turned) < 0.5


def test_a_camera_that_was_turned_away_is_named_with_both_that_it_may_be() -> None:
    with pytest.raises(
        UserError, match=r"camera c1 .*in an uncropped picture, or by a camera that has not been turned by (19|2.)°"
    ):
        decided(with_pose(capture(), yawed(20.0)))


@pytest.mark.parametrize("case", ["focal length twice", "mirrored keypoints", "keypoints of another camera"])
def test_the_doctor_says_it_first(case: str) -> None:
    change, cause = MIXED_UP[case]
    cameras, detections = change(capture())
    about = [
        {"camera": c.name, "wh": list(c.wh), "frames": FRAMES, "first_frame": 0.0, "fps": 30.0, "video_frames": FRAMES}
        | {"rotation_deg": 0, "keypoints": True, "brightness": 0.5, "burnt": 0.0}
        for c in cameras
    ]
    report, _ = doctor.examine(cameras, detections, about, doctor.Settings())
    assert report["verdict"] == "wrong"
    assert re.match(f"camera c1 disagrees with all others: .*{cause}", report["advice"][0])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("count", [3, 4, 5])
def test_nobody_is_named_where_nothing_was_mixed_up(count: int, seed: int) -> None:
    cameras, detections = capture(count, seed)
    assert find_outlier_camera(cameras, detections, np.arange(FRAMES), 0.25, LIMITS) is None
    assert decided((cameras, detections)).report["stature_m"] == pytest.approx(1.65, abs=0.15)


def test_near_cameras_that_mark_another_side_of_a_body_are_not_named() -> None:
    """Seen from 1.1 m, points of a shoulder that are 8 cm apart are 6 % of the picture apart."""
    cameras = ring(4, 1.1, 1.2)
    person = walk(np.zeros(3), np.array([0.002, 0.001, 0]), FRAMES)
    detections = detect(cameras, [person], 1.5, np.random.default_rng(0))
    along = 0.08 * cameras[1].rotation_camera_from_world[0] * np.array([1.0, -1.0] * 6)[:, None]
    (other_side,) = detect(cameras[1:2], [person + along], 1.5, np.random.default_rng(1))
    rig = cameras, [detections[0], other_side, *detections[2:]]
    assert find_outlier_camera(*rig, np.arange(FRAMES), 0.25, LIMITS) is None
    named = find_outlier_camera(*with_pixels(rig, lambda p: [1280, 0] + p * [-1, 1]), np.arange(FRAMES), 0.25, LIMITS)
    assert named is not None
    assert "mirrored" in named.cause


def test_a_camera_that_sees_others_than_everybody_else_is_not_named() -> None:
    """Its picture shows another corner: nobody contradicts it."""
    cameras, detections = capture()
    away = cameras[1].camera_from_world @ np.linalg.inv(_turned(180.0))
    there = replace(cameras[1], camera_from_world=away)
    (elsewhere,) = detect(
        [there], [walk(there.centre_m * 2 * [1, 1, 0], np.zeros(3), FRAMES)], 1.0, np.random.default_rng(0)
    )
    rig = [cameras[0], there, *cameras[2:]], [detections[0], elsewhere, *detections[2:]]
    assert find_outlier_camera(*rig, np.arange(FRAMES), 0.25, LIMITS) is None


@pytest.mark.parametrize(
    ("factor", "unit"), [(100.0, "centimetres"), (1000.0, "millimetres"), (39.3701, "inches"), (3.28084, "feet")]
)
def test_lengths_of_another_unit_are_named(factor: float, unit: str) -> None:
    rig = with_pose(capture(), scaled(factor), (0, 1, 2, 3))
    with pytest.raises(
        UserError, match=f"not metres but, it seems, {unit}; multiply calibration.scale by {1 / factor:.4g}"
    ):
        decided(rig)


def test_centimetres_that_were_taken_for_millimetres_are_named_with_the_setting() -> None:
    with pytest.raises(UserError, match=r"calibration\.unit: cm, or multiply calibration\.scale by 10,"):
        decided(with_pose(capture(), scaled(0.1), (0, 1, 2, 3)))


def test_lengths_that_no_unit_explains_are_refused_too() -> None:
    with pytest.raises(
        UserError, match=r"people would be 0\.2\d+ m tall by this calibration.*makes people 1\.70 m tall"
    ):
        decided(with_pose(capture(), scaled(0.16), (0, 1, 2, 3)))


@pytest.mark.parametrize("stature", [0.55, 1.35])
def test_children_and_giants_are_people(stature: float) -> None:
    """0.9 m and 2.2 m tall."""
    rng = np.random.default_rng(0)
    cameras = capture()[0]
    people = [stature * walk(np.array([-0.6, -0.4, 0]), np.array([0.02, 0.012, 0]), FRAMES)]
    report = decided((cameras, detect(cameras, people, 1.5, rng))).report
    assert report["stature_m"] == pytest.approx(1.65 * stature, rel=0.1)


def test_of_three_cameras_the_odd_one_is_reported_at_least(capsys: pytest.CaptureFixture[str]) -> None:
    """Two rays always meet somewhere: three cameras rarely say which of them is wrong, but never nothing."""
    for change in (lambda p: p + np.array([5000, 0]), lambda p: [1280, 704] - p, lambda p: p / 2):
        try:
            decided(with_pixels(capture(3), change))
        except UserError:
            continue  # which tells it too
        assert re.search("warning: (camera c|where two cameras agree)", capsys.readouterr().out)
