# SPDX-License-Identifier: Apache-2.0
"""What a calibration leaves open is decided by people: which camera is which film, and where the film's pixels lie."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.calibration.choose import choose_lenses
from studiorecon.calibration.files import Settings
from studiorecon.calibration.known_lenses import ideal_pinhole, lens_at_pose, undistort_detections
from studiorecon.calibration.names import pairings
from studiorecon.errors import UserError
from studiorecon.geometry.crop_hypotheses import crop_hypotheses, rotate_lens_90
from studiorecon.geometry.distortion import distort
from studiorecon.geometry.lens import (
    normalised_from_calibration,
    rayless_share,
    video_from_working,
    working_view,
)
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.people import Detections

from tests.made.cameras import detect
from tests.made.readings import PEOPLE, people, reading, rig


def decided(calibrated: list[Camera], names: list[str], sizes, seen) -> tuple[list[Lens], list[str]]:
    found = choose_lenses(reading(calibrated), "x.toml", names, sizes, seen, {}, Settings(unit="m", up="z"))
    return found.lenses, found.notes


@pytest.mark.parametrize(
    ("footage", "calibrated", "expected"),
    [
        (["Walk0003_Miqus_1_26571", "Walk0003_Miqus_2_26572"], ["26572", "26571", "26573"], ["26571", "26572"]),
        (["2024-05-11_take2_cam1", "2024-05-11_take2_cam2"], ["cam1", "cam2"], ["cam1", "cam2"]),
        (["cam1", "cam2", "cam3"], ["cam_0", "cam_1", "cam_2"], ["cam_0", "cam_1", "cam_2"]),
        (["01", "02"], ["int_cam1", "int_cam2"], ["int_cam1", "int_cam2"]),
        (["b", "A"], ["a", "B"], ["B", "a"]),
    ],
)
def test_names_pair_both_ways(footage, calibrated, expected):
    assert list(pairings(footage, calibrated, "x")[0].calibrated.values()) == expected


@pytest.mark.parametrize("first", [0, 1])
def test_cameras_counted_from_0_or_1_are_determined_by_people(first):
    """Three films of a calibration of four: both ways are possible."""
    cameras = rig(("cam_0", "cam_1", "cam_2", "cam_3"))
    filmed, names = cameras[first : first + 3], ["film1", "film2", "film3"]
    lenses, notes = decided(cameras, names, [c.wh for c in filmed], people(filmed, names))
    assert all(np.allclose(a.camera_from_world, b.camera_from_world) for a, b in zip(lenses, filmed))
    assert any("people show" in note for note in notes)


def test_names_that_say_nothing_are_paired_by_people_or_refused():
    cameras, names = rig(("A", "B", "C", "D")), ["front", "left", "back", "right"]
    filmed = [cameras[i] for i in (2, 0, 3, 1)]
    lenses, _ = decided(cameras, names, [c.wh for c in filmed], people(filmed, names))
    assert all(np.allclose(a.camera_from_world, b.camera_from_world) for a, b in zip(lenses, filmed))
    with pytest.raises(UserError, match=r"for other cameras.*rename the videos"):
        decided(
            cameras,
            names,
            [c.wh for c in filmed],
            [d.only(np.zeros(len(d.frame), bool)) for d in people(filmed, names)],
        )
    # The remedy: films that are called as the calibration calls them.
    nobody = [d.only(np.zeros(len(d.frame), bool)) for d in people(cameras, list("ABCD"))]
    assert [lens.name for lens in decided(cameras, list("ABCD"), [c.wh for c in cameras], nobody)[0]] == list("ABCD")


def shifted(seen: list[Detections], offset: tuple[float, float]) -> list[Detections]:
    return [replace(d, keypoints=d.keypoints - np.array([*offset, 0.0])) for d in seen]


@pytest.mark.parametrize("centred", [False, True])
def test_padding_is_placed_by_people(centred):
    """A calibration of 1088 lines and films of 1080: the lines are missing below, or on both sides."""
    cameras, names = rig(("a", "b", "c", "d"), (1920, 1088)), list("abcd")
    cameras = [
        replace(c, intrinsics=c.intrinsics @ np.diag([1.4, 1.4, 1]) + [[0, 0, 64], [0, 0, 51], [0, 0, 0]])
        for c in cameras
    ]
    seen = shifted(detect(cameras, PEOPLE, 0.3, np.random.default_rng(0)), (0, 4.0 if centred else 0.0))
    lenses, notes = decided(cameras, names, [(1920, 1080)] * 4, seen)
    assert all(np.allclose(lens.calibration_from_video, [[1, 0, 0], [0, 1, 4 if centred else 0]]) for lens in lenses)
    assert sum("1920×1080" in note for note in notes) == 4
    assert lenses[0].placed != ""
    assert rayless_share(lenses[0], (1920, 1080)) == 0


def test_without_people_padding_lies_below_and_that_is_said():
    cameras, names = rig(("a", "b", "c", "d"), (1920, 1088)), list("abcd")
    nobody = [d.only(np.zeros(len(d.frame), bool)) for d in people(cameras, names)]
    lenses, notes = decided(cameras, names, [(1920, 1080)] * 4, nobody)
    assert np.array_equal(lenses[0].calibration_from_video, np.eye(2, 3))
    assert any("pixel_maps" in note for note in notes)


@pytest.mark.parametrize("quarters", [1, 3])
def test_a_film_that_was_turned_is_turned_back(quarters):
    cameras, names = rig(("a", "b", "c", "d")), list("abcd")
    seen = people(cameras, names)
    lens = Lens(
        "a", cameras[0].wh, cameras[0].intrinsics, "opencv", np.zeros(8), cameras[0].camera_from_world, np.eye(2, 3)
    )
    for _ in range(quarters):
        lens = rotate_lens_90(lens)
    film = Camera("a", lens.wh, lens.intrinsics, lens.camera_from_world)
    filmed = people([film, *cameras[1:]], names)
    lenses, notes = decided(cameras, names, [film.wh, *(c.wh for c in cameras[1:])], [filmed[0], *seen[1:]])
    assert np.allclose(lenses[0].camera_from_world, film.camera_from_world)
    assert any("turned" in note for note in notes)


def test_turning_a_lens_turns_its_distortion():
    distortion = np.array([-0.2, 0.05, 0.004, -0.003, 0.01, 0, 0, 0])
    k = np.array([[800.0, 0, 600], [0, 810, 380], [0, 0, 1]])
    lens = Lens("a", (1280, 704), k, "opencv", distortion, np.eye(4), np.eye(2, 3))
    ray = np.array([[0.3, -0.2], [-0.4, 0.25]])
    x, y = (distort(ray, "opencv", distortion) * [800, 810] + [600, 380]).T
    other = rotate_lens_90(lens)
    turned_ray = np.stack([-ray[:, 1], ray[:, 0]], -1)
    focal, centre = np.diag(other.intrinsics)[:2], other.intrinsics[:2, 2]
    pixels = distort(turned_ray, "opencv", other.distortion) * focal + centre
    assert np.allclose(pixels, np.stack([704 - y, x], -1))


def test_a_shape_that_nothing_explains_is_refused_with_what_helps():
    lens = Lens(
        "a",
        (640, 480),
        np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]),
        "opencv",
        np.zeros(8),
        np.eye(4),
        np.eye(2, 3),
    )
    with pytest.raises(UserError, match="pixel_maps"):
        crop_hypotheses(lens, (500, 500))
    # The remedy.
    given = replace(lens, calibration_from_video=np.array([[1.0, 0, 70], [0, 1, -10]]))
    assert crop_hypotheses(given, (500, 500))[0].lens is given
    assert working_view(given, (500, 500), (400, 400)).intrinsics[0, 0] > 0


FOLDING = np.array([-0.37, 0.20, 0.0, 0.0, -0.07, 0, 0, 0])


@pytest.mark.parametrize("focal", [960.0, 820.0])
def test_a_lens_that_turns_over_in_the_corners_shows_what_can_be_undone(focal):
    k = np.array([[focal, 0, 640], [0, focal, 480], [0, 0, 1]])
    lens = Lens("a", (1280, 960), k, "opencv", FOLDING, np.eye(4), np.eye(2, 3))
    assert 0 < rayless_share(lens, lens.wh) < 0.2
    view = working_view(lens, lens.wh, (640, 480))
    assert view.map_x.min() >= -1
    assert view.map_x.max() <= 1280
    assert view.map_y.min() >= -1
    assert view.map_y.max() <= 960
    # Every pixel of it is the one ray that the lens has there.
    at = np.stack([view.map_x, view.map_y], -1)[::16, ::16].astype(float) + 0.5
    ray, valid = normalised_from_calibration(at, lens)
    rows, columns = np.mgrid[: view.map_x.shape[0], : view.map_x.shape[1]][:, ::16, ::16] + 0.5
    n = view.oversampling
    expected = (np.stack([columns, rows], -1) / n - view.intrinsics[:2, 2]) / np.diag(view.intrinsics)[:2]
    assert valid.all()
    assert np.abs(ray - expected).max() < 1e-3


def test_beyond_the_fold_there_is_no_film():
    lens = Lens(
        "a",
        (1280, 960),
        np.array([[960.0, 0, 640], [0, 960, 480], [0, 0, 1]]),
        "opencv",
        FOLDING,
        np.eye(4),
        np.eye(2, 3),
    )
    assert (video_from_working(np.array([[4000.0, 4000.0]]), lens, lens.wh, lens.intrinsics) < 0).all()


def test_a_lens_that_turns_over_in_most_of_the_picture_is_refused():
    k = np.array([[400.0, 0, 640], [0, 400, 480], [0, 0, 1]])
    with pytest.raises(UserError, match="another lens or another model"):
        rayless_share(Lens("a", (1280, 960), k, "opencv", FOLDING, np.eye(4), np.eye(2, 3)), (1280, 960))


def test_a_film_outside_of_the_calibrated_picture_is_refused_before_the_doctor():
    lens = Lens(
        "a",
        (640, 480),
        np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]),
        "opencv",
        np.zeros(8),
        np.eye(4),
        np.array([[1.0, 0, -9000], [0, 1, 0]]),
    )
    with pytest.raises(UserError, match=r"camera a: .*pixel_maps"):
        rayless_share(lens, (640, 480))


@pytest.mark.parametrize("far", [("d",), ("c", "d")])
def test_no_camera_decides_the_unit_of_all(far):
    cameras = rig(("a", "b", "c", "d"))
    moved = []
    for c in cameras:
        pose = c.camera_from_world.copy()
        pose[:3, 3] *= 1000.0 if c.name in far else 1.0
        moved.append(replace(c, camera_from_world=pose))
    raw = replace(reading(moved), unit="unknown")
    nobody = [d.only(np.zeros(len(d.frame), bool)) for d in people(cameras, list("abcd"))]
    with pytest.raises(UserError, match=f"puts {', '.join(far)} .*one unit"):
        choose_lenses(raw, "x", list("abcd"), [c.wh for c in moved], nobody, {}, Settings())
    # The remedy: without them it is read.
    left = [c.name for c in cameras if c.name not in far]
    assert len(
        choose_lenses(raw, "x", left, [(1280, 704)] * len(left), nobody[: len(left)], {}, Settings()).lenses
    ) == len(left)


def test_points_seen_through_a_known_lens_are_straightened_before_poses_are_found():
    """Lenses without poses: a point through the lens lands where the ideal pinhole has it, and the pose comes back."""
    camera = rig(("a",))[0]
    distortion = np.array([-0.2, 0.05, 0.002, -0.001, 0, 0, 0, 0])
    k = np.array([[900.0, 0, 660], [0, 920, 340], [0, 0, 1]])
    lens = Lens("a", camera.wh, k, "opencv", distortion, np.eye(4), np.eye(2, 3))
    seen = detect([camera], PEOPLE, 0.0, np.random.default_rng(0))[0]
    rays = (seen.keypoints[..., :2] - camera.principal_px) / camera.focal_px
    points = seen.keypoints.copy()
    points[..., :2] = distort(rays, "opencv", distortion) * [900, 920] + [660, 340]
    found = undistort_detections(replace(seen, keypoints=points), lens, camera.wh)
    wanted = ideal_pinhole(lens, camera.wh)
    present = found.keypoints[..., 2] > 0
    assert present.any()
    expected = rays * wanted.focal_px + wanted.principal_px
    assert np.abs(found.keypoints[..., :2] - expected)[present].max() < 1e-6
    longer = replace(wanted, intrinsics=wanted.intrinsics * [[1.01, 1, 1], [1, 1.01, 1], [1, 1, 1]])
    back = lens_at_pose(lens, replace(longer, camera_from_world=camera.camera_from_world))
    assert np.allclose(np.diag(back.intrinsics)[:2], [909, 929.2])
    assert np.array_equal(back.camera_from_world, camera.camera_from_world)
