# SPDX-License-Identifier: Apache-2.0
"""Calibrations of movement laboratories (Vicon, OptiTrack, OpenCap, bioCV): planted cameras, written as those programs
write them, come back."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.calibration.files import read_calibration
from studiorecon.errors import UserError
from studiorecon.geometry.distortion import distort
from studiorecon.geometry.rotations import exp, to_quaternion
from studiorecon.plan.discovery import find_calibration, open_dataset
from studiorecon.scene.camera import Camera

from tests.made.cameras import ring

LENS = (-0.08, 0.02, 0.001, -0.002, 0.003)  # OpenCV's k1 k2 p1 p2 k3


def planted() -> list[Camera]:
    """Rolled cameras, so that no sign and no transposition can hide."""
    return [replace(c, camera_from_world=_rolled(c.camera_from_world, 0.3 * i)) for i, c in enumerate(ring())]


def _rolled(pose: np.ndarray, angle: float) -> np.ndarray:
    turn = np.eye(4)
    turn[:3, :3] = exp(np.array([0.0, 0.0, angle]))
    return turn @ pose


def _row(values: object) -> str:
    return " ".join(f"{v:.17g}" for v in np.asarray(values, float).reshape(-1))


def write_vicon(folder: Path, cameras: list[Camera], lens: str = "", **more: str) -> None:
    lines = ['<?xml version="1.0" encoding="UTF-8" standalone="no" ?>', '<Cameras SOURCE="Nexus" VERSION="2.0">']
    for c in cameras:
        w, x, y, z = to_quaternion(c.camera_from_world[:3, :3])
        principal = np.array(c.principal_px) - 0.5
        radial = lens or f'VICON_RADIAL2="Vicon3Parameter {_row(principal)} 0 0 0"'
        lines.append(
            f'<Camera DEVICEID="{c.name}" SYSTEM="DV" PIXEL_ASPECT_RATIO="{more.get("aspect", "1")}" '
            f'SENSOR_SIZE="{c.wh[0]} {c.wh[1]}"><KeyFrames><KeyFrame FRAME="0" FOCAL_LENGTH="{c.focal_px[0]:.17g}" '
            f'ORIENTATION="{_row([x, y, z, w])}" POSITION="{_row(1000 * c.centre_m)}" '
            f'PRINCIPAL_POINT="{_row(principal)}" {radial}/></KeyFrames></Camera>'
        )
    lines += ['<Camera DEVICEID="never" SENSOR_SIZE="10 10"><KeyFrames/></Camera>', "</Cameras>"]
    (folder / "calibration.xcp").write_text("\n".join(lines))


def write_optitrack(folder: Path, cameras: list[Camera]) -> None:
    lines = ['<?xml version="1.0" encoding="UTF-16LE"?>', "<calibrationProfile><Calibration><Cameras>"]
    for c in cameras:
        # x right, y up, z backwards, as columns in the world.
        axes = c.world_from_camera[:3, :3] * [1, -1, -1]
        orientation = " ".join(f'OrientMatrix{i}="{v:.17g}"' for i, v in enumerate(axes.reshape(-1)))
        place = " ".join(f'{a}="{v:.17g}"' for a, v in zip("XYZ", c.centre_m))
        k1, k2, p1, p2, k3 = LENS
        lines.append(
            f'<Camera Serial="{c.name}"><Attributes ImagerPixelWidth="{c.wh[0]}" ImagerPixelHeight="{c.wh[1]}"/>'
            '<Intrinsic LensCenterX="1" LensCenterY="2" HorizontalFocalLength="3" VerticalFocalLength="4" k1="5"/>'
            f'<IntrinsicStandardCameraModel LensCenterX="{c.principal_px[0] - 0.5:.17g}" '
            f'LensCenterY="{c.principal_px[1] - 0.5:.17g}" HorizontalFocalLength="{c.focal_px[0]:.17g}" '
            f'VerticalFocalLength="{c.focal_px[1]:.17g}" k1="{k1}" k2="{k2}" k3="{k3}" '
            f'TangentialX="{p1}" TangentialY="{p2}"/><Extrinsic {place} {orientation}/></Camera>'
        )
    lines += [
        '<Camera Serial="M1"><Properties CameraID="9"/></Camera>',
        "</Cameras></Calibration></calibrationProfile>",
    ]
    (folder / "room.mcal").write_bytes("\n".join(lines).encode("utf-16"))


def write_opencap(folder: Path, cameras: list[Camera]) -> None:
    for c in cameras:
        path = folder / "Videos" / c.name / "cameraIntrinsicsExtrinsics.pickle"
        path.parent.mkdir(parents=True)
        table = {
            "distortion": np.array([LENS]),
            "intrinsicMat": c.intrinsics - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]],
            "imageSize": np.array([[float(c.wh[1])], [float(c.wh[0])]]),
            "rotation": c.camera_from_world[:3, :3],
            "translation": 1000 * c.camera_from_world[:3, 3:],
            "rotation_EulerAngles": np.zeros((3, 1)),
        }
        path.write_bytes(pickle.dumps(table))


def write_biocv(folder: Path, cameras: list[Camera]) -> None:
    for c in cameras:
        k, pose = c.intrinsics.copy(), c.camera_from_world.copy()
        k[:2, 2] -= 0.5
        pose[:3, 3] *= 1000
        blocks = [[[c.wh[0]], [c.wh[1]]], k, pose, [LENS]]
        text = "\n\n".join("\n".join(_row(row) for row in block) for block in blocks)
        (folder / f"{c.name}.mp4.calib").write_text(text + "\n")


WRITERS: dict[str, tuple[Callable[..., None], float]] = {
    "vicon": (write_vicon, 1000.0),
    "optitrack": (write_optitrack, 1.0),
    "opencap": (write_opencap, 1000.0),
    "biocv": (write_biocv, 1000.0),
}


@pytest.mark.parametrize("form", WRITERS)
def test_planted_cameras_come_back(tmp_path: Path, form: str) -> None:
    write, per_metre = WRITERS[form]
    cameras = planted()
    write(tmp_path, cameras)
    reading = read_calibration(find_calibration(tmp_path))
    assert reading.unit == ("m" if per_metre == 1 else "mm")
    assert [c.name for c in reading.cameras] == [c.name for c in cameras]
    for read, camera in zip(reading.cameras, cameras, strict=True):
        pose = read.camera_from_world.copy()
        pose[:3, 3] /= per_metre
        np.testing.assert_allclose(pose, camera.camera_from_world, atol=1e-9)
        np.testing.assert_allclose(read.intrinsics, camera.intrinsics, atol=1e-9)
        assert read.wh == camera.wh
        np.testing.assert_allclose(read.distortion[:5], np.zeros(5) if form == "vicon" else LENS)


def test_cameras_without_a_calibration_are_named(tmp_path: Path) -> None:
    write_vicon(tmp_path, planted())
    assert "never of calibration.xcp is not calibrated" in read_calibration([tmp_path / "calibration.xcp"]).notes[0]
    write_optitrack(tmp_path, planted())
    assert "camera M1 of room.mcal has no Extrinsic" in read_calibration([tmp_path / "room.mcal"]).notes[0]


def _filmed_by_vicon(ideal: np.ndarray, centre: np.ndarray, terms: list[float]) -> np.ndarray:
    """The pixels that Vicon's formula takes to ``ideal``, by bisection of the radius."""
    offset = ideal - centre
    wanted = np.linalg.norm(offset, axis=-1)
    low, high = np.zeros_like(wanted), 2 * wanted
    for _ in range(80):
        middle = (low + high) / 2
        s = middle**2
        beyond = middle * (1 + s * (terms[0] + s * (terms[1] + s * terms[2]))) > wanted
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    return centre + offset * (low / wanted)[:, None]


