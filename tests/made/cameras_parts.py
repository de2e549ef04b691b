# SPDX-License-Identifier: Apache-2.0
"""What tests of cameras and their neighbours share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from studiorecon.geometry.rotations import log
from studiorecon.scene.camera import Camera

DISTORTION = [-0.1, 0.02, 1e-3, -2e-3, 0.0]


def matrix(name: str, value: np.ndarray) -> str:
    value = np.atleast_2d(value)
    data = ", ".join(f"{v:.17g}" for v in value.reshape(-1))
    return (
        f"{name}: !!opencv-matrix\n   rows: {value.shape[0]}\n   cols: "
        f"{value.shape[1]}\n   dt: d\n   data: [ {data} ]\n"
    )


def write_toml(folder: Path, cameras: list[Camera], caliscope: bool = False) -> list[Path]:
    text = ""
    for i, c in enumerate(cameras):
        k = (c.intrinsics - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]).tolist()
        pose = c.camera_from_world
        text += (
            f"[cameras.{i}]\ncam_id = {i}\nrotation_count = 0\n"
            if caliscope
            else f'[int_{c.name}_img]\nname = "int_{c.name}_img"\nfisheye = false\n'
        )
        rotation = pose[:3, :3].tolist() if caliscope else log(pose[:3, :3]).tolist()
        text += f"size = [{c.wh[0]}.0, {c.wh[1]}.0]\nmatrix = {k}\ndistortions = {DISTORTION}\n"
        text += f"rotation = {rotation}\ntranslation = {pose[:3, 3].tolist()}\n\n"
    path = folder / ("camera_array.toml" if caliscope else "Calib.toml")
    path.write_text(text + ("" if caliscope else "[metadata]\nadjusted = false\nerror = 0.0\n"))
    return [path]
