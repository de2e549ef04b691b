# SPDX-License-Identifier: Apache-2.0
"""Qualisys ``*.qca.txt``: XML, focal length and centre in 1/64 pixel, millimetres, camera-to-world with z backwards."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon.calibration.formats.reading import CalibrationFormat, Reading, attribute, number_attributes, one_file
from studiorecon.camera_files.raw_camera import camera_from_world_of_pose, raw_camera
from studiorecon.errors import UserError
from studiorecon.scene.user_files import read_xml

_SUBPIXELS = 64.0
# Qualisys cameras look along -z with y up; ours along +z with y down.
_FLIP = np.diag([1.0, -1.0, -1.0])


def read(files: list[Path]) -> Reading:
    """The active cameras of the file, in metres."""
    path = files[0]
    root = read_xml(path)
    cameras = []
    for element in root.iter("camera"):
        if element.get("active") == "0":
            continue
        name = attribute(element, "serial", f"a camera in {path}")
        where = f"camera {name} in {path}"
        if element.get("viewrotation", "0") not in ("0", "0.0"):
            raise UserError(
                f"{where}: viewrotation is {element.get('viewrotation')}; export the "
                "calibration for upright video (viewrotation 0)"
            )
        transform, intrinsic, frame = element.find("transform"), element.find("intrinsic"), element.find("fov_video")
        if transform is None or intrinsic is None or frame is None:
            raise UserError(f"{where}: transform, intrinsic or fov_video is missing; export the calibration again")
        # The nine numbers are stored column by column: r11 r12 r13 are the image's x axis in the world.
        axes = number_attributes(transform, [f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)], where).reshape(3, 3)
        centre_m = number_attributes(transform, "xyz", where) / 1000
        left, top, right, bottom = number_attributes(frame, ("left", "top", "right", "bottom"), where)
        lengths = ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV")
        fx, fy, cx, cy = number_attributes(intrinsic, lengths, where) / _SUBPIXELS
        # The misspelling is the format's.
        terms = ("radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2")
        distortion = number_attributes(intrinsic, (*terms, "radialDistortion3"), where, "0")
        wh, intrinsics = (right - left + 1, bottom - top + 1), (fx, fy, cx - left, cy - top)
        pose = camera_from_world_of_pose(np.column_stack([axes.T @ _FLIP, centre_m]), where)
        cameras.append(raw_camera(name, where, wh, intrinsics, pose, distortion))
    return Reading("Qualisys qca", tuple(cameras), "m", ())


FORMAT = CalibrationFormat(
    "qualisys",
    "Qualisys",
    "`*.qca.txt`",
    (("*.qca.txt",), ("calibration/*.qca.txt",)),
    one_file("*.qca.txt", "*.qca", "*.qca.xml"),
    read,
)
