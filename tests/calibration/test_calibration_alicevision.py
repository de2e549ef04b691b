# SPDX-License-Identifier: Apache-2.0
"""Meshroom's cameras.sfm, as AliceVision's writer lays it out, in every version of its lens."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.calibration.files import read_calibration
from studiorecon.errors import UserError
from studiorecon.plan.discovery import find_calibration
from studiorecon.scene.camera import Camera

from tests.made.cameras import ring

SENSOR_MM = 36.0


def lens_of(camera: Camera, version: tuple[int, ...], key: str, **lens: Any) -> dict[str, Any]:
    """The camera's intrinsics with pixels 1.02 times as high as wide, numbers as text, as boost writes them."""
    (fx, fy), (cx, cy), (width, height) = camera.focal_px, np.array(camera.principal_px) - 0.5, camera.wh
    fy = fy * 1.02
    entry: dict[str, Any] = {"intrinsicId": key, "width": str(width), "height": str(height), "type": "pinhole"}
    if version < (1, 2, 2):
        entry["pxFocalLength"] = [str(fx), str(fy)]
    else:
        ratio = fx / fy if version < (1, 2, 5) else fy / fx
        entry |= {"sensorWidth": str(SENSOR_MM), "focalLength": str(SENSOR_MM * fx / width), "pixelRatio": str(ratio)}
    offset = (width / 2, height / 2) if version >= (1, 2, 1) else (0, 0)
    entry["principalPoint"] = [str(cx - offset[0]), str(cy - offset[1])]
    return entry | lens


def write_sfm(folder: Path, cameras: list[Camera], version: tuple[int, ...] = (1, 2, 8), **lens: Any) -> Path:
    content: dict[str, Any] = {"version": [str(v) for v in version], "views": [], "intrinsics": [], "poses": []}
    for i, camera in enumerate(cameras):
        key = str(1000 + i)
        path = f"/somewhere/{camera.name}.jpg"
        content["views"].append({"viewId": key, "poseId": key, "intrinsicId": key, "path": path})
        content["intrinsics"].append(lens_of(camera, version, key, **lens))
        columns = camera.camera_from_world[:3, :3].T.reshape(-1)
        pose = {"rotation": [f"{v:.17g}" for v in columns], "center": [f"{v:.17g}" for v in camera.centre_m]}
        content["poses"].append({"poseId": key, "pose": {"transform": pose, "locked": "0"}})
    path = folder / "cameras.sfm"
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize("version", [(1, 2, 0), (1, 2, 1), (1, 2, 4), (1, 2, 8)], ids=str)
def test_the_cameras_are_those_that_were_written(tmp_path: Path, version: tuple[int, ...]) -> None:
    cameras = ring()
    found = read_calibration(find_calibration(tmp_path) or [write_sfm(tmp_path, cameras, version)])
    assert find_calibration(tmp_path) == (tmp_path / "cameras.sfm",)
    assert [c.name for c in found.cameras] == [c.name for c in cameras]
    for read, camera in zip(found.cameras, cameras, strict=True):
        np.testing.assert_allclose(read.camera_from_world, camera.camera_from_world, atol=1e-12)
        np.testing.assert_allclose(read.intrinsics[[0, 0, 1], [0, 2, 2]], camera.intrinsics[[0, 0, 1], [0, 2, 2]])
        assert read.intrinsics[1, 1] == pytest.approx(1.02 * camera.focal_px[1])
        assert read.wh == camera.wh


@pytest.mark.parametrize(
    ("lens", "model", "numbers"),
    [
        ({"type": "radial3", "distortionParams": ["0.1", "0.02", "0.003"]}, "opencv", [0.1, 0.02, 0, 0, 0.003]),
        ({"distortionType": "radialk1", "distortionParams": ["0.1"]}, "opencv", [0.1, 0, 0, 0, 0]),
        # AliceVision's t1 and t2 are OpenCV's p1 and p2.
        ({"type": "brown", "distortionParams": ["1", "2", "3", "4", "5"]}, "opencv", [1, 2, 4, 5, 3]),
        ({"type": "fisheye4", "distortionParams": ["1", "2", "3", "4"]}, "fisheye", [1, 2, 3, 4]),
        ({"type": "radial3", "distortionParams": ""}, "opencv", [0, 0, 0, 0, 0]),
    ],
)
def test_distortions_are_opencv_s(tmp_path: Path, lens: dict[str, Any], model: str, numbers: list[float]) -> None:
    camera = read_calibration([write_sfm(tmp_path, ring(), **lens)]).cameras[0]
    assert camera.model == model
    np.testing.assert_allclose(camera.distortion[: len(numbers)], numbers)


def test_what_cannot_be_read_is_refused_or_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"camera c0 in .* the lens 3deradial4; reconstruct with"):
        read_calibration([write_sfm(tmp_path, ring(), type="3deradial4")])
    path = write_sfm(tmp_path, ring())
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"poses": content["poses"][:3]}))
    found = read_calibration([path])
    assert [c.name for c in found.cameras] == ["c0", "c1", "c2"]
    assert "no pose of c3" in found.notes[0]
    content["views"][1]["rigId"] = "7"
    path.write_text(json.dumps(content))
    with pytest.raises(UserError, match=r"c1 .*part of a rig"):
        read_calibration([path])
    path.write_text("{")
    with pytest.raises(UserError, match="not readable JSON"):
        read_calibration([path])
