# SPDX-License-Identifier: Apache-2.0
"""The cameras in the files of other tools: COLMAP, EasyMocap, nerfstudio and Pose2Sim, all undistorted pinholes in
metres, z up."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.camera_files.colmap import write_model
from studiorecon.geometry.rotations import log
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import write_text

if TYPE_CHECKING:
    from jaxtyping import Float

# EasyMocap and Pose2Sim follow OpenCV: the first pixel's centre is at 0, not at 0.5 (C07).
_CENTRE_SHIFT = np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def colmap(folder: Path, cameras: Sequence[Camera], points_m: Float[np.ndarray, "N 3"]) -> list[Path]:
    """``cameras.txt images.txt points3D.txt``: a text model with one picture ``<camera>.png`` per camera."""
    write_model(folder, cameras, points_m)
    return [folder / f"{name}.txt" for name in ("cameras", "images", "points3D")]


def easymocap(folder: Path, cameras: Sequence[Camera], points_m: Float[np.ndarray, "N 3"]) -> list[Path]:
    """``intri.yml`` and ``extri.yml`` with sizes, axis-angles and matrices, so that EasyVolcap's readers are served
    too."""
    intri = extri = "%YAML:1.0\n---\n" + "names:\n" + "".join(f'   - "{c.name}"\n' for c in cameras)
    for c in cameras:
        rotation = c.camera_from_world[:3, :3]
        intri += _matrix(f"K_{c.name}", c.intrinsics - _CENTRE_SHIFT) + _matrix(f"dist_{c.name}", np.zeros((1, 5)))
        intri += f"H_{c.name}: {c.wh[1]}\nW_{c.name}: {c.wh[0]}\n"
        extri += _matrix(f"R_{c.name}", log(rotation)[:, None]) + _matrix(f"Rot_{c.name}", rotation)
        extri += _matrix(f"T_{c.name}", c.camera_from_world[:3, 3:])
    write_text(folder / "intri.yml", intri)
    write_text(folder / "extri.yml", extri)
    return [folder / "intri.yml", folder / "extri.yml"]


def nerfstudio(folder: Path, cameras: Sequence[Camera], points_m: Float[np.ndarray, "N 3"]) -> list[Path]:
    """``transforms.json``: camera-to-world with OpenGL axes in our own world, no applied_transform to undo."""
    frames = []
    for c in cameras:
        (fx, fy), (cx, cy) = c.focal_px, c.principal_px
        frames.append(
            {
                "file_path": f"images/{c.name}/000000.png",
                "camera_label": c.name,
                "w": c.wh[0],
                "h": c.wh[1],
                "fl_x": fx,
                "fl_y": fy,
                "cx": cx,
                "cy": cy,
                "transform_matrix": (c.world_from_camera @ _OPENGL_FROM_OPENCV).tolist(),
            }
        )
    write_text(folder / "transforms.json", json.dumps({"camera_model": "OPENCV", "frames": frames}, indent=1) + "\n")
    return [folder / "transforms.json"]


def pose2sim(folder: Path, cameras: Sequence[Camera], points_m: Float[np.ndarray, "N 3"]) -> list[Path]:
    """``Calib.toml``: one table per camera, axis-angle world-to-camera, metres."""
    text = ""
    for c in cameras:
        text += f"[{json.dumps(c.name)}]\nname = {json.dumps(c.name)}\nsize = [{c.wh[0]:.1f}, {c.wh[1]:.1f}]\n"
        text += f"matrix = {(c.intrinsics - _CENTRE_SHIFT).tolist()}\ndistortions = [0.0, 0.0, 0.0, 0.0]\n"
        text += (
            f"rotation = {log(c.camera_from_world[:3, :3]).tolist()}\ntranslation = "
            f"{c.camera_from_world[:3, 3].tolist()}\n"
        )
        text += "fisheye = false\n\n"
    write_text(folder / "Calib.toml", text + "[metadata]\nadjusted = false\nerror = 0.0\n")
    return [folder / "Calib.toml"]


WRITERS: dict[str, Callable[[Path, Sequence[Camera], Float[np.ndarray, "N 3"]], list[Path]]] = {
    "colmap": colmap,
    "easymocap": easymocap,
    "nerfstudio": nerfstudio,
    "pose2sim": pose2sim,
}


def _matrix(name: str, value: np.ndarray) -> str:
    """An OpenCV YAML entry with all 17 digits."""
    data = ", ".join(f"{v:.17g}" for v in value.reshape(-1))
    return (
        f"{name}: !!opencv-matrix\n   rows: {value.shape[0]}\n   cols: "
        f"{value.shape[1]}\n   dt: d\n   data: [ {data} ]\n"
    )
