# SPDX-License-Identifier: Apache-2.0
"""Calibrations of research captures (EgoHumans, Dynamic 3D Gaussians, MonoFusion, Ego-Exo4D, LLFF, ZJU) and their
traps."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.calibration import files as calibration
from studiorecon.calibration.formats.pickles import read_pickle
from studiorecon.calibration.names import pairings_in_order
from studiorecon.camera_files.colmap import quaternion_from_rotation
from studiorecon.configuration import settings as settings_module
from studiorecon.errors import UserError
from studiorecon.geometry.rotations import exp
from studiorecon.plan.discovery import open_dataset
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import read_json

from tests.made.cameras import ring
from tests.made.imported import imported

_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def named_ring() -> list[Camera]:
    return [replace(c, name=f"cam{i:02d}") for i, c in enumerate(ring())]


def write_egohumans(folder: Path, cameras: list[Camera], harmony: bool = False) -> list[Path]:
    """A COLMAP world that is turned, shifted and 0.37 times as large as the metric one, with two pictures of moving
    glasses."""
    colmap_from_metric = np.eye(4)
    colmap_from_metric[:3, :3], colmap_from_metric[:3, 3] = 0.37 * exp(np.array([0.3, -0.8, 1.1])), [1.5, -2.0, 0.7]
    lines, models = [], []
    for i, c in enumerate(cameras):
        block = c.camera_from_world @ np.linalg.inv(colmap_from_metric)
        rotation, t = block[:3, :3] * 0.37, block[:3, 3] * 0.37
        pose = [*quaternion_from_rotation(rotation), *t]
        lines.append(
            f"{i + 1} " + " ".join(f"{v:.17g}" for v in pose) + f" {i + 1} {c.name}/00001.jpg\n1.0 2.0 -1 3.0 4.0 7"
        )
        numbers = [*c.focal_px, *c.principal_px, -0.02, 0.003, 0.0, 0.0]
        models.append(f"{i + 1} OPENCV_FISHEYE {c.wh[0]} {c.wh[1]} " + " ".join(f"{v:.17g}" for v in numbers))
    for n, turn in enumerate((0.1, 0.9)):
        q = quaternion_from_rotation(exp(np.array([0, turn, 0])))
        lines.append(f"{90 + n} " + " ".join(map(str, [*q, n, 0.0, 0.0])) + f" 90 aria01/0000{n}.jpg\n")
    models.append("90 OPENCV_FISHEYE 1408 1408 600 600 704 704 0 0 0 0")
    paths = [
        folder / "cameras.txt",
        folder / "images.txt",
        folder / ("scale.npy" if harmony else "colmap_from_aria_transforms.pkl"),
    ]
    paths[0].write_text("# 1\n# 2\n# 3\n" + "\n".join(models) + "\n")
    paths[1].write_text("# 1\n# 2\n# 3\n# 4\n" + "\n".join(lines) + "\n")
    if harmony:
        np.save(paths[2], np.linalg.inv(colmap_from_metric))
    else:
        paths[2].write_bytes(pickle.dumps({"aria02": np.eye(4), "aria01": colmap_from_metric}))
    return paths


def write_dynamic(folder: Path, cameras: list[Camera]) -> list[Path]:
    names = [c.name for c in cameras]
    content = {"w": cameras[0].wh[0], "h": cameras[0].wh[1], "k": [], "w2c": [], "fn": []}
    for t in range(3):
        content["k"].append([c.intrinsics.tolist() for c in cameras])
        content["w2c"].append([c.camera_from_world.tolist() for c in cameras])
        content["fn"].append([f"{n}/{t:06d}.jpg" for n in names])
    (folder / "train_meta.json").write_text(json.dumps(content))
    return [folder / "train_meta.json"]


def write_monofusion(folder: Path, cameras: list[Camera], convention: str | None = None) -> list[Path]:
    poses = [(c.camera_from_world if convention == "w2c" else c.world_from_camera).tolist() for c in cameras]
    content = {"hw": [list(c.hw) for c in cameras], "k": [[c.intrinsics.tolist() for c in cameras]], "w2c": [poses]}
    content |= {"camera_convention": convention} if convention else {}
    (folder / "Dy_train_meta.json").write_text(json.dumps(content))
    return [folder / "Dy_train_meta.json"]


def write_egoexo(folder: Path, cameras: list[Camera]) -> list[Path]:
    axes = [f"t{a}_world_cam" for a in "xyz"] + [f"q{a}_world_cam" for a in "wxyz"]
    rows = [",".join(["cam_uid", "image_width", "image_height", *axes, *(f"intrinsics_{i}" for i in range(8))])]
    for c in cameras:
        numbers = [*c.centre_m, *quaternion_from_rotation(c.world_from_camera[:3, :3]), *c.focal_px]
        numbers += [*(v - 0.5 for v in c.principal_px), -0.02, 0.003, 0.0, 0.0]
        rows.append(",".join([c.name, *map(str, c.wh), *(f"{v:.17g}" for v in numbers)]))
    (folder / "gopro_calibs.csv").write_text("\n".join(rows) + "\n")
    return [folder / "gopro_calibs.csv"]


def write_llff(folder: Path, cameras: list[Camera]) -> list[Path]:
    rows = []
    for c in cameras:
        right, down, forward, centre = c.world_from_camera[:3].T
        block = np.stack([down, right, -forward, centre, [c.wh[1], c.wh[0], c.focal_px[0]]], axis=1)
        rows.append([*block.reshape(-1), 1.0, 9.0])
    np.save(folder / "poses_bounds.npy", np.array(rows))
    return [folder / "poses_bounds.npy"]


def write_zju(folder: Path, cameras: list[Camera]) -> list[Path]:
    shift = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    cams = {
        "K": [(c.intrinsics - shift).tolist() for c in cameras],
        "D": [np.zeros((5, 1)) for _ in cameras],
        "R": [c.camera_from_world[:3, :3] for c in cameras],
        "T": [1000 * c.camera_from_world[:3, 3:] for c in cameras],
    }
    content = {"cams": cams, "ims": [{"ims": [f"{c.name}/000000.jpg" for c in cameras]}]}
    np.save(folder / "annots.npy", np.array(content, dtype=object), allow_pickle=True)
    return [folder / "annots.npy"]


WRITERS = {
    "C4 EgoHumans": write_egohumans,
    "C5 Harmony4D": lambda f, c: write_egohumans(f, c, harmony=True),
    "C9 Dynamic 3D Gaussians": write_dynamic,
    "C10 MonoFusion c2w named w2c": write_monofusion,
    "C10 MonoFusion w2c": lambda f, c: write_monofusion(f, c, "w2c"),
    "C10 Ego-Exo4D": write_egoexo,
    "C11 LLFF": write_llff,
    "C11 ZJU": write_zju,
}


@pytest.fixture
def options(default_settings):
    def load(**changed):
        return settings_module.load(calibration.Settings, default_settings("cameras", **changed), "cameras")

    return load


@pytest.mark.parametrize("form", WRITERS)
def test_every_research_format_gives_the_same_cameras(tmp_path, options, form):
    cameras = named_ring()
    names = [c.name for c in cameras]
    imported(options(), WRITERS[form](tmp_path, cameras), names[::-1], "{}", tmp_path / "out.json")
    found = read_json(tmp_path / "out.json")
    by_name = {v["name"]: v for v in found["lenses"]}
    assert list(by_name) == names[::-1]
    for camera in cameras:
        lens = by_name[camera.name]
        assert np.abs(np.array(lens["camera_from_world"]) - camera.camera_from_world).max() < 1e-6
        assert np.abs(np.array(lens["intrinsics"]) - camera.intrinsics).max() < 1e-9
        assert tuple(lens["wh"]) == ((0, 0) if "ZJU" in form else camera.wh)
        fisheye = form in ("C4 EgoHumans", "C5 Harmony4D", "C10 Ego-Exo4D")
        assert lens["model"] == ("fisheye" if fisheye else "opencv")
        assert not fisheye or lens["distortion"][:2] == [-0.02, 0.003]


def test_the_scale_inside_a_rotation_is_taken_out(tmp_path):
    """C4: multiplying by the glasses' similarity and stopping there would leave a scaled, non-orthonormal rotation."""
    for camera in calibration.read_calibration(write_egohumans(tmp_path, named_ring())).cameras:
        rotation = camera.camera_from_world[:3, :3]
        assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-12
        assert np.linalg.det(rotation) == pytest.approx(1)


