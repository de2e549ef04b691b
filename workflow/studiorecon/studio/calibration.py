# SPDX-License-Identifier: Apache-2.0
"""A calibration file in any of the formats that the pipeline reads, as a user would have it.

Files of OpenCV's family count pixels from 0 at the first pixel's centre; COLMAP's and nerfstudio's from its corner.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from studiorecon.camera_files.colmap import quaternion_from_rotation
from studiorecon.scene.camera import Lens


def calibration_texts(form: str, lenses: Sequence[Lens]) -> dict[str, str]:
    """File name → text for one of ``description.CALIBRATION_FILES``."""
    return {
        "easymocap": _easymocap,
        "colmap": _colmap,
        "pose2sim": _pose2sim,
        "caliscope": _caliscope,
        "nerfstudio": _nerfstudio,
    }[form](lenses)


def _easymocap(lenses: Sequence[Lens]) -> dict[str, str]:
    intri, extri = (["%YAML:1.0", "---", "names:", *(f'  - "{lens.name}"' for lens in lenses)] for _ in range(2))
    for lens in lenses:
        rotation = lens.camera_from_world[:3, :3]
        intri += _matrix(f"K_{lens.name}", _integer_centres(lens)) + _matrix(
            f"dist_{lens.name}", lens.distortion[None, :5]
        )
        intri += [f"H_{lens.name}: {lens.wh[1]}", f"W_{lens.name}: {lens.wh[0]}"]
        extri += _matrix(f"R_{lens.name}", _rodrigues(rotation)[:, None]) + _matrix(f"Rot_{lens.name}", rotation)
        extri += _matrix(f"T_{lens.name}", lens.camera_from_world[:3, 3:])
    return {"intri.yml": "\n".join(intri) + "\n", "extri.yml": "\n".join(extri) + "\n"}


def _matrix(name: str, values: np.ndarray) -> list[str]:
    numbers = ", ".join(f"{v:.17g}" if v != int(v) else f"{v:.1f}" for v in values.ravel())
    return [
        f"{name}: !!opencv-matrix",
        f"  rows: {values.shape[0]}",
        f"  cols: {values.shape[1]}",
        "  dt: d",
        f"  data: [{numbers}]",
    ]


def _colmap(lenses: Sequence[Lens]) -> dict[str, str]:
    cameras, images = (
        ["# Camera list: CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]"],
        ["# Image list: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"],
    )
    for index, lens in enumerate(lenses, start=1):
        k = lens.intrinsics
        numbers = [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
        model = "PINHOLE"
        if lens.distortion.any():
            model, numbers = "OPENCV", [*numbers, *lens.distortion[:4]]
        cameras.append(f"{index} {model} {lens.wh[0]} {lens.wh[1]} " + _numbers(numbers))
        pose = [*quaternion_from_rotation(lens.camera_from_world[:3, :3]), *lens.camera_from_world[:3, 3]]
        images += [f"{index} {_numbers(pose)} {index} {lens.name}.png", ""]
    points = "# 3D point list: POINT3D_ID X Y Z R G B ERROR TRACK[]\n"
    return {
        "sparse/0/cameras.txt": "\n".join(cameras) + "\n",
        "sparse/0/images.txt": "\n".join(images) + "\n",
        "sparse/0/points3D.txt": points,
    }


def _pose2sim(lenses: Sequence[Lens]) -> dict[str, str]:
    return {"calibration/Calib.toml": _toml(lenses, with_names_as_tables=True)}


def _caliscope(lenses: Sequence[Lens]) -> dict[str, str]:
    return {"camera_array_aniposelib.toml": _toml(lenses, with_names_as_tables=False)}


def _toml(lenses: Sequence[Lens], with_names_as_tables: bool) -> str:
    """aniposelib's table per camera: Pose2Sim names it by the camera, the caliscope family by its number."""
    lines = []
    for index, lens in enumerate(lenses):
        matrix = "[ " + ", ".join(f"[ {_numbers(row, ', ')},]" for row in _integer_centres(lens)) + ",]"
        lines += [
            f"[{lens.name}]" if with_names_as_tables else f"[cam_{index}]",
            f'name = "{lens.name}"',
            f"size = [ {_numbers(lens.wh, ', ')},]"
            if with_names_as_tables
            else f"size = [ {lens.wh[0]}, {lens.wh[1]},]",
            f"matrix = {matrix}",
            f"distortions = [ {_numbers(lens.distortion[: 4 if with_names_as_tables else 5], ', ')},]",
            f"rotation = [ {_numbers(_rodrigues(lens.camera_from_world[:3, :3]), ', ')},]",
            f"translation = [ {_numbers(lens.camera_from_world[:3, 3], ', ')},]",
            "fisheye = false",
            "",
        ]
    return "\n".join([*lines, "[metadata]", "adjusted = false", "error = 0.0", ""])


def _nerfstudio(lenses: Sequence[Lens]) -> dict[str, str]:
    frames = []
    for lens in lenses:
        world_from_camera = np.linalg.inv(lens.camera_from_world)
        world_from_camera[:3, 1:3] *= -1  # OpenGL axes: y up, z backwards
        k, (k1, k2, p1, p2) = lens.intrinsics, lens.distortion[:4]
        frames.append(
            {
                "file_path": f"images/{lens.name}.png",
                "camera_label": lens.name,
                "transform_matrix": world_from_camera.tolist(),
                "w": lens.wh[0],
                "h": lens.wh[1],
                "fl_x": k[0, 0],
                "fl_y": k[1, 1],
                "cx": k[0, 2],
                "cy": k[1, 2],
                "k1": k1,
                "k2": k2,
                "p1": p1,
                "p2": p2,
            }
        )
    return {"transforms.json": json.dumps({"camera_model": "OPENCV", "frames": frames}, indent=1) + "\n"}


def _integer_centres(lens: Lens) -> np.ndarray:
    return lens.intrinsics - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])


def _rodrigues(rotation: np.ndarray) -> np.ndarray:
    from studiorecon.geometry import rotations

    return rotations.log(rotation)


def _numbers(values: Sequence[float] | np.ndarray, separator: str = " ") -> str:
    """Floats with all their digits; whole numbers keep a decimal point, which TOML needs for floats."""
    return separator.join(f"{float(v)!r}" for v in values)
