# SPDX-License-Identifier: Apache-2.0
"""Vicon's ``*.xcp`` (Nexus, Shogun, Tracker): XML, millimetres, cameras that look along +z with y down, as ours.

``ORIENTATION`` is the quaternion x y z w of the rotation from world to camera, ``POSITION`` the camera's centre;
``FOCAL_LENGTH`` and ``PRINCIPAL_POINT`` are in pixels of the whole sensor (``SENSOR_SIZE``). The lens is the inverse of
OpenCV's, in pixels: ideal = c + (p - c) (1 + k1 r² + k2 r⁴ + k3 r⁶) with r = |p - c| of the filmed pixel p.
``VICON_RADIAL2`` is "Vicon3Parameter cx cy k1 k2 k3", the older ``VICON_RADIAL`` "k1 k2" around the principal point.
Sources: Vicon's page "About calibration data (XCP) files", Pose2Sim's ``read_vicon`` (axes, unit), and a published
calibration whose cameras see each other's rings only in this direction. The position of the first pixel's centre is not
documented: it is read as OpenCV's.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from studiorecon.calibration.formats.reading import (
    CalibrationFormat,
    Reading,
    attribute,
    merged_static,
    number_attributes,
    one_file,
)
from studiorecon.camera_files.raw_camera import RawCamera, camera_from_world_of_pose, raw_camera
from studiorecon.errors import UserError
from studiorecon.geometry.distortion import distort
from studiorecon.geometry.rotations import from_quaternion
from studiorecon.scene.user_files import read_xml
from studiorecon.scene.user_values import short_text

_SQUARE = 0.001
_SAMPLES = 41
# Largest error of the lens after conversion to OpenCV's model.
_MAX_LEFT_PX = 0.5


def read(files: list[Path]) -> Reading:
    """The calibrated cameras, by ``DEVICEID``; a message lists those that see markers only as "without footage"."""
    path = files[0]
    cameras, notes = [], []
    for element in read_xml(path).iter("Camera"):
        name = attribute(element, "DEVICEID", f"a camera in {path}")
        frames = element.findall("KeyFrames/KeyFrame")
        if not frames:
            notes.append(f"camera {name} of {path.name} is not calibrated (it has no KeyFrame) and was left out")
        cameras += [_camera(name, element, frame, f"camera {name} in {path}", notes) for frame in frames]
    static = merged_static(cameras, notes)
    return Reading("Vicon xcp", static, "mm", tuple(dict.fromkeys(notes)))


def _camera(name: str, element: Element, frame: Element, where: str, notes: list[str]) -> RawCamera:
    for holder, key in ((element, "PIXEL_ASPECT_RATIO"), (frame, "PIXEL_ASPECT_RATIO_CORRECTION")):
        if abs(float(holder.get(key, "1")) - 1) > _SQUARE:
            raise UserError(
                f"{where}: {key} is {short_text(holder.get(key))}; only square pixels are read: film with such a mode"
            )
    width, height = (round(v) for v in _numbers(element, "SENSOR_SIZE", 2, where))
    (focal,) = _numbers(frame, "FOCAL_LENGTH", 1, where)
    principal = _numbers(frame, "PRINCIPAL_POINT", 2, where)
    x, y, z, w = _numbers(frame, "ORIENTATION", 4, where)
    if not 0.5 < np.linalg.norm([x, y, z, w]) < 2:
        raise UserError(f"{where}: ORIENTATION is no rotation; calibrate this camera again")
    axes, position = from_quaternion(np.array([w, x, y, z])).T, _numbers(frame, "POSITION", 3, where)
    if frame.get("VICON_RADIAL2") is not None:
        model, *rest = frame.get("VICON_RADIAL2", "").split() or [""]
        if model != "Vicon3Parameter" or len(rest) != 5:
            raise UserError(f"{where}: its lens model {short_text(model)} is not known; only Vicon3Parameter is read")
        centre, terms = np.array([float(v) for v in rest[:2]]), np.array([float(v) for v in rest[2:]])
    else:
        centre, terms = principal, np.append(_numbers(frame, "VICON_RADIAL", 2, where, "0 0"), 0.0)
    if not (focal > 0 and width > 1 and height > 1 and np.isfinite([*centre, *terms, *principal]).all()):
        raise UserError(f"{where}: its focal length, size or lens is not a camera's; calibrate it again")
    distortion, left_px = _opencv_lens((width, height), focal, principal, centre, terms)
    if not left_px <= _MAX_LEFT_PX:
        raise UserError(
            f"{where}: its lens {terms.tolist()} cannot be written in OpenCV's numbers ({left_px:.2g} px are left); "
            "calibrate this camera again, or undistort its video in Vicon's program"
        )
    if terms.any():
        notes.append(f"camera {name}: Vicon's lens was written in OpenCV's numbers, within {left_px:.2g} px")
    pose = camera_from_world_of_pose(np.column_stack([axes, position]), where)
    return raw_camera(name, where, (width, height), (focal, focal, *principal), pose, distortion)


def _opencv_lens(
    wh: tuple[int, int], focal: float, principal: np.ndarray, centre: np.ndarray, terms: np.ndarray
) -> tuple[np.ndarray, float]:
    """OpenCV coefficients of Vicon's lens by least squares over the sensor, and the largest difference in pixels.

    They map ``ideal`` to the filmed p; the difference is inf where the lens folds.
    """
    if not terms.any():
        return np.zeros(8), 0.0
    grid = np.meshgrid(np.linspace(0, wh[0] - 1, _SAMPLES), np.linspace(0, wh[1] - 1, _SAMPLES))
    filmed = np.stack(grid, axis=-1).reshape(-1, 2)
    offset = filmed - centre
    s = (offset**2).sum(-1)
    with np.errstate(all="ignore"):
        gain = 1 + s * (terms[0] + s * (terms[1] + s * terms[2]))
        growth = 1 + s * (3 * terms[0] + s * (5 * terms[1] + s * 7 * terms[2]))
        if not (np.isfinite(gain).all() and (growth > 0).all() and (gain > 0).all()):
            return np.zeros(8), np.inf
        ideal = (centre + offset * gain[:, None] - principal) / focal
        wanted = (filmed - principal) / focal
        x, y = ideal.T
        r = x * x + y * y
        columns = [  # k1, k2, p1, p2, k3
            np.stack([x * r, y * r], -1),
            np.stack([x * r**2, y * r**2], -1),
            np.stack([2 * x * y, r + 2 * y * y], -1),
            np.stack([r + 2 * x * x, 2 * x * y], -1),
            np.stack([x * r**3, y * r**3], -1),
        ]
        matrix = np.stack([c.reshape(-1) for c in columns], -1)
        if not np.isfinite(matrix).all():
            return np.zeros(8), np.inf
        found = np.pad(np.linalg.lstsq(matrix, (wanted - ideal).reshape(-1), rcond=None)[0], (0, 3))
        return found, float(np.abs(distort(ideal, "opencv", found) - wanted).max() * focal)


def _numbers(element: Element, key: str, count: int, where: str, default: str | None = None) -> np.ndarray:
    values = number_attributes(element, [key], where, default)
    if len(values) != count or not np.isfinite(values).all():
        raise UserError(f"{where}: {key} is {short_text(element.get(key))}; {count} numbers are expected")
    return values


FORMAT = CalibrationFormat(
    "vicon", "Vicon Nexus, Shogun, Tracker", "`*.xcp`", (("*.xcp",), ("calibration/*.xcp",)), one_file("*.xcp"), read
)