def test_glasses_are_left_out_and_said_so(tmp_path):
    reading = calibration.read_calibration(write_egohumans(tmp_path, named_ring()))
    assert [c.name for c in reading.cameras] == [c.name for c in named_ring()]
    assert any("glasses" in n for n in reading.notes)


def test_a_pickle_that_would_run_a_program_is_not_opened(tmp_path):
    class Spiteful:
        def __reduce__(self):
            return (exec, (f"open({str(tmp_path / 'ran')!r}, 'w')",))

    path = tmp_path / "annots.npy"
    path.write_bytes(pickle.dumps(Spiteful()))
    with pytest.raises(UserError, match=r"asks for builtins\.exec"):
        read_pickle(path)
    assert not (tmp_path / "ran").exists()


def test_a_camera_that_moves_is_left_out_by_name(tmp_path):
    path = write_dynamic(tmp_path, named_ring())[0]
    content = json.loads(path.read_text())
    content["w2c"][2][1] = (
        np.array(content["w2c"][2][1]) @ np.block([[exp(np.array([0, 0.2, 0])), np.zeros((3, 1))], [0, 0, 0, 1]])
    ).tolist()
    path.write_text(json.dumps(content))
    found = calibration.read_calibration([path])
    assert [c.name for c in found.cameras] == ["cam00", "cam02", "cam03"]
    assert any("cam01 moves (by 11.5" in note for note in found.notes)


