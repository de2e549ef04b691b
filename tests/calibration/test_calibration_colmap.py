# SPDX-License-Identifier: Apache-2.0
"""COLMAP models that COLMAP's own library writes: rigs whose ``images.txt`` is stale, every lens model, broken
files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from studiorecon.calibration import files as calibration
from studiorecon.camera_files.colmap import quaternion_from_rotation
from studiorecon.camera_files.colmap_models import posed_pictures
from studiorecon.errors import UserError
from studiorecon.geometry.distortion import distort
from studiorecon.geometry.rotations import exp
from studiorecon.plan.discovery import open_dataset
from studiorecon.render.path_file import GivenPath, path_steps
from studiorecon.scene.camera import Camera
from studiorecon.scene.dataset import colmap_files

from tests.made.cameras import ring

STALE_DEG = 63.0
LENSES = {
    "SIMPLE_PINHOLE": [700.0, 640.5, 352.25],
    "PINHOLE": [700.0, 705.0, 640.5, 352.25],
    "SIMPLE_RADIAL": [700.0, 640.5, 352.25, -0.11],
    "RADIAL": [700.0, 640.5, 352.25, -0.11, 0.02],
    "OPENCV": [700.0, 705.0, 640.5, 352.25, -0.11, 0.02, 0.001, -0.002],
    "FULL_OPENCV": [700.0, 705.0, 640.5, 352.25, -0.11, 0.02, 0.001, -0.002, 0.003, 0.01, -0.004, 0.002],
    "OPENCV_FISHEYE": [700.0, 705.0, 640.5, 352.25, -0.02, 0.003, 0.001, -0.002],
    "SIMPLE_RADIAL_FISHEYE": [700.0, 640.5, 352.25, -0.02],
    "RADIAL_FISHEYE": [700.0, 640.5, 352.25, -0.02, 0.003],
    "SIMPLE_FISHEYE": [700.0, 640.5, 352.25],
    "FISHEYE": [700.0, 705.0, 640.5, 352.25],
}


def rigid(camera_from_world: np.ndarray) -> pycolmap.Rigid3d:
    w, x, y, z = quaternion_from_rotation(camera_from_world[:3, :3])
    return pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([x, y, z, w])), camera_from_world[:3, 3])


def rig_model(
    cameras: list[Camera], model: str = "PINHOLE", parameters: list[float] | None = None
) -> pycolmap.Reconstruction:
    """All cameras as sensors of one rig, seen in one frame, one 3D point's worth of observations."""
    made = pycolmap.Reconstruction()
    rig, frame = pycolmap.Rig(rig_id=1), pycolmap.Frame(frame_id=1, rig_id=1)
    for index, camera in enumerate(cameras, start=1):
        own = [*camera.focal_px, *camera.principal_px] if parameters is None else parameters
        made.add_camera(
            pycolmap.Camera(model=model, width=camera.wh[0], height=camera.wh[1], params=own, camera_id=index)
        )
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, index)
        if index == 1:
            rig.add_ref_sensor(sensor)
        else:
            rig.add_sensor(sensor, rigid(camera.camera_from_world @ cameras[0].world_from_camera))
        frame.add_data_id(pycolmap.data_t(sensor, index))
    frame.rig_from_world = rigid(cameras[0].camera_from_world)
    made.add_rig(rig)
    made.add_frame(frame)
    for index, camera in enumerate(cameras, start=1):
        image = pycolmap.Image(name=f"{camera.name}/00001.jpg", camera_id=index, image_id=index)
        image.frame_id = 1
        made.add_image(image)
    made.register_frame(1)
    return made


def stale_rig(folder: Path, suffix: str) -> list[Camera]:
    """A rig's model in ``folder`` whose images file has every camera but the first turned by 63°; the truth."""
    cameras = [Camera(f"cam{i:02d}", c.wh, c.intrinsics, c.camera_from_world) for i, c in enumerate(ring())]
    turned = [cameras[0]]
    for camera in cameras[1:]:
        pose = camera.camera_from_world.copy()
        pose[:3, :3] = exp(np.radians([0.0, STALE_DEG, 0.0])) @ pose[:3, :3]
        turned.append(Camera(camera.name, camera.wh, camera.intrinsics, pose))
    for name, held in (("right", cameras), ("stale", turned)):
        (folder / name).mkdir(parents=True)
        model = rig_model(held)
        model.write_binary(str(folder / name)) if suffix == ".bin" else model.write_text(str(folder / name))
    for name in ("cameras", "rigs", "frames"):
        (folder / "stale" / f"{name}{suffix}").write_bytes((folder / "right" / f"{name}{suffix}").read_bytes())
    (folder / "stale" / f"points3D{suffix}").unlink()
    return cameras


