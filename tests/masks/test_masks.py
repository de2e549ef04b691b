# SPDX-License-Identifier: Apache-2.0
"""Masks: bodies of known place in a made picture come back as they are, whoever stands before whom."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.body.person_files import write_person
from studiorecon.body.silhouettes import dilated_silhouettes
from studiorecon.camera_files.colmap import write_model
from studiorecon.errors import UserError
from studiorecon.footage.video import read_stack, write_lossless
from studiorecon.images.palette import UNASSIGNED
from studiorecon.images.plate import write_plate
from studiorecon.images.regions import without_holes, without_islands
from studiorecon.images.silhouette import front_person, mesh_depth
from studiorecon.masks import labelling
from studiorecon.masks import segment as step
from studiorecon.masks.log_odds import colour_difference
from studiorecon.masks.user_masks import mask_pictures
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.capture import Footage, write_footage
from studiorecon.scene.factors import write_factors
from studiorecon.scene.files import write_json

from tests.made.masks import SHIRTS, WH, Scene, scene, segmented, settings, standing, watching_camera  # noqa: F401
from tests.made.scene import refilmed
from tests.made.steps import call


def agreement(labels: np.ndarray, truth: np.ndarray) -> list[float]:
    """Intersection over union of both people."""
    both = [(labels == k + 1, truth == k + 1) for k in range(2)]
    return [(made & true).sum() / (made | true).sum() for made, true in both]


def test_known_bodies_are_cut_out_and_the_nearer_hides_the_other(scene: Scene, settings: step.Settings) -> None:
    assert (scene.truth[2] == 2).sum() > (scene.truth[2] == 1).sum()  # p1 walks in front
    labels = segmented(scene, settings)
    assert min(agreement(labels, scene.truth)) > 0.93
    assert not (labels == UNASSIGNED).any()


def test_a_fit_that_is_three_centimetres_off_still_gives_the_picture_s_outline(
    scene: Scene, settings: step.Settings
) -> None:
    off = [replace(p, trans=p.trans + np.array([0.03, 0, 0.02])) for p in scene.people]
    labels = segmented(scene, settings, people=off)
    shifted = np.stack([front_person(labelling.body_depths(off, scene.body, scene.camera, t)) for t in range(5)])
    assert min(agreement(labels, scene.truth)) > 0.86
    assert np.mean(agreement(labels, scene.truth)) > np.mean(agreement(shifted, scene.truth)) + 0.03


def test_furniture_in_front_of_a_body_is_not_the_person(scene: Scene, settings: step.Settings) -> None:
    table = np.zeros(WH[::-1], bool)
    table[95:160] = True
    frames = np.where(table[None, ..., None], scene.plate, scene.frames)
    labels = segmented(scene, settings, frames=frames)
    assert (labels[:, 100:] > 0).mean() < 0.01
    assert min(agreement(labels, np.where(table, 0, scene.truth))) > 0.9


def test_where_the_plate_is_unknown_bodies_and_colours_decide(scene: Scene, settings: step.Settings) -> None:
    labels = segmented(scene, settings, plate=np.zeros_like(scene.plate), measured=np.zeros(WH[::-1], bool))
    assert min(agreement(labels, scene.truth)) > 0.88


def test_a_shadow_is_not_a_person(scene: Scene, settings: step.Settings) -> None:
    shadow = np.zeros(WH[::-1], bool)
    shadow[130:150, 20:180] = True
    dark = np.where((shadow & (scene.truth == 0))[..., None], scene.frames * 0.65, scene.frames).astype(np.uint8)
    labels = segmented(scene, settings, frames=dark)
    assert ((labels > 0) & (scene.truth == 0) & shadow).sum() < 0.03 * 5 * shadow.sum()


def test_what_no_body_explains_is_unassigned(scene: Scene, settings: step.Settings) -> None:
    frames = scene.frames.copy()
    frames[2:, 20:35, 170:190] = (250, 240, 20)
    labels = segmented(scene, settings, frames=frames)
    assert (labels[2:, 22:33, 172:188] == UNASSIGNED).all()
    assert not (labels[:2] == UNASSIGNED).any()


class TestStep:
    @pytest.fixture
    def files(self, scene: Scene, tmp_path: Path, root: Path) -> dict:
        write_model(tmp_path / "cameras", [scene.camera])
        write_lossless(tmp_path / "a.mkv", iter(scene.frames), 30)
        write_plate(tmp_path / "a.plate.png", scene.plate, np.ones(WH[::-1], bool))
        k = scene.camera.intrinsics
        write_footage(
            tmp_path / "a.json", Footage("a", False, WH, k.tolist(), 30.0, 5, 0, "videos/a.mp4", "", WH, 0, 0.0, [])
        )
        lens = Lens("a", WH, k, "opencv", np.zeros(5), np.eye(4), np.eye(2, 3))
        write_json(tmp_path / "calibration.json", {"lenses": [lens.as_json()]})
        for person in scene.people:
            write_person(tmp_path / f"{person.name}.npz", person)
        return {
            "camera": "a",
            "model": tmp_path / "cameras/images.txt",
            "video": tmp_path / "a.mkv",
            "plate": tmp_path / "a.plate.png",
            "footage": tmp_path / "a.json",
            "calibration": tmp_path / "calibration.json",
            "fits": [tmp_path / "p0.npz", tmp_path / "p1.npz"],
            "body": root / "resources/body.npz",
            "given": [],
            "tracks": [],
            "masks": tmp_path / "masks.mkv",
        }

    def test_files_in_files_out_and_the_same_bytes_again(
        self, scene: Scene, settings: step.Settings, files: dict, tmp_path: Path
    ) -> None:
        call(step.run, settings, **files)
        assert min(agreement(read_stack(tmp_path / "masks.mkv"), scene.truth)) > 0.93
        first = (tmp_path / "masks.mkv").read_bytes()
        call(step.run, settings, **files)
        assert (tmp_path / "masks.mkv").read_bytes() == first

    def test_lamps_that_brighten_are_nobody(
        self, scene: Scene, settings: step.Settings, files: dict, tmp_path: Path
    ) -> None:
        course = np.linspace(1.1, 1.3, len(scene.frames))[:, None].repeat(3, axis=1)
        write_factors(tmp_path / "course.json", {"a": course})
        (bright,) = refilmed([files["video"]], tmp_path / "filmed", [course])
        found = {}
        for light in ([tmp_path / "course.json"], []):
            call(step.run, settings, **(files | {"video": bright, "brightness": light}))
            labels = read_stack(tmp_path / "masks.mkv")
            found[bool(light)] = min(agreement(labels, scene.truth)), float((labels == UNASSIGNED).mean())
        assert found[True][0] > 0.93
        assert found[True][1] < 0.01
        assert found[False][1] > 0.05, "without it the room itself differs from its plate"

    def test_masks_of_the_user_are_kept_and_their_identities_matched(
        self, scene: Scene, settings: step.Settings, files: dict, tmp_path: Path
    ) -> None:
        write_lossless(tmp_path / "given.mkv", iter(np.array([0, 90, 40], np.uint8)[scene.truth]), 30)
        call(step.run, settings, **{**files, "given": [tmp_path / "given.mkv"]})
        np.testing.assert_array_equal(read_stack(tmp_path / "masks.mkv"), scene.truth)

    def test_binary_masks_are_divided_by_the_bodies(
        self, scene: Scene, settings: step.Settings, files: dict, tmp_path: Path
    ) -> None:
        folder = tmp_path / "given"
        folder.mkdir()
        for t, truth in enumerate(scene.truth):
            picture = np.where(truth > 0, 255, 0).astype(np.uint8)
            picture[5:9, 5:9] = 255  # somebody else
            cv2.imwrite(str(folder / f"{t:03d}.png"), picture)
        call(step.run, settings, **{**files, "given": [folder]})
        labels = read_stack(tmp_path / "masks.mkv")
        assert (labels[:, 5:9, 5:9] == UNASSIGNED).all()
        np.testing.assert_array_equal(np.where(labels == UNASSIGNED, 0, labels), scene.truth)

    def test_masks_that_do_not_fit_are_refused(
        self, scene: Scene, settings: step.Settings, files: dict, tmp_path: Path
    ) -> None:
        write_lossless(tmp_path / "given.mkv", iter(scene.truth[:3]), 30)
        with pytest.raises(UserError, match=r"given\.mkv hold 3 pictures, but 5 frames of camera a"):
            call(step.run, settings, **{**files, "given": [tmp_path / "given.mkv"]})
        write_lossless(tmp_path / "given.mkv", iter(scene.truth[:, :100]), 30)
        with pytest.raises(UserError, match=r"given\.mkv are 200×100, another shape than the footage"):
            call(step.run, settings, **{**files, "given": [tmp_path / "given.mkv"]})

    def test_a_fit_of_other_frames_is_refused(
        self, scene: Scene, settings: step.Settings, files: dict, tmp_path: Path
    ) -> None:
        write_person(tmp_path / "p1.npz", standing("p1", scene.body.identity, np.zeros((3, 2))))
        with pytest.raises(UserError, match=r"p1\.npz .*it has 3 frames.*delete it"):
            call(step.run, settings, **files)

    def test_a_camera_outside_the_model_is_refused(self, settings: step.Settings, files: dict) -> None:
        with pytest.raises(UserError, match="has no camera z"):
            call(step.run, settings, **{**files, "camera": "z"})


class TestSilhouette:
    def test_a_square_covers_its_pixel_centres_and_has_its_depth(self) -> None:
        camera = Camera("a", (20, 10), np.array([[10.0, 0, 10], [0, 10, 5], [0, 0, 1]]), np.eye(4))
        # Corners project to x = 5 … 15, y = 2 … 8 at z = 2.
        square = np.array([[-1, -0.6, 2], [1, -0.6, 2], [1, 0.6, 2], [-1, 0.6, 2]])
        depth_m = mesh_depth(square, np.array([[0, 1, 2], [0, 2, 3]]), camera)
        expected = np.zeros((10, 20), np.float32)
        expected[2:8, 5:15] = 2
        np.testing.assert_allclose(depth_m, expected, atol=1e-6)

    def test_a_slanted_triangle_has_the_depth_of_its_plane(self) -> None:
        camera = Camera("a", (60, 40), np.array([[50.0, 0, 30], [0, 50, 20], [0, 0, 1]]), np.eye(4))
        corners = np.array([[-1.0, -0.8, 2.5], [1.2, -0.5, 4.0], [0.1, 1.0, 3.0]])
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        depth_m = mesh_depth(corners, np.array([[0, 1, 2]]), camera)
        covered = depth_m > 0
        expected = (normal @ corners[0]) / (camera.rays()[1] @ normal)
        assert covered.sum() > 100
        np.testing.assert_allclose(depth_m[covered], expected[covered], rtol=1e-5)

    def test_meshes_at_the_camera_and_broken_ones_are_left_out(self) -> None:
        camera = Camera("a", (20, 10), np.array([[10.0, 0, 10], [0, 10, 5], [0, 0, 1]]), np.eye(4))
        for corners in (
            [[0, 0, 1e-4], [1, 0, 1], [0, 1, 1]],
            [[0, 0, -1], [1, 0, 1], [0, 1, 1]],
            [[np.nan, 0, 1], [1, 0, 1], [0, 1, 1]],
        ):
            assert not mesh_depth(np.array(corners, float), np.array([[0, 1, 2]]), camera).any()


class TestRegions:
    def test_islands_and_holes_by_size(self) -> None:
        region = np.zeros((20, 20), bool)
        region[2:12, 2:12] = True
        region[5, 5] = region[7:10, 7:10] = False
        region[15, 15] = True
        cleaned = without_holes(without_islands(region, 2), 4)
        assert not cleaned[15, 15]
        assert cleaned[5, 5]
        assert not cleaned[7:10, 7:10].any()


def test_a_shadow_counts_less_than_paint_of_the_same_strength(settings: step.Settings) -> None:
    plate = np.full((4, 4, 3), (0.6, 0.5, 0.4), np.float32)
    shadow = colour_difference(plate * np.float32(0.6), plate, settings.difference)
    paint = colour_difference(plate * np.array([0.3, 0.6, 1.1], np.float32), plate, settings.difference)
    assert shadow.max() < 0.3 * paint.min()


def test_who_is_away_is_expected_nowhere(scene: Scene, settings: step.Settings) -> None:
    left = replace(scene.people[0], present=np.arange(5) < 2, valid=np.arange(5) < 2)
    depths_m = labelling.body_depths([left, scene.people[1]], scene.body, scene.camera, 3)
    assert not depths_m[0].any()
    assert depths_m[1].any()
    labels = segmented(scene, settings, people=[left, scene.people[1]])
    here = segmented(scene, settings)
    assert (labels[:2] == here[:2]).mean() > 0.999
    assert not (labels[2:] == 1).any()
    # Somebody whom no fit explains is nobody's, and still no room.
    assert (labels[4][scene.truth[4] == 1] == UNASSIGNED).mean() > 0.8
    assert (labels[2:] == 2).sum() > 0.9 * (here[2:] == 2).sum()
    outlines = [dilated_silhouettes([left], scene.body, scene.camera, frame, 0.05) for frame in (1, 3)]
    assert outlines[0].any()
    assert not outlines[1].any()


def test_colours_of_given_masks_are_labels_and_alpha_cuts_people_out(tmp_path: Path) -> None:
    label = np.zeros((20, 30), np.uint8)
    label[5:9, 4:9], label[5:9, 20:25] = 1, 2
    colours = np.array([[0, 0, 0], [0, 0, 128], [0, 128, 0]], np.uint8)  # as palettes of data sets are: equally bright
    photo = np.random.default_rng(0).integers(0, 255, (20, 30, 3)).astype(np.uint8)
    alpha = (255 * (label > 0)).astype(np.uint8)
    shown = {
        "coloured": colours[label], "of the other people first": colours[[0, 2, 1]][label],
        "cut out": np.dstack([photo, alpha]), "white": np.dstack([np.full_like(photo, 255), alpha]),
    }  # fmt: skip
    (tmp_path / "masks").mkdir()
    for k, picture in enumerate(shown.values()):
        assert cv2.imwrite(str(tmp_path / f"masks/{k}.png"), picture)
    first, second, cut_out, white = mask_pictures(tmp_path / "masks")
    assert sorted(map(int, np.unique(first))) == [0, 253, 254]
    assert np.array_equal(first > 0, label > 0)
    assert (second[label == 1] == first[label == 2][0]).all(), "a colour has one label in all pictures"
    assert np.array_equal(cut_out, alpha)
    assert np.array_equal(white, alpha)
