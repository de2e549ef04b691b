# SPDX-License-Identifier: Apache-2.0
"""Qualisys ``*.qca.txt``: XML, focal length and centre in 1/64 pixel, millimetres, camera-to-world with z backwards."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon.calibration.formats.reading import CalibrationFormat, Reading, attribute, number_attribute
from studiorecon.camera_files.raw_camera import RawCamera, camera_from_world_of_pose, intrinsics_matrix
from studiorecon.errors import UserError
from studiorecon.scene.user_files import read_xml

_SUBPIXELS = 64.0
# Qualisys cameras look along -z with y up; ours along +z with y down.
_FLIP = np.diag([1.0, -1.0, -1.0])


def recognises(files: list[Path]) -> bool:
    return len(files) == 1 and files[0].name.lower().endswith((".qca.txt", ".qca", ".qca.xml"))


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
        axes = np.array([[number_attribute(transform, f"r{i}{j}", where) for j in (1, 2, 3)] for i in (1, 2, 3)])
        world_from_camera = np.eye(4)
        world_from_camera[:3, :3] = axes.T @ _FLIP
        world_from_camera[:3, 3] = [number_attribute(transform, axis, where) / 1000 for axis in "xyz"]
        left, top = (number_attribute(frame, s, where) for s in ("left", "top"))
        right, bottom = (number_attribute(frame, s, where) for s in ("right", "bottom"))
        focal = [number_attribute(intrinsic, f"focalLength{a}", where) / _SUBPIXELS for a in "UV"]
        centre = [number_attribute(intrinsic, f"centerPoint{a}", where) / _SUBPIXELS for a in "UV"]
        radial = [float(intrinsic.get(f"radialDistortion{i}", 0)) for i in (1, 2, 3)]
        # The misspelling is the format's.
        tangential = [float(intrinsic.get(f"tangentalDistortion{i}", 0)) for i in (1, 2)]
        cameras.append(
            RawCamera(
                name=name,
                wh=(round(right - left + 1), round(bottom - top + 1)),
                intrinsics=intrinsics_matrix(
                    focal[0], focal[1], centre[0] - left, centre[1] - top, integer_centres=True
                ),
                model="opencv",
                distortion=np.array([radial[0], radial[1], *tangential, radial[2], 0, 0, 0]),
                camera_from_world=camera_from_world_of_pose(world_from_camera, where),
            )
        )
    return Reading("Qualisys qca", tuple(cameras), "m", ())


FORMAT = CalibrationFormat(
    name="qualisys",
    made_by="Qualisys",
    files_in_words="`*.qca.txt`",
    files=(("*.qca.txt",), ("calibration/*.qca.txt",)),
    recognises=recognises,
    read=read,
)