def angles_deg(found: list, truth: list[Camera]) -> np.ndarray:
    by_name = {camera.name: camera for camera in truth}
    turns = [f.camera_from_world[:3, :3] @ by_name[f.name].camera_from_world[:3, :3].T for f in found]
    return np.degrees([np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)) for turn in turns])


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
def test_poses_of_a_rig_come_from_rigs_and_frames(tmp_path, suffix):
    truth = stale_rig(tmp_path, suffix)
    images = tmp_path / "stale" / f"images{suffix}"
    alone = posed_pictures([images.with_name(f"cameras{suffix}"), images])
    assert angles_deg(alone, truth)[1:] == pytest.approx(STALE_DEG), (
        "the images file by itself is stale, or this proves nothing"
    )
    found = calibration.read_calibration(colmap_files(images))
    assert [camera.name for camera in found.cameras] == [camera.name for camera in truth]
    for camera, expected in zip(found.cameras, truth):
        np.testing.assert_allclose(camera.camera_from_world, expected.camera_from_world, atol=1e-12)
        np.testing.assert_allclose(camera.intrinsics, expected.intrinsics, atol=1e-12)


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
@pytest.mark.parametrize(
    "named", ["", "calibration: [sparse/0/cameras{0}, sparse/0/images{0}]\n"], ids=["found", "named"]
)
def test_a_dataset_brings_rigs_and_frames_along(tmp_path, suffix, named):
    stale_rig(tmp_path / "made", suffix)
    (tmp_path / "sparse").mkdir()
    (tmp_path / "made" / "stale").rename(tmp_path / "sparse" / "0")
    for name in ("cam00", "cam01"):
        (tmp_path / "videos").mkdir(exist_ok=True)
        (tmp_path / "videos" / f"{name}.mp4").touch()
    (tmp_path / "capture.yaml").write_text(named.format(suffix))
    assert [p.name for p in open_dataset(tmp_path).calibration] == [
        f"{n}{suffix}" for n in ("cameras", "images", "rigs", "frames")
    ]


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
def test_a_film_follows_a_rig_where_it_really_was(tmp_path, suffix):
    truth = stale_rig(tmp_path, suffix)
    steps = path_steps(
        GivenPath("path", str(tmp_path / "stale" / f"images{suffix}"), "stretch"), "fly", truth[0].wh, 10
    )
    for step, camera in zip(steps, truth, strict=True):
        np.testing.assert_allclose(step.camera.camera_from_world, camera.camera_from_world, atol=1e-12)


@pytest.mark.parametrize("model", LENSES)
def test_every_supported_lens_bends_rays_as_colmap_does(tmp_path, model):
    rig_model(ring()[:1], model, LENSES[model]).write_binary(str(tmp_path))
    (camera,) = posed_pictures(colmap_files(tmp_path / "images.bin"))
    rays = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 2))
    bent = distort(rays, camera.model, camera.distortion)
    ours = bent * camera.intrinsics[[0, 1], [0, 1]] + camera.intrinsics[:2, 2]
    theirs = pycolmap.Camera(model=model, width=1280, height=704, params=LENSES[model], camera_id=1)
    np.testing.assert_allclose(ours, [theirs.img_from_cam(np.array([*ray, 1.0])) for ray in rays], atol=1e-9)


@pytest.mark.parametrize("model", ["FOV", "THIN_PRISM_FISHEYE"])
def test_another_lens_is_one_sentence(tmp_path, model):
    parameters = [700.0, 705.0, 640.5, 352.25, *[0.01] * (8 if model != "FOV" else 1)]
    rig_model(ring()[:1], model, parameters).write_text(str(tmp_path))
    with pytest.raises(UserError, match=f"camera 1 .*{model}.*undistort.*OPENCV_FISHEYE"):
        posed_pictures(colmap_files(tmp_path / "images.txt"))


@pytest.mark.parametrize("part", ["cameras", "images", "rigs", "frames"])
@pytest.mark.parametrize("missing", [3, 8, 40])
def test_a_binary_file_that_ends_early_is_refused(tmp_path, part, missing):
    rig_model(ring()).write_binary(str(tmp_path))
    path = tmp_path / f"{part}.bin"
    path.write_bytes(path.read_bytes()[:-missing])
    with pytest.raises(UserError, match=r"cannot read the model in|ends in the middle"):
        posed_pictures(colmap_files(tmp_path / "images.bin"))


def test_files_of_two_models_are_refused(tmp_path):
    for name, count in (("a", 2), ("b", 4)):
        (tmp_path / name).mkdir()
        rig_model(ring()[:count]).write_text(str(tmp_path / name))
    with pytest.raises(UserError, match=r"cannot read the model in .*cameras.txt, images.txt.* all from one model"):
        posed_pictures([tmp_path / "a" / "cameras.txt", tmp_path / "b" / "images.txt"])


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
def test_names_keep_their_blanks_and_their_accents(tmp_path, suffix):
    camera = Camera("côté jardin 2", *(getattr(ring()[0], name) for name in ("wh", "intrinsics", "camera_from_world")))
    model = rig_model([camera])
    model.write_binary(str(tmp_path)) if suffix == ".bin" else model.write_text(str(tmp_path))
    assert [found.name for found in posed_pictures(colmap_files(tmp_path / f"images{suffix}"))] == [camera.name]


def test_the_user_s_points_stay_as_they_are(tmp_path):
    rig_model(ring()).write_binary(str(tmp_path))
    points = tmp_path / "points3D.bin"
    points.write_bytes(b"a gigabyte of points")
    assert calibration.read_calibration([tmp_path / "cameras.bin", tmp_path / "images.bin", points]).format == "COLMAP"
    assert points.read_bytes() == b"a gigabyte of points"


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
def test_files_may_have_names_in_any_case(tmp_path, suffix):
    model = rig_model(ring())
    model.write_text(str(tmp_path)) if suffix == ".txt" else model.write_binary(str(tmp_path))
    files = [path.rename(path.with_name(path.name.upper())) for path in sorted(tmp_path.iterdir())]
    found = calibration.read_calibration([path for path in files if "POINTS" not in path.name])
    assert [camera.name for camera in found.cameras] == [camera.name for camera in ring()]
