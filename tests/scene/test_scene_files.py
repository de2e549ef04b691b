# SPDX-License-Identifier: Apache-2.0
"""The nouns of a scene survive their files, and broken files are named."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from studiorecon.camera_files.colmap import read_model, write_model
from studiorecon.errors import UserError
from studiorecon.plan.discovery import open_dataset
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.files import atomic_path, read_json, read_table, write_json
from studiorecon.scene.numbered_files import missing_numbers_text, pictures_in
from studiorecon.scene.path import PathStep, read_path, write_path
from studiorecon.scene.schema import record
from studiorecon.scene.user_files import read_npz

from tests.made.file_contents import npy


def camera(name: str, seed: int) -> Camera:
    rng = np.random.default_rng(seed)
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    camera_from_world[:3, 3] = rng.normal(size=3)
    return Camera(name, (480, 272), np.array([[350.5, 0, 240.25], [0, 351.0, 137.5], [0, 0, 1]]), camera_from_world)


def test_projection_undoes_unprojection() -> None:
    cam = camera("a", 1)
    rng = np.random.default_rng(0)
    pixels, depth_m = rng.uniform(0, 480, (1000, 2)), rng.uniform(0.1, 20, 1000)
    back, back_depth = cam.project(cam.unproject(pixels, depth_m))
    np.testing.assert_allclose(back, pixels, atol=1e-9)
    np.testing.assert_allclose(back_depth, depth_m, rtol=1e-12)


def test_resizing_keeps_rays() -> None:
    cam = camera("a", 3)
    half = cam.resized((240, 136))
    np.testing.assert_allclose(
        half.unproject(np.array([[100.0, 50.0]]), np.ones(1)), cam.unproject(np.array([[200.0, 100.0]]), np.ones(1))
    )


def test_colmap_model_survives(tmp_path: Path) -> None:
    cameras = [camera("cam 1", 5), camera("02", 6)]
    write_model(tmp_path, cameras, np.array([[1.0, 2, 3]]))
    for before, after in zip(cameras, read_model(tmp_path)):
        assert (before.name, before.wh) == (after.name, after.wh)
        np.testing.assert_array_equal(before.intrinsics, after.intrinsics)
        np.testing.assert_allclose(before.camera_from_world, after.camera_from_world, atol=1e-14)


def test_colmap_model_is_read_by_pycolmap(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    cam = camera("cam1", 7)
    write_model(tmp_path, [cam])
    model = pycolmap.Reconstruction(str(tmp_path))
    image = next(iter(model.images.values()))
    np.testing.assert_allclose(image.cam_from_world().matrix(), cam.camera_from_world[:3], atol=1e-12)


def test_lens_and_path_survive_json(tmp_path: Path) -> None:
    lens = Lens("a", (640, 480), np.eye(3), "opencv", np.arange(5.0), np.eye(4), np.array([[1, 0, 0], [0, 1, 7.2]]))
    write_json(tmp_path / "lens.json", lens.as_json())
    back = record(Lens, read_json(tmp_path / "lens.json"))
    np.testing.assert_array_equal(back.distortion, lens.distortion)
    np.testing.assert_array_equal(back.calibration_from_video, lens.calibration_from_video)
    write_path(tmp_path / "path.json", [PathStep(camera("x", 8), 2.5, "00")], 30.0)
    steps, fps = read_path(tmp_path / "path.json")
    assert (steps[0].frame, steps[0].segment, fps) == (2.5, "00", 30.0)


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_json(path, {"x": 1})

    def fail_half_way() -> None:
        with atomic_path(path) as partial:
            partial.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_half_way()
    assert json.loads(path.read_text()) == {"x": 1}
    assert list(tmp_path.iterdir()) == [path]


def test_json_has_no_nan(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"x": np.float64("nan"), "y": np.arange(2)})
    assert json.loads((tmp_path / "a.json").read_text()) == {"x": None, "y": [0, 1]}


def test_broken_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("{")
    with pytest.raises(UserError, match=r"a\.json"):
        read_json(tmp_path / "a.json")
    (tmp_path / "a.tsv").write_text("camera\ttrack\n")
    with pytest.raises(UserError, match="no column 'person'"):
        read_table(tmp_path / "a.tsv", ("camera", "track", "person"))


class TestDataset:
    """Bad dataset directories give one sentence with the remedy."""

    @pytest.fixture
    def folder(self, tmp_path: Path) -> Path:
        (tmp_path / "videos").mkdir()
        for name in ("01", "02", "03"):
            (tmp_path / "videos" / f"{name}.mp4").touch()
            (tmp_path / "keypoints" / name).mkdir(parents=True)
        for name in ("intri.yml", "extri.yml"):
            (tmp_path / name).touch()
        return tmp_path

    def test_conventional_names_are_found(self, folder: Path) -> None:
        (folder / "capture.yaml").write_text("held_out: ['03']\nframes: {first: 5, count: 7}\n")
        dataset = open_dataset(folder)
        assert (dataset.training, dataset.held_out) == (("01", "02"), ("03",))
        assert (dataset.starts, dataset.first_frame, dataset.frame_count) == ({}, 5, 7)
        assert [p.name for p in dataset.calibration] == ["intri.yml", "extri.yml"]
        assert set(dataset.keypoints) == {"01", "02", "03"}
        assert dataset.identities is None
        (folder / "identities.tsv").touch()
        assert open_dataset(folder).identities == folder / "identities.tsv"

    @pytest.mark.parametrize(
        ("text", "starts"),
        [
            ("starts: {'02': 13}", (0, 13, 0)),
            ("starts: {'02': -13.4}", (0, -13.4, 0)),
            ("starts: {'01': 2, '02': 9, '03': -4}\ntrain: ['01', '02']", (2, 9)),
            ("frames: {first: 3}", ()),
        ],
        ids=["started early", "started late, between two frames", "a camera that is not used", "nothing said"],
    )
    def test_cameras_that_were_not_started_together(self, folder: Path, text: str, starts: tuple[float, ...]) -> None:
        (folder / "capture.yaml").write_text(text)
        assert tuple(open_dataset(folder).starts.values()) == starts


def test_an_array_that_promises_more_than_it_holds_reserves_nothing(tmp_path: Path) -> None:
    whole = npy(np.zeros((4, 4)))
    promised = whole.replace(b"(4, 4)", b"(4, 9999999999)").replace(b" " * 9 + b"\n", b"\n", 1)
    with zipfile.ZipFile(tmp_path / "k.npz", "w") as archive:
        archive.writestr("keypoints.npy", promised)
    with pytest.raises(UserError, match=r"promises|not a readable array"):
        read_npz(tmp_path / "k.npz")


def test_numbered_pictures_come_in_the_order_of_their_numbers_and_gaps_are_named(tmp_path: Path) -> None:
    for number in (*range(12), 14, 15, 20):
        (tmp_path / f"{number}.png").touch()
    found = pictures_in(tmp_path)
    assert [int(p.stem) for p in found] == [*range(12), 14, 15, 20]
    assert missing_numbers_text(found) == "12, 13, 16 and 3 more"
    assert missing_numbers_text(found[:12]) == ""
