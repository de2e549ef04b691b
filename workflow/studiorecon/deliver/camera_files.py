# SPDX-License-Identifier: Apache-2.0
"""Writes the cameras for COLMAP, EasyMocap, nerfstudio and Pose2Sim: undistorted pinholes in metres, z up.

Also writes the undistorted pictures that COLMAP's and nerfstudio's files name.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.camera_files.colmap import write_model
from studiorecon.footage.video import read_frames
from studiorecon.geometry.rotations import log
from studiorecon.images.encoded import write_png
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.files import write_text

if TYPE_CHECKING:
    from jaxtyping import Float

# EasyMocap and Pose2Sim follow OpenCV: the first pixel's centre is at 0, not at 0.5 (C07).
_CENTRE_SHIFT = np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def colmap_picture(camera: str, frame: int | None) -> str:
    """Path of a picture below ``images/``, as in ``images.txt``; without a frame that of a camera's only picture."""
    return f"{camera}.png" if frame is None else f"{camera}/{frame:06d}.png"


def nerfstudio_picture(camera: str, frame: int | None) -> str:
    """Path of a picture below ``images/``, as ``transforms.json`` names it."""
    return f"{camera}/{frame or 0:06d}.png"


def colmap(
    folder: Path, cameras: Sequence[Camera], points_m: Float[np.ndarray, "N 3"], frames: Sequence[int | None] = (None,)
) -> list[Path]:
    """Writes ``cameras.txt images.txt points3D.txt``, a text model with one picture per camera, or per frame too."""
    every = [replace(c, name=colmap_picture(c.name, frame).removesuffix(".png")) for c in cameras for frame in frames]
    write_model(folder, every, points_m)
    return [folder / f"{name}.txt" for name in ("cameras", "images", "points3D")]


def easymocap(folder: Path, cameras: Sequence[Camera], points_m: Float[np.ndarray, "N 3"]) -> list[Path]:
    """Writes ``intri.yml`` and ``extri.yml`` with sizes, axis-angles and matrices (for EasyVolcap)."""
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


def nerfstudio(
    folder: Path, cameras: Sequence[Camera], points_m: Float[np.ndarray, "N 3"], frames: Sequence[int | None] = (None,)
) -> list[Path]:
    """Writes ``transforms.json``: camera-to-world, OpenGL axes, our world; several frames have their ``time``, 0 to
    1."""
    entries: list[dict[str, Any]] = []
    for c in cameras:
        (fx, fy), (cx, cy) = c.focal_px, c.principal_px
        pose = (c.world_from_camera @ _OPENGL_FROM_OPENCV).tolist()
        about = {"w": c.wh[0], "h": c.wh[1], "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "transform_matrix": pose}
        for k, frame in enumerate(frames):
            time = {} if len(frames) == 1 else {"time": k / (len(frames) - 1)}
            named = {"file_path": f"images/{nerfstudio_picture(c.name, frame)}", "camera_label": c.name}
            entries.append({**named, **time, **about})
    write_text(folder / "transforms.json", json.dumps({"camera_model": "OPENCV", "frames": entries}, indent=1) + "\n")
    return [folder / "transforms.json"]


def pose2sim(folder: Path, cameras: Sequence[Camera], points_m: Float[np.ndarray, "N 3"]) -> list[Path]:
    """Writes ``Calib.toml``: one table per camera, axis-angle world-to-camera, metres."""
    write_text(folder / "Calib.toml", pose2sim_tables(cameras))
    return [folder / "Calib.toml"]


def pose2sim_tables(cameras: Sequence[Camera | Lens]) -> str:
    """The text of a ``Calib.toml``, with the distortion of cameras that still have one."""
    text = ""
    for c in cameras:
        model, distortion = (c.model, c.distortion) if isinstance(c, Lens) else ("opencv", np.zeros(4))
        text += f"[{json.dumps(c.name)}]\nname = {json.dumps(c.name)}\nsize = [{c.wh[0]:.1f}, {c.wh[1]:.1f}]\n"
        text += f"matrix = {(c.intrinsics - _CENTRE_SHIFT).tolist()}\ndistortions = {distortion.tolist()}\n"
        text += (
            f"rotation = {log(c.camera_from_world[:3, :3]).tolist()}\ntranslation = "
            f"{c.camera_from_world[:3, 3].tolist()}\n"
        )
        text += f"fisheye = {json.dumps(model == 'fisheye')}\n\n"
    return text + "[metadata]\nadjusted = false\nerror = 0.0\n"


WRITERS: dict[str, Callable[..., list[Path]]] = {
    "colmap": colmap,
    "easymocap": easymocap,
    "nerfstudio": nerfstudio,
    "pose2sim": pose2sim,
}


PICTURES: dict[str, Callable[[str, int | None], str]] = {"colmap": colmap_picture, "nerfstudio": nerfstudio_picture}


def write_pictures(folder: Path, videos: Mapping[str, Path], frames: Sequence[int | None]) -> list[Path]:
    """Write the undistorted pictures of every camera's video that the files name; ``frames`` None: only the first."""
    written = []
    for camera, video in videos.items():
        for frame, picture in zip(frames, read_frames(video)):
            for form, name in PICTURES.items():
                written.append(folder / form / "images" / name(camera, frame))
                write_png(written[-1], picture)
    return written


def _matrix(name: str, value: np.ndarray) -> str:
    """An OpenCV YAML entry with all 17 digits."""
    data = ", ".join(f"{v:.17g}" for v in value.reshape(-1))
    return (
        f"{name}: !!opencv-matrix\n   rows: {value.shape[0]}\n   cols: "
        f"{value.shape[1]}\n   dt: d\n   data: [ {data} ]\n"
    )
