# SPDX-License-Identifier: Apache-2.0
"""OptiTrack's ``*.mcal``, the XML calibration of Motive 3.2 and later: metres, y up, cameras that look along -z.

``Extrinsic``: the camera's position X Y Z and, row by row, the rotation from its axes (x right, y up, z backwards) to
the world's. ``IntrinsicStandardCameraModel``: pixels and OpenCV's distortion k1 k2 k3 with TangentialX and TangentialY
as p1 and p2; ``Intrinsic`` is Motive's own, undocumented lens model. Sources: OptiTrack's page ".mcal XML Calibration
Files", and published overlays on Prime Color footage. Pixels are counted as OpenCV does.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from studiorecon.calibration.formats.reading import CalibrationFormat, Reading, attribute, number_attributes, one_file
from studiorecon.camera_files.raw_camera import RawCamera, camera_from_world_of_pose, raw_camera
from studiorecon.errors import UserError
from studiorecon.scene.user_files import read_xml

# Motive's cameras look along -z with y up; ours along +z with y down.
_FLIP = np.diag([1.0, -1.0, -1.0])


def read(files: list[Path]) -> Reading:
    """The cameras with a position and a standard lens, by serial number (``C11764``); raises UserError for
    ``*.cal``."""
    path = files[0]
    if path.suffix.lower() == ".cal":
        raise UserError(
            f"{path} is a binary calibration of Motive before 3.2, which only Motive can read; open it in Motive 3.2 "
            "or later and save it as .mcal"
        )
    cameras, notes = [], []
    for element in read_xml(path).iter("Camera"):
        name = attribute(element, "Serial", f"a camera in {path}")
        extrinsic, lens = element.find("Extrinsic"), element.find("IntrinsicStandardCameraModel")
        if extrinsic is None or lens is None:
            lacking = "Extrinsic" if extrinsic is None else "IntrinsicStandardCameraModel"
            notes.append(f"camera {name} of {path.name} has no {lacking} and was left out")
            continue
        cameras.append(_camera(name, element, extrinsic, lens, f"camera {name} in {path}"))
    return Reading("OptiTrack mcal", tuple(cameras), "m", tuple(notes))


def _camera(name: str, element: Element, extrinsic: Element, lens: Element, where: str) -> RawCamera:
    axes = number_attributes(extrinsic, [f"OrientMatrix{i}" for i in range(9)], where).reshape(3, 3) @ _FLIP
    centre = number_attributes(extrinsic, "XYZ", where)
    lengths = ("HorizontalFocalLength", "VerticalFocalLength", "LensCenterX", "LensCenterY")
    intrinsics = number_attributes(lens, lengths, where)
    terms = number_attributes(lens, ("k1", "k2", "TangentialX", "TangentialY", "k3"), where)
    size = element.find("Attributes")
    if size is None:
        raise UserError(f"{where}: Attributes, which hold the size of its pictures, are missing; save it again")
    wh = number_attributes(size, ("ImagerPixelWidth", "ImagerPixelHeight"), where)
    pose = camera_from_world_of_pose(np.column_stack([axes, centre]), where)
    return raw_camera(name, where, wh, intrinsics, pose, terms)


FORMAT = CalibrationFormat(
    "optitrack",
    "OptiTrack Motive 3.2 and later",
    "`*.mcal`",
    (("*.mcal",), ("calibration/*.mcal",), ("*.cal",), ("calibration/*.cal",)),
    one_file("*.mcal", "*.cal"),
    read,
)