def test_cameras_without_names_need_the_same_number_of_videos():
    assert pairings_in_order(["cam10", "cam2", "cam1"], 3, "x")[0].calibrated == {
        "cam1": "0",
        "cam2": "1",
        "cam10": "2",
    }
    with pytest.raises(UserError, match="21 cameras without names, the footage has 2"):
        pairings_in_order(["cam00", "cam01"], 21, "poses_bounds.npy")


@pytest.mark.parametrize("poses", ["world_from_camera", "opengl", "world_from_camera_opengl"])
def test_the_switch_reads_poses_that_break_their_convention(poses):
    camera = ring()[1]
    wrong = {
        "world_from_camera": camera.world_from_camera,
        "opengl": _FLIP @ camera.camera_from_world,
        "world_from_camera_opengl": camera.world_from_camera @ _FLIP,
    }[poses]
    assert np.abs(calibration.normalise_pose(wrong, poses) - camera.camera_from_world).max() < 1e-12
    assert np.abs(calibration.normalise_pose(camera.camera_from_world, "as_read") - camera.camera_from_world).max() == 0


def test_the_format_switch_overrules_sniffing(tmp_path, options):
    path = write_dynamic(tmp_path, named_ring())[0]
    assert calibration.read_calibration([path], "train_meta").format.startswith("Dynamic")
    with pytest.raises(UserError, match=r"fl_x|no frames"):
        calibration.read_calibration([path], "nerfstudio")


@pytest.mark.parametrize(
    ("files", "calibration_files", "cameras"),
    [
        (
            ["exo/cam01/images/00001.jpg", "exo/cam02/images/00001.jpg"],
            ["colmap/workplace/scale.npy"],
            ["cam01", "cam02"],
        ),
        (["ims/0/0.jpg", "ims/1/0.jpg"], ["train_meta.json"], ["0", "1"]),
        (["cam00.mp4", "cam01.mp4", "notes.txt"], ["poses_bounds.npy"], ["cam00", "cam01"]),
        (
            ["frame_aligned_videos/gp01.mp4", "frame_aligned_videos/gp02.mp4"],
            ["trajectory/gopro_calibs.csv"],
            ["gp01", "gp02"],
        ),
    ],
)
def test_captures_are_found_where_their_makers_put_them(tmp_path, files, calibration_files, cameras):
    extra = ["colmap/workplace/cameras.txt", "colmap/workplace/images.txt"] if "scale" in calibration_files[0] else []
    for name in [*files, *calibration_files, *extra]:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    data = open_dataset(tmp_path)
    assert list(data.cameras) == cameras
    assert {str(p.relative_to(tmp_path)) for p in data.calibration} == {*calibration_files, *extra}
