# SPDX-License-Identifier: Apache-2.0
"""deliver: exports can be read back and are described, and stale files are removed."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.body.model import BodyModel
from studiorecon.calibration.files import read_calibration
from studiorecon.camera_files.colmap import read_model
from studiorecon.deliver import camera_files, export, keypoint_files
from studiorecon.deliver.finished import read_finished, require_finite
from studiorecon.errors import UserError
from studiorecon.footage.video import write_lossless
from studiorecon.keypoints.readers import read_keypoints
from studiorecon.scene.files import read_json, write_npz
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.gaussians_ply import read_ply, write_ply
from studiorecon.scene.path import PathStep, write_path
from studiorecon.scene.people import Detections, write_detections, write_identities

from tests.made.delivered import options
from tests.made.scene import FPS, FRAMES, avatar, render_options, replace_gaussians, ring, room, write_scene
from tests.made.steps import call


def test_everything_delivered_can_be_read_and_matches_its_digest(tmp_path: Path, root: Path) -> None:
    cameras = write_scene(tmp_path, root, people=2, filmed=False)
    call(export.run, **options(tmp_path, 2))
    folder = tmp_path / "deliver"
    files = read_json(folder / "manifest.json")["files"]
    on_disk = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()} - {"manifest.json"}
    assert set(files) == on_disk
    for name, entry in files.items():
        data = (folder / name).read_bytes()
        assert (len(data), hashlib.sha256(data).hexdigest()) == (entry["bytes"], entry["sha256"])
    background, people = read_ply(folder / "background.ply"), [read_ply(folder / f"people/p{i}.ply") for i in range(2)]
    assert read_ply(folder / "still.ply").count == background.count + sum(p.count for p in people)
    assert people[0].means_m.mean(axis=0)[2] == pytest.approx(1.0, abs=0.3), (
        "the person stands on the floor of the world"
    )
    assert [c.name for c in read_model(folder / "cameras/colmap")] == [c.name for c in cameras["training"]]
    for name in on_disk - {"README.txt"}:
        assert name.split("/")[0] in (folder / "README.txt").read_text()


@pytest.mark.parametrize(("chosen", "each"), [("first", 1), ("all", FRAMES), ("none", 0)])
def test_the_pictures_that_the_cameras_files_name_are_there(tmp_path: Path, root: Path, chosen: str, each: int) -> None:
    cameras = write_scene(tmp_path, root, people=0, filmed=False)["training"]
    films = {
        c.name: np.random.default_rng(k).integers(0, 255, (FRAMES, *c.wh[::-1], 3), np.uint8)
        for k, c in enumerate(cameras)
    }
    for name, frames in films.items():
        write_lossless(tmp_path / f"capture/{name}.mkv", frames, FPS)
    call(export.run, **{**options(tmp_path, 0), "settings": export.Settings(pictures=chosen)})
    folder = tmp_path / "deliver/cameras"
    named = json.loads((folder / "nerfstudio/transforms.json").read_text())["frames"]
    lines = (folder / "colmap/images.txt").read_text().splitlines()[1::2]
    of_colmap = [line.split(" ", 9)[9] for line in lines]
    assert len(named) == len(of_colmap) == 4 * max(each, 1)
    for k, (frame, name) in enumerate(zip(named, of_colmap)):
        for path in (folder / "nerfstudio" / frame["file_path"], folder / "colmap/images" / name):
            assert path.is_file() == bool(each)
            if each:
                photo = films[frame["camera_label"]][k % each]
                np.testing.assert_array_equal(cv2.imread(str(path))[..., ::-1], photo)
    times = [frame.get("time") for frame in named]
    assert times[:each] == ([k / (FRAMES - 1) for k in range(each)] if each > 1 else [None] * each)
    assert next(c.name for c in read_model(folder / "colmap")).startswith("cam0")
    on_disk = {str(p.relative_to(tmp_path / "deliver")) for p in folder.rglob("*.png")}
    assert on_disk <= set(read_json(tmp_path / "deliver/manifest.json")["files"])
    assert ("pictures" in (tmp_path / "deliver/README.txt").read_text().split("keypoints/")[0].split("films/")[0]) == (
        each > 0
    )


def readings(folder: Path, form: str) -> list:
    names = {
        "colmap": ["cameras.txt", "images.txt"],
        "easymocap": ["intri.yml", "extri.yml"],
        "nerfstudio": ["transforms.json"],
        "pose2sim": ["Calib.toml"],
    }
    return list(read_calibration([folder / form / n for n in names[form]]).cameras)


@pytest.mark.parametrize("form", camera_files.WRITERS)
def test_exported_cameras_come_back_the_same(tmp_path: Path, form: str) -> None:
    cameras = [replace(c, name=n) for c, n in zip(ring([0, 90, 200, 271], "cam"), ("00", "01", "cam 2", "10"))]
    camera_files.WRITERS[form](tmp_path / form, cameras, np.zeros((2, 3)))
    back = {c.name: c for c in readings(tmp_path, form)}
    assert set(back) == {"00", "01", "cam 2", "10"}, "leading zeros and blanks in names survive"
    for camera in cameras:
        assert np.abs(back[camera.name].camera_from_world - camera.camera_from_world).max() < 1e-6
        assert np.abs(back[camera.name].intrinsics - camera.intrinsics).max() < 1e-6
        assert back[camera.name].wh == camera.wh
        assert not back[camera.name].distortion.any()


@pytest.mark.parametrize("fingers", [False, True])
@pytest.mark.parametrize(("form", "place"), [("openpose", "{}_json"), ("easymocap", "annots/{}")])
def test_exported_keypoints_come_back_the_same(tmp_path: Path, form: str, place: str, fingers: bool) -> None:
    rng = np.random.default_rng(3)
    points = np.concatenate([rng.uniform(5, 100, (5, 17, 2)), rng.uniform(0.2, 1, (5, 17, 1))], axis=-1)
    points[2, 4] = [np.nan, np.nan, 0.0]
    seen = Detections("cam00", "coco17", np.array([0, 0, 2, 3, 3]), np.array([0, 1, 0, 0, 1]), points)
    if fingers:
        hands = rng.uniform(0.2, 1, (5, 2, 21, 3))
        hands[1, 0] = [np.nan, np.nan, 0.0]
        seen = replace(seen, hands=hands.astype(np.float32))
        points = np.concatenate([points, seen.hands.reshape(5, 42, 3)], axis=1)
    camera = replace(ring([0], "cam")[0], name="cam00")
    numbers = keypoint_files.track_numbers(
        "cam00", {("cam00", 0): "p1", ("cam00", 1): "", ("cam01", 1): "p0"}, ["p0", "p1"]
    )
    assert numbers == {0: 1}, "rejected tracks and other cameras' tracks have no number"
    keypoint_files.WRITERS[form](tmp_path, seen, camera, 5, numbers)
    found = read_keypoints(tmp_path / place.format("cam00"))
    assert found.frame.tolist() == seen.frame.tolist()
    assert found.pictures.tolist() == list(range(5))
    for own, keypoints in zip(found.keypoints, points):
        present = keypoints[:, 2] > 0
        assert np.abs(own[present] - (keypoints[present] - [0.5, 0.5, 0])).max() < 1e-6
        assert not own[~present].any(), "a missing point is 0, 0, 0"
    if form == "easymocap":
        written = [read_json(f)["annots"] for f in sorted((tmp_path / place.format("cam00")).iterdir())]
        assert [one["personID"] for annots in written for one in annots] == [1, -1, 1, 1, -1]
    assert len(list((tmp_path / place.format("cam00")).iterdir())) == 5, "frames without people have files too"


def test_what_an_earlier_export_left_is_removed(tmp_path: Path, root: Path) -> None:
    write_scene(tmp_path, root, people=1, filmed=False)
    chosen = options(tmp_path, 1)
    call(export.run, **chosen)
    others = ("player.html", "player.jpg", "room.glb", "scene.glb", "scene.usdc", ".partial-7-player.html")
    for name in (*others, "old.txt"):
        (tmp_path / "deliver" / name).touch()
    call(export.run, **{**chosen, "gaussians": [], "avatars": [], "fits": [], "body": None})
    folder = tmp_path / "deliver"
    assert not list(folder.rglob("p0.*"))
    assert not (folder / "old.txt").exists()
    assert all((folder / name).exists() for name in others), "other steps' files, and those that they are writing"
    assert not (folder / "still.ply").exists()
    text = (folder / "README.txt").read_text()
    assert "0 people" in text
    assert not [line for line in text.splitlines() if line.startswith("bodies/  ")]


def test_the_readme_says_whose_fingers_are_in_which_files() -> None:
    about = "take", ["p0", "p1"], ["orbit"], 0, 5, 30.0
    assert "Fingers" not in export.readme_text(*about)
    assert "Fingers (p1)" in export.readme_text(*about, fingers=["p1"])


def test_keypoints_of_the_capture_are_delivered_with_identities(tmp_path: Path, root: Path) -> None:
    write_scene(tmp_path, root, people=1, filmed=False)
    chosen = options(tmp_path, 1)
    points = np.concatenate([np.full((1, 17, 2), 20.0), np.full((1, 17, 1), 0.9)], axis=-1)
    write_detections(tmp_path / "cam0.npz", Detections("cam0", "coco17", np.array([1]), np.array([4]), points))
    write_identities(tmp_path / "identities.tsv", {("cam0", 4): "p0"})
    call(export.run, **{**chosen, "detections": [tmp_path / "cam0.npz"], "identities": [tmp_path / "identities.tsv"]})
    written = [read_json(f)["annots"] for f in sorted((tmp_path / "deliver/keypoints/easymocap/annots/cam0").iterdir())]
    assert [(t, one["personID"]) for t, annots in enumerate(written) for one in annots] == [(1, 0)]
    assert "coco17" in (tmp_path / "deliver/README.txt").read_text()


def test_who_comes_later_is_not_in_the_still_picture_and_alone_as_they_came(root: Path) -> None:
    rng, body = np.random.default_rng(0), BodyModel.load(root / "resources/body.npz")
    background, first, second = room(rng), avatar(body, rng, "p0"), avatar(body, rng, "p1")
    late = replace(second, present=np.arange(FRAMES) >= 3)
    files = export.gaussian_files(background, [first, late], 0)
    assert files["still.ply"].count == background.count + first.gaussians.count
    np.testing.assert_array_equal(files["people/p1.ply"].means_m, second.posed(3).means_m)
    assert files["people/p1.ply"].logit_opacities.min() > 0
    np.testing.assert_array_equal(files["people/p0.ply"].means_m, first.posed(0).means_m)


# ---- The finished scene in memory equals its files, and broken Gaussians are refused before they are delivered ----

TAKEN = ("manifest", "model", "background", "provenance", "gaussians", "avatars", "body")


@pytest.fixture
def files(tmp_path: Path, root: Path) -> dict:
    cameras = write_scene(tmp_path, root, people=2, filmed=False)["training"]
    write_path(tmp_path / "render/orbit.json", [PathStep(cameras[0], 1.5, "00")], FPS)
    given = render_options(tmp_path, "orbit", people=2)
    return {name: given[name] for name in TAKEN} | {"paths": [tmp_path / "render/orbit.json"]}


def test_the_marks_of_another_room_are_refused(files: dict) -> None:
    write_npz(files["provenance"], {"provenance": np.zeros(3, np.uint8)})
    with pytest.raises(UserError, match=r"provenance\.npz .*\(3,\)"):
        call(read_finished, **files)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("whose", ["background", "p1"])
def test_a_gaussian_that_is_no_number_is_refused_in_one_sentence(files: dict, whose: str) -> None:
    path = files["background"] if whose == "background" else files["gaussians"][1]
    own = read_ply(path)
    means = own.means_m.copy()
    means[5, 1] = np.nan
    broken = replace(own, means_m=means)
    if whose == "background":
        write_ply(path, broken)
    else:
        replace_gaussians(path, files["avatars"][1], broken)
    with pytest.raises(UserError, match=rf"{path.name} .*1 of its Gaussians are not finite"):
        call(read_finished, **files)


def test_an_infinite_logit_is_an_opacity() -> None:
    zeros = np.zeros((2, 3))
    own = Gaussians(zeros, np.ones((2, 4)), zeros, np.array([np.inf, -np.inf]), np.zeros((2, 1, 3)))
    assert require_finite(own, Path("x.ply")) is own
