# SPDX-License-Identifier: Apache-2.0
"""LLFF's ``poses_bounds.npy`` (Neural 3D Video): camera-to-world, axes down, right, back; a row per camera, no
names."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon.calibration.formats.reading import CalibrationFormat, Reading, one_file
from studiorecon.camera_files.raw_camera import camera_from_world_of_pose, raw_camera
from studiorecon.errors import UserError
from studiorecon.scene.user_files import read_npy
from studiorecon.scene.user_values import numbers


def read(files: list[Path]) -> Reading:
    """One camera per row, in the order of the sorted videos; focal length f for both axes, centre in the middle."""
    path = files[0]
    table = numbers(read_npy(path), str(path), finite=False)
    if table.ndim != 2 or table.shape[1] != 17:
        raise UserError(f"{path} is {table.shape}; LLFF has 17 numbers per camera")
    cameras = []
    for index, row in enumerate(table):
        block = row[:15].reshape(3, 5)
        height, width, focal = block[:, 4]
        down, right, back, centre = block[:, :4].T
        where, lens = f"camera {index} in {path}", [focal, focal, width / 2, height / 2]
        pose = camera_from_world_of_pose(np.stack([right, down, -back, centre], axis=1), where)
        cameras.append(raw_camera(str(index), where, [width, height], lens, pose, integer_centres=False))
    return Reading("LLFF poses_bounds.npy", tuple(cameras), "unknown", (), named=False)


FORMAT = CalibrationFormat(
    "llff", "LLFF, Neural 3D Video", "`poses_bounds.npy`", (("poses_bounds.npy",),), one_file("poses_bounds.npy"), read
)