@pytest.mark.parametrize("shift", [0.0, 6.0])
@pytest.mark.parametrize("old", [False, True])
def test_vicon_s_lens_films_what_it_filmed(tmp_path: Path, shift: float, old: bool) -> None:
    camera = planted()[1]
    principal = np.array(camera.principal_px) - 0.5
    centre = principal if old else principal + np.array([shift, -shift])
    terms = [6e-8, 1.5e-14, 0.0 if old else 2e-21]  # barrel: 2.6 % at 640 px
    lens = f'VICON_RADIAL="{_row(terms[:2])}"' if old else f'VICON_RADIAL2="Vicon3Parameter {_row([*centre, *terms])}"'
    write_vicon(tmp_path, [camera], lens)
    (read,) = read_calibration([tmp_path / "calibration.xcp"]).cameras
    points = np.random.default_rng(0).uniform([30, 30], [1250, 670], (200, 2))
    filmed = _filmed_by_vicon(points, centre, terms)
    inside = (filmed > 0).all(-1) & (filmed < camera.wh).all(-1)
    ours = distort((points - principal) / camera.focal_px[0], read.model, read.distortion) * camera.focal_px[0]
    assert np.abs(filmed - points).max() > 5, "a lens that bends nothing shows nothing"
    assert np.abs(ours + principal - filmed)[inside].max() < 0.05


def test_a_pickle_of_opencap_runs_no_program(tmp_path: Path) -> None:
    class Spiteful:
        def __reduce__(self) -> tuple[object, ...]:
            return (exec, (f"open({str(tmp_path / 'ran')!r}, 'w')",))

    path = tmp_path / "cam.pickle"
    path.write_bytes(pickle.dumps({"intrinsicMat": Spiteful()}))
    with pytest.raises(UserError, match=r"asks for builtins\.exec"):
        read_calibration([path])
    assert not (tmp_path / "ran").exists()


def test_files_of_one_camera_each_are_one_calibration(tmp_path: Path) -> None:
    write_biocv(tmp_path, planted())
    (tmp_path / "videos").mkdir()
    for camera in planted():
        (tmp_path / "videos" / f"{camera.name}.mp4").touch()
    assert [path.name for path in open_dataset(tmp_path).calibration] == [f"c{i}.mp4.calib" for i in range(4)]
