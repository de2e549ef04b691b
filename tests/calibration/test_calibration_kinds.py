# SPDX-License-Identifier: Apache-2.0
"""Every named lens kind is read or refused by name, and what is dropped of a file is said."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from studiorecon.calibration.files import Settings, paired_lenses, read_calibration
from studiorecon.calibration.formats.lenses import find_lenses, read_lenses, unused_reason
from studiorecon.errors import UserError
from studiorecon.plan.discovery import find_calibration, open_dataset
from studiorecon.scene.capture_yaml import by_camera

from tests.made.cameras import ring
from tests.made.cameras_parts import matrix

SKEW = np.array([[0, 2.0, 0], [0, 0, 0], [0, 0, 0]])
FISHEYE = [0.03, -0.01, 0.002, -0.0005]


def transforms(folder: Path, top: dict, frame: dict | None = None) -> Path:
    poses = [[[1.0, 0, 0, x], [0, 0, -1.0, 0], [0, 1.0, 0, 1.5], [0, 0, 0, 1]] for x in (0.0, 3.0)]
    content = {"fl_x": 600.0, "w": 1280, "h": 960, **dict(zip(("k1", "k2", "k3", "k4"), FISHEYE)), **top}
    frames = [{"file_path": f"images/{n}.png", "transform_matrix": p, **(frame or {})} for n, p in zip("ab", poses)]
    path = folder / "transforms.json"
    path.write_text(json.dumps({**content, "frames": frames}))
    return path


@pytest.mark.parametrize(
    ("top", "frame", "model"),
    [
        ({}, {}, "opencv"),
        *(
            ({"camera_model": m}, {}, "opencv")
            for m in ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "FULL_OPENCV")
        ),
        *(
            ({"camera_model": m}, {}, "fisheye")
            for m in ("OPENCV_FISHEYE", "FISHEYE", "RADIAL_FISHEYE", "opencv_fisheye")
        ),
        ({"is_fisheye": True}, {}, "fisheye"),
        ({}, {"is_fisheye": True}, "fisheye"),
        ({"is_fisheye": True}, {"camera_model": "OPENCV"}, "opencv"),
        ({"camera_model": "OPENCV"}, {"camera_model": "OPENCV_FISHEYE"}, "fisheye"),
    ],
)
def test_every_lens_kind_of_transforms_is_read_as_what_it_is(tmp_path, top, frame, model):
    camera = read_calibration([transforms(tmp_path, top, frame)]).cameras[0]
    assert camera.model == model
    expected = FISHEYE if model == "fisheye" else [0.03, -0.01, 0, 0, 0.002, -0.0005, 0, 0]
    assert np.allclose(camera.distortion, expected)


@pytest.mark.parametrize(("angles", "focal"), [({"x": 1.2}, (935.5, 935.5)), ({"x": 1.2, "y": 1.0}, (935.5, 878.6))])
def test_angles_of_view_give_focal_lengths(tmp_path, angles, focal):
    path = transforms(tmp_path, {f"camera_angle_{axis}": angle for axis, angle in angles.items()})
    content = {k: v for k, v in json.loads(path.read_text()).items() if k != "fl_x"}
    path.write_text(json.dumps(content))
    intrinsics = read_calibration([path]).cameras[0].intrinsics
    assert np.allclose(intrinsics[[0, 1], [0, 1]], focal, atol=0.1)
    path.write_text(json.dumps({k: v for k, v in content.items() if k != "camera_angle_x"}))
    with pytest.raises(UserError, match="has no fl_x or camera_angle_x; write it there"):
        read_calibration([path])


def test_tables_without_names_are_called_after_their_keys(tmp_path):
    path = tmp_path / "Calib.toml"
    table = (
        "[{}]\nsize = [1280, 704]\nmatrix = [[900.0, 0.0, 640.0], [0.0, 900.0, 352.0], [0.0, 0.0, 1.0]]\n"
        "distortions = [0.0, 0.0, 0.0, 0.0, 0.0]\nrotation = [0.1, 0.2, 0.3]\ntranslation = [0.0, 0.0, 4.0]\n"
    )
    path.write_text("".join(table.format(key) for key in ("left", "right")))
    assert [c.name for c in read_calibration([path]).cameras] == ["left", "right"]
    for size in ('["1280", "704"]', "[1280]"):
        path.write_text(table.format("left").replace("[1280, 704]", size))
        with pytest.raises(UserError, match=r"camera left .*: its size"):
            read_calibration([path])


def test_a_file_of_cameras_may_have_the_ending_of_transforms(tmp_path):
    camera = {"K": np.diag([900.0, 900.0, 1.0]).tolist(), "R": np.eye(3).tolist(), "T": [0.0, 0.0, 4.0]}
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps({"left": camera, "right": camera}))
    assert [c.name for c in read_calibration([path]).cameras] == ["left", "right"]


@pytest.mark.parametrize(
    "model", ["FISHEYE624", "EQUIRECTANGULAR", "ORTHOPHOTO", "THIN_PRISM_FISHEYE", "VR180_L", "new"]
)
@pytest.mark.parametrize("place", ["top", "frame"])
def test_an_unknown_lens_is_refused_by_name(tmp_path, model, place):
    named = {"camera_model": model}
    with pytest.raises(UserError, match=f"{model}.*not supported"):
        read_calibration([transforms(tmp_path, named if place == "top" else {}, named if place == "frame" else {})])


@pytest.mark.parametrize(
    "odd",
    [
        {"is_fisheye": True, "camera_model": "OPENCV"},
        {"is_fisheye": "maybe"},
        {"is_fisheye": True, "p1": 0.01},
        {"sx1": 0.1},
    ],
)
def test_contradictions_and_terms_that_a_lens_lacks_are_refused(tmp_path, odd):
    with pytest.raises(UserError, match="picture 0"):
        read_calibration([transforms(tmp_path, odd)])


def test_an_unknown_lens_in_toml_is_refused(tmp_path):
    table = (
        '[c0]\nname = "c0"\nmatrix = [[900.0, 0.0, 640.0], [0.0, 900.0, 360.0], [0.0, 0.0, 1.0]]\nsize = [1280, 720]\n'
    )
    table += "rotation = [0.0, 0.0, 0.0]\ntranslation = [0.0, 0.0, 3.0]\n"
    path = tmp_path / "Calib.toml"
    path.write_text(table + 'model = "omnidirectional"\ndistortions = [0.1, 0.2, 0.3, 0.4]\n')
    with pytest.raises(UserError, match="omnidirectional"):
        read_calibration([path])
    path.write_text(table + "distortions = [0.1, 0.2, 0.3]\n")
    with pytest.raises(UserError, match="3 distortion coefficients"):
        read_calibration([path])


SPELLINGS = [
    ("CameraMatrix", "DistortionCoeffs", "Rotation", "Translation"),
    ("camera_matrix", "distortion_coefficients", "R", "T"),
    ("K", "dist", "rvec", "tvec"),
]


def storage(folder: Path, spelling: tuple[str, ...], suffix: str, posed: bool = True, wh: bool = True) -> list[Path]:
    paths = []
    for camera in ring():
        k = camera.intrinsics - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
        pose = camera.camera_from_world
        values = [k, np.array([[-0.1, 0.01, 0.001, 0.002, 0.003]]), pose[:3, :3], pose[:3, 3:]][: 4 if posed else 2]
        path = folder / f"{camera.name}{suffix}"
        if suffix == ".xml":
            body = "".join(
                f'<{n} type_id="opencv-matrix"><rows>{len(v)}</rows><cols>{v.shape[1]}</cols><dt>d</dt>'
                f"<data>{' '.join(map(repr, v.reshape(-1).tolist()))}</data></{n}>"
                for n, v in zip(spelling, values)
            )
            size = "<image_width>1280</image_width><image_height>704</image_height>" if wh else ""
            path.write_text(f'<?xml version="1.0"?><opencv_storage>{size}{body}</opencv_storage>')
        else:
            size = "image_width: 1280\nimage_height: 704\n" if wh else ""
            path.write_text("%YAML:1.0\n---\n" + size + "".join(matrix(n, v) for n, v in zip(spelling, values)))
        paths.append(path)
    return paths


@pytest.mark.parametrize("suffix", [".xml", ".yml", ".yaml"])
@pytest.mark.parametrize("spelling", SPELLINGS)
def test_one_file_per_camera_of_opencv_is_a_calibration(tmp_path, suffix, spelling):
    storage(tmp_path, spelling, suffix)
    found = read_calibration(find_calibration(tmp_path))
    assert [c.name for c in found.cameras] == [c.name for c in ring()]
    for camera, truth in zip(found.cameras, ring()):
        assert camera.wh == truth.wh
        assert np.allclose(camera.intrinsics, truth.intrinsics)
        assert np.allclose(camera.camera_from_world, truth.camera_from_world)
        assert np.allclose(camera.distortion[:5], [-0.1, 0.01, 0.001, 0.002, 0.003])


def test_ros_s_camera_info_with_a_pose_is_one_too(tmp_path):
    camera = ring()[0]
    k = (camera.intrinsics - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]).reshape(-1).tolist()
    lines = [
        "image_width: 1280\nimage_height: 704\ndistortion_model: plumb_bob",
        f"camera_matrix: {{rows: 3, cols: 3, data: {k}}}",
        "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}",
        f"extrinsics: {camera.camera_from_world.tolist()}",
    ]
    (tmp_path / "c0.yaml").write_text("\n".join(lines))
    found = read_calibration(find_calibration(tmp_path)).cameras[0]
    assert np.allclose(found.camera_from_world, camera.camera_from_world)
    (tmp_path / "c0.yaml").write_text("\n".join(lines).replace("plumb_bob", "double_sphere"))
    with pytest.raises(UserError, match="double_sphere"):
        read_calibration(find_calibration(tmp_path))


def test_lenses_without_poses_are_found_and_read(tmp_path):
    storage(tmp_path, SPELLINGS[1], ".xml", posed=False)
    assert find_calibration(tmp_path) == ()
    files = find_lenses(tmp_path)
    assert [c.name for c in read_lenses(files)] == [c.name for c in ring()]
    (tmp_path / "videos").mkdir()
    for camera in ring():
        (tmp_path / "videos" / f"{camera.name}.mp4").write_bytes(camera.name.encode())
    assert open_dataset(tmp_path).lenses == files


def test_what_looks_like_a_calibration_and_was_not_used_is_named(tmp_path):
    used = storage(tmp_path, SPELLINGS[0], ".xml")
    (tmp_path / "transforms.json").write_text("{}")
    (tmp_path / "rig.json").write_text('{"intrinsics": {"focal": 3}, "distortion": 4}')
    (tmp_path / "notes.txt").write_text("two people walk")
    (tmp_path / "intri.yml").write_text("%YAML:1.0\n---\n" + matrix("K_a", np.eye(3)))
    assert unused_reason(used[0], used) is None
    assert "c0.xml was used" in unused_reason(tmp_path / "transforms.json", used)
    assert "unknown format" in unused_reason(tmp_path / "rig.json", used)
    assert "extri.yml" in unused_reason(tmp_path / "intri.yml", used)
    assert unused_reason(tmp_path / "notes.txt", used) is None


def read_with(folder: Path, change) -> list[str]:
    """The notes about a calibration of OpenCV whose first camera matrix was changed."""
    storage(folder, SPELLINGS[2], ".yml")
    k = ring()[0].intrinsics - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
    path = folder / "c0.yml"
    path.write_text(path.read_text().replace(matrix("K", k), matrix("K", change(k))))
    reading = read_calibration(find_calibration(folder))
    return paired_lenses(reading, "c0.yml", [c.name for c in ring()], {}, Settings(unit="m", up="z"))[1]


def test_skew_and_scale_of_a_camera_matrix_are_said(tmp_path):
    assert any("divided by its last number, 2" in n for n in read_with(tmp_path, lambda k: 2 * k))
    assert any("skew" in n for n in read_with(tmp_path, lambda k: k + SKEW))


@pytest.mark.parametrize(
    ("change", "messages"),
    [
        (lambda k: k + 45 * SKEW, "skew"),
        (lambda k: k.T, "below the diagonal"),
        (lambda k: k * [[-1, 1, 1], [1, 1, 1], [1, 1, 1]], "focal length"),
        (lambda k: k * [[1, 1, 9], [1, 1, 1], [1, 1, 1]], "principal point"),
        (lambda k: k * 0.0, "not above 0"),
    ],
)
def test_a_camera_matrix_out_of_range_names_file_and_camera(tmp_path, change, messages):
    with pytest.raises(UserError, match=f"camera c0 .*{messages}"):
        read_with(tmp_path, change)


@pytest.mark.parametrize("offset", [[90_000, 0], [0, -70_000.0], [float("inf"), 0]])
def test_offsets_of_pixel_maps_have_a_range(offset):
    with pytest.raises(UserError, match="pixel_maps of a"):
        by_camera({"pixel_maps": {"a": {"scale": 1.0, "offset": offset}}}, "pixel_maps", {"a": Path("a.mp4")})
