# SPDX-License-Identifier: Apache-2.0
"""LLFF's ``poses_bounds.npy`` (Neural 3D Video): camera-to-world, axes down, right, back; a row per camera, no
names."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon.calibration.formats.reading import CalibrationFormat, Reading, one_file
from studiorecon.camera_files.raw_camera import RawCamera, camera_from_world_of_pose, intrinsics_matrix
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
        if height % 1 or width % 1:
            raise UserError(f"{path}: camera {index} has {width:g}×{height:g} pixels; sizes are whole numbers")
        down, right, back = block[:, 0], block[:, 1], block[:, 2]
        world_from_camera = np.eye(4)
        world_from_camera[:3] = np.stack([right, down, -back, block[:, 3]], axis=1)
        intrinsics = intrinsics_matrix(focal, focal, width / 2, height / 2, integer_centres=False)
        pose = camera_from_world_of_pose(world_from_camera, f"camera {index} in {path}")
        wh = round(width), round(height)
        cameras.append(RawCamera(str(index), wh, intrinsics, "opencv", np.zeros(8), pose))
    return Reading("LLFF poses_bounds.npy", tuple(cameras), "unknown", (), named=False)


FORMAT = CalibrationFormat(
    "llff", "LLFF, Neural 3D Video", "`poses_bounds.npy`", (("poses_bounds.npy",),), one_file("poses_bounds.npy"), read
)
