# SPDX-License-Identifier: Apache-2.0
"""Views by GEN3C: the network's frame and ours, checked requests, films back at the working size, and what no photo
shows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.body.model import BodyModel, upright_global_orientation
from studiorecon.body.person_files import write_person
from studiorecon.configuration.settings import load
from studiorecon.errors import UserError
from studiorecon.footage.exr import write_depth
from studiorecon.footage.video import read_stack, to_bytes, write_lossless
from studiorecon.images.regions import dilate
from studiorecon.models.adapters import gen3c, sam3
from studiorecon.models.catalogue.card import Card
from studiorecon.scene.camera import Camera
from studiorecon.scene.factors import Factors
from studiorecon.scene.path import read_path, write_path
from studiorecon.scene.support import EXCLUDED, support_weight
from studiorecon.views import fitted, generate, request
from studiorecon.views import path as views_path
from studiorecon.views import people as views_people
from studiorecon.views.first_moment import FirstMomentPeople, first_pictures
from studiorecon.views.frame import fit_network_frame
from studiorecon.views.synthesize import read_photos

from tests.made.fitted import fitted_person
from tests.made.networks import room_views
from tests.made.room import write_capture

WH = (96, 54)
NETWORK_HW = (88, 160)
# Videos, masks, bodies and the body model: of key frames with people only.
NOBODY: tuple = ([], [], [], None, "planes")


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gen3c, "HW", NETWORK_HW)
    monkeypatch.setattr(gen3c.Gen3c, "hw", NETWORK_HW)


@pytest.mark.parametrize("hw", [(270, 480), (54, 96), (720, 1280), (704, 1280), (600, 1000)])
def test_a_picture_comes_back_from_the_networks_frame_where_it_was(hw: tuple[int, int]) -> None:
    frame = fit_network_frame(hw, (704, 1280))
    v, u = (np.arange(size) / size for size in hw)
    picture = np.stack(np.broadcast_arrays(v[:, None], u, 0.5 + 0.2 * np.sin(9 * u + 5 * v[:, None])), -1).astype(
        np.float32
    )
    there = frame.colours(picture)
    assert there.shape == (704, 1280, 3)
    back, inside = frame.back(there)
    assert back.shape == picture.shape
    assert inside.mean() > 0.85
    # Naive, a squeeze of 720 rows into 704: off by up to 8 rows.
    error = np.abs(back - picture)[inside]
    assert np.percentile(error, 99) < 0.02
    assert np.median(error) < 1e-3
    assert inside.any(axis=0).all() or hw[1] * 704 < hw[0] * 1280


def test_the_networks_camera_sees_the_same_points_in_its_own_pixels() -> None:
    camera, _, depth = room_views(WH)[0]
    frame = fit_network_frame(WH[::-1], (704, 1280))
    points = camera.unproject(camera.pixel_centres(), depth)[5:-5]
    there, _ = frame.camera(camera).project(points)
    ours, _ = camera.project(points)
    np.testing.assert_allclose(there * frame.step + np.array(frame.start)[::-1], ours, atol=1e-9)
    values = frame.values(depth)
    rows, columns = (np.floor(there[..., k]).astype(int) for k in (1, 0))
    np.testing.assert_allclose(values[rows, columns], depth[5:-5], rtol=1e-6)


def test_portrait_footage_is_refused() -> None:
    with pytest.raises(UserError, match=r"1080×1920 would lose \d+% of its picture"):
        fit_network_frame((1920, 1080), (704, 1280))


@pytest.fixture
def files(tmp_path: Path, small: None, default_settings: Callable) -> tuple[dict, tuple, Path]:
    views = room_views(WH)
    cameras, pictures, depths = zip(*views)
    unknown = np.zeros(WH[::-1], bool)
    unknown[20:30, 40:50] = True
    plates = write_capture(tmp_path, cameras, pictures, unknown)
    maps = [tmp_path / f"{c.name}.exr" for c in cameras]
    for path, depth in zip(maps, depths):
        write_depth(path, depth, np.ones(depth.shape))
    section = default_settings("views", views_per_segment=120, synthesizer="gen3c")
    steps, _ = views_path.plan_views(list(cameras), load(views_path.Settings, section, "views"))
    write_path(tmp_path / "path.json", steps, 24.0)
    return section, (tmp_path / "path.json", tmp_path / "cameras/images.txt", plates, maps, []), tmp_path


def test_no_more_photos_are_requested_than_memory_bears(
    files: tuple, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    section, common, folder = files
    monkeypatch.setattr(gen3c.Gen3c, "most_key_frames", 2)
    request.run(load(request.Settings, section, "views"), "00", *common, *NOBODY, folder / "00.request.npz")
    assert len(np.load(folder / "00.request.npz")["images_key_frames"]) == 2
    assert "segment 00: of 4 photos the 2 nearest are its key frames" in capsys.readouterr().out


def test_a_segment_goes_to_the_network_and_comes_back(files: tuple, monkeypatch: pytest.MonkeyPatch) -> None:
    section, common, folder = files
    request.run(load(request.Settings, section, "views"), "00", *common, *NOBODY, folder / "00.request.npz")
    requested = dict(np.load(folder / "00.request.npz"))
    assert requested["images_key_frames"].shape == (4, 3, *NETWORK_HW)
    assert len(requested["w2cs_all"]) == 121
    # The hole that people left in the plate is masked, and its loud colour does not seed the film.
    hole = requested["mask_key_frames"][0, 0] == 0
    assert hole[36:44, 70:80].all()
    assert requested["images_key_frames"][0][:, 38, 75].max() < 0.95

    made: list[Path] = []

    class Planted(gen3c.Gen3c):
        def __init__(self, card: Card, weights: Path, where: str, **options: float) -> None:
            assert (options["steps"], options["guidance"]) == (35, 1.0)

        def views(self, given: dict[str, np.ndarray]) -> Iterator[np.ndarray]:
            made.append(folder)
            first = ((given["images_key_frames"][0].transpose(1, 2, 0) + 1) * 127.5).round().astype(np.uint8)
            yield np.repeat(first[None], 121, axis=0)

    monkeypatch.setattr(gen3c, "ADAPTER", Planted)
    settings = load(generate.Settings, section, "views")
    generate.run(settings, [folder / "00.request.npz"], [folder / "00.film.mkv"], folder)
    assert read_stack(folder / "00.film.mkv").shape == (121, *NETWORK_HW, 3)

    quick = load(fitted.Settings, {**section, "oversampling": 1}, "views")
    fitted.run(quick, "00", folder / "00.film.mkv", *common, [], None, [], folder / "00.mkv", folder / "00.mask.mkv")
    views, support = read_stack(folder / "00.mkv"), read_stack(folder / "00.mask.mkv")
    assert views.shape == (121, 54, 96, 3)
    start = next(
        c
        for c, _, _ in room_views(WH)
        if np.allclose(c.camera_from_world, read_path(common[0])[0][0].camera.camera_from_world)
    )
    truth = next(rgb for c, rgb, _ in room_views(WH) if c is start)
    inside = support[0] == 255
    assert inside.mean() > 0.6
    assert np.median(np.abs(views[0].astype(float) - to_bytes(truth))[inside]) < 8
    assert (support[:, [0, -1]] == EXCLUDED).all(), "rows that the network's frame cuts off do not count"


def test_the_request_of_a_wrong_length_or_wrong_depth_stops_before_a_gpu(
    files: tuple, default_settings: Callable
) -> None:
    section, common, folder = files
    settings = load(request.Settings, section, "views")
    steps, fps = read_path(common[0])
    write_path(folder / "short.json", steps[:100], fps)
    with pytest.raises(
        UserError,
        match=r"GEN3C makes 121, 241, 361, … frames, not 100; set views\.views_per_segment to 120",
    ):
        request.run(settings, "00", folder / "short.json", *common[1:], *NOBODY, folder / "x.npz")
    for path, (_, _, depth) in zip(common[3][:1], room_views(WH)):
        write_depth(path, depth * 1.6, np.ones(depth.shape))
    with pytest.raises(UserError, match="key frames of the GEN3C request disagree about depth"):
        request.run(settings, "00", *common, *NOBODY, folder / "x.npz")
    assert not (folder / "x.npz").exists()


def test_a_brought_film_must_fit_the_path(files: tuple) -> None:
    section, common, folder = files
    settings = load(fitted.Settings, section, "views")
    out = folder / "o.mkv", folder / "o.mask.mkv"
    write_lossless(folder / "few.mkv", np.zeros((5, 54, 96, 3), np.uint8), 24.0)
    with pytest.raises(
        UserError, match=r"has 5 pictures for 121 views of segment 00; set views\.views_per_segment to 4"
    ):
        fitted.run(settings, "00", folder / "few.mkv", *common, [], None, [], *out)
    steps, fps = read_path(common[0])
    write_path(folder / "five.json", steps[:5], fps)  # as views_per_segment: 4 would
    fitted.run(settings, "00", folder / "few.mkv", folder / "five.json", *common[1:], [], None, [], *out)
    camera = Camera("x", WH, np.eye(3), np.eye(4))
    with pytest.raises(UserError, match="80×60; they must be 160×88"):
        fitted.fit_picture(np.zeros((60, 80, 3), np.uint8), camera, [NETWORK_HW], 3)
    own = cv2.randu(np.zeros((54, 96, 3), np.uint8), 0, 255)
    assert fitted.fit_picture(own, camera, [NETWORK_HW], 3)[0] is own


def test_a_network_that_stops_short_is_noticed() -> None:
    class Short:
        def views(self, given: dict) -> Iterator[np.ndarray]:
            yield np.zeros((121, 2, 2, 3), np.uint8)

    with pytest.raises(UserError, match="made 121 views of 241"):
        list(generate.request_frames(Short(), {"w2cs_all": np.zeros((241, 4, 4))}))


@pytest.fixture
def someone(files: tuple, root: Path) -> tuple[Path, Path, list[Path], list[Path], FirstMomentPeople]:
    """Somebody stands in the room at the first moment: a body file, first pictures in which they are red and a little
    wider than their body, and masks of that."""
    _, _, folder = files
    model = BodyModel.load(root / "resources/body.npz")
    poses = np.zeros((2, 72))
    poses[:, :3] = upright_global_orientation(0.4)
    trans, betas = np.tile([0.2, -0.1, 0.95], (2, 1)), np.zeros(10)
    person = fitted_person(
        "p0", model.identity, 24.0, 2, poses=poses, trans=trans, joints=model.joints(poses, betas, trans)
    )
    write_person(folder / "p0.npz", person)
    standing = FirstMomentPeople([person], model)
    videos, masks = [], []
    for camera, rgb, _ in room_views(WH):
        clothed = around(standing, camera, 3)
        picture = np.where(clothed[..., None], np.uint8([230, 20, 20]), to_bytes(rgb))
        videos.append(folder / f"{camera.name}.mkv")
        masks.append(folder / f"{camera.name}.mask.mkv")
        write_lossless(videos[-1], np.stack([picture, to_bytes(rgb)]), 24.0)
        write_lossless(masks[-1], np.stack([clothed, np.zeros_like(clothed)]).astype(np.uint8), 24.0)
    return folder / "p0.npz", root / "resources/body.npz", videos, masks, standing


def around(standing: FirstMomentPeople, camera: Camera, side_px: int) -> np.ndarray:
    """(H, W) bool: somebody is there, or within the square of ``side_px``."""
    return dilate(standing.depth_m(camera) > 0, side_px)


def test_key_frames_with_people_show_them_at_their_depth(files: tuple, someone: tuple) -> None:
    section, common, folder = files
    fit, body, videos, masks, standing = someone
    settings = load(request.Settings, {**section, "key_frames": "first_frames"}, "views")
    # The network's own check warps every key frame into the others: bodies agree with each other in depth.
    request.run(settings, "00", *common, videos, masks, [fit], body, "planes", folder / "00.request.npz")
    requested = dict(np.load(folder / "00.request.npz"))
    photos = first_pictures(
        read_photos(*common[1:], settings.depth_jump), videos, masks, standing, Factors(), settings.depth_jump
    )
    reds = [(p[0] > 0.5) & (p[1] < -0.5) for p in requested["images_key_frames"]]
    assert all(0.01 < red.mean() < 0.3 for red in reds)
    for photo, (camera, _, room_m) in zip(photos, room_views(WH)):
        bodies, clothed = standing.depth_m(camera), around(standing, camera, 3)
        np.testing.assert_allclose(photo.depth_m[bodies > 0], bodies[bodies > 0])
        # Clothes beside the body are as far as it is, and not as far as the wall behind.
        beside = clothed & (bodies == 0)
        near_m, far_m = bodies[bodies > 0].min(), bodies[bodies > 0].max()
        assert ((photo.depth_m[beside] >= near_m) & (photo.depth_m[beside] <= far_m)).all()
        assert np.median(room_m[beside]) > far_m, "the wall is behind them"
        np.testing.assert_allclose(photo.depth_m[~clothed], room_m[~clothed], rtol=2e-3)
        assert not photo.usable[clothed ^ cv2.erode(clothed.astype(np.uint8), np.ones((3, 3))).astype(bool)].all()
    # Without bodies whoever is in the masks is not carried at all.
    for alone in first_pictures(
        read_photos(*common[1:], 0.04), videos, masks, FirstMomentPeople([], None), Factors(), 0.04
    ):
        assert not alone.usable[around(standing, alone.camera, 3)].any()


def test_people_in_generated_views_are_left_out_of_the_training(files: tuple, someone: tuple) -> None:
    section, common, folder = files
    fit, body, _, _, standing = someone
    film = np.random.default_rng(0).integers(0, 255, (121, 54, 96, 3), dtype=np.uint8)
    write_lossless(folder / "00.film.mkv", film, 24.0)
    out = folder / "00.mkv", folder / "00.mask.mkv"
    quick = {**section, "oversampling": 1}
    settings = load(fitted.Settings, {**quick, "key_frames": "first_frames", "dilation_px": 5}, "views")
    fitted.run(settings, "00", folder / "00.film.mkv", *common, [fit], body, [], *out)
    levels = read_stack(out[1])
    for step, level in list(zip(read_path(common[0])[0], levels))[::40]:
        there = around(standing, step.camera, 5)
        assert there.any()
        np.testing.assert_array_equal(level == EXCLUDED, there)
        # However much unsupported pixels count (hole_weight), people count nothing.
        assert not support_weight(level, 1.0)[there].any()
        assert (support_weight(level, 1.0)[~there] == 1).all()
    # Of plates nobody is expected in the film.
    fitted.run(load(fitted.Settings, quick, "views"), "00", folder / "00.film.mkv", *common, [], None, [], *out)
    assert not (read_stack(out[1]) == EXCLUDED).any()


def test_depth_of_the_first_moment_is_taken_as_it_is_where_it_was_measured_then(files: tuple, someone: tuple) -> None:
    """depth.reference calibration: the network that found the cameras measured people too, wherever bodies are."""
    section, common, folder = files
    fit, body, videos, masks, standing = someone
    for path, (camera, _, room_m) in zip(common[3], room_views(WH)):
        bodies = standing.depth_m(camera)
        write_depth(path, np.where(bodies > 0, bodies + 0.1, room_m), np.ones(room_m.shape))
    settings = load(request.Settings, {**section, "key_frames": "first_frames"}, "views")
    request.run(settings, "00", *common, videos, masks, [fit], body, "calibration", folder / "00.request.npz")
    photos = read_photos(*common[1:], settings.depth_jump)
    for photo in first_pictures(photos, videos, masks, standing, Factors(), settings.depth_jump, measured=True):
        bodies = standing.depth_m(photo.camera)
        np.testing.assert_allclose(photo.depth_m[bodies > 0], bodies[bodies > 0] + 0.1, rtol=2e-3)


def test_a_network_that_looks_for_people_says_what_the_training_leaves_out(
    files: tuple, someone: tuple, monkeypatch: pytest.MonkeyPatch
) -> None:
    """views.people network: the paper's M is SAM 3's on every view, not where fitted bodies stand."""
    (section, common, folder), hw = files, NETWORK_HW
    fit, body, *_ = someone
    film = np.random.default_rng(0).integers(0, 255, (121, *hw, 3), dtype=np.uint8)
    film[:, :, hw[1] // 2 :] //= 4
    write_lossless(folder / "00.film.mkv", film, 24.0)

    class Planted:
        """Sees a person in the dark half of every picture."""

        def __init__(self, card: Card, weights: Path, where: str, chunk: int, prompt: str) -> None:
            assert (card.name, chunk, prompt) == ("sam3", 200, "person")

        def segment(self, frames: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
            for picture in frames:
                dark = np.zeros(picture.shape[:2], np.uint16)
                dark[:, picture.shape[1] // 2 :] = 7
                yield dark

    monkeypatch.setattr(sam3, "ADAPTER", Planted)
    views_people.run("00", folder / "00.film.mkv", "sam3", 200, folder, "cpu", folder / "00.people.mkv")
    assert read_stack(folder / "00.people.mkv").shape == (121, *hw)
    out = folder / "00.mkv", folder / "00.mask.mkv"
    settings = load(
        fitted.Settings, {**section, "oversampling": 1, "key_frames": "first_frames", "dilation_px": 5}, "views"
    )
    seen = [folder / "00.people.mkv"]
    inside = fit_network_frame((54, 96), hw).back(np.ones((*hw, 3)))[1]
    fitted.run(settings, "00", folder / "00.film.mkv", *common, [fit], body, seen, *out)
    for level in read_stack(out[1])[::40]:
        somebody = (level == EXCLUDED) & inside
        # Half of the picture and two pixels about it, whoever stands where.
        assert somebody[4:-4, 46:].all()
        assert not somebody[:, :45].any()
    write_lossless(folder / "00.people.mkv", np.zeros((121, 30, 40), np.uint8), 24.0)
    with pytest.raises(UserError, match=r"00\.people\.mkv .*it is not of the film whose views it is about"):
        fitted.run(settings, "00", folder / "00.film.mkv", *common, [fit], body, seen, *out)


def test_who_is_away_at_the_first_moment_is_not_expected(files: tuple, someone: tuple) -> None:
    *_, standing = someone
    late = replace(standing, people=[replace(standing.people[0], present=np.array([False, True]))])
    for camera, _, _ in room_views(WH):
        assert (standing.depth_m(camera) > 0).any()
        assert not late.depth_m(camera).any()
