# SPDX-License-Identifier: Apache-2.0
"""AliceVision's ``cameras.sfm`` (Meshroom): JSON of views, intrinsics and poses, with numbers possibly as text.

The rotation is camera-from-world, column by column, next to the camera's centre. Lengths of the lens are in millimetres
of the sensor and the centre counts from the picture's middle; files before version 1.2.2 and 1.2.1 have pixels, and
count from the corner (``sfmDataIO/jsonIO.cpp`` of AliceVision). The scale is arbitrary unless the scene was aligned.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from studiorecon.calibration.formats.reading import CalibrationFormat, Reading, merged_static, one_file
from studiorecon.camera_files.raw_camera import RawCamera, raw_camera, rigid_camera_from_world
from studiorecon.errors import UserError
from studiorecon.scene.user_files import read_json

# Indices of OpenCV's k1 k2 p1 p2 k3 in the numbers of a distortion.
_AS_OPENCV = {
    "pinhole": (),
    "radial1": (0,),
    "radialk1": (0,),
    "radial3": (0, 1, None, None, 2),
    "radialk3": (0, 1, None, None, 2),
    "brown": (0, 1, 3, 4, 2),
}
_FISHEYES = ("fisheye", "fisheye4")


def read(files: list[Path]) -> Reading:
    """One camera per picture folder, or per picture where all are in one; views without a pose are left out and named.

    Raises UserError for a file that is no JSON, a camera in a rig, and a distortion that OpenCV does not have.
    """
    path = files[0]
    content = read_json(path)
    version = tuple(int(v) for v in content.get("version", (1, 0, 0)))
    poses = {str(p["poseId"]): p["pose"]["transform"] for p in content.get("poses", ())}
    intrinsics = {str(i["intrinsicId"]): i for i in content.get("intrinsics", ())}
    views = content.get("views", ())
    pictures = [PurePosixPath(view["path"].replace("\\", "/")) for view in views]
    folders = {picture.parent for picture in pictures}
    cameras, left_out = [], []
    for view, picture in zip(views, pictures):
        name = picture.parent.name if len(folders) > 1 else picture.stem
        where = f"camera {name} in {path}"
        if "rigId" in view:
            raise UserError(
                f"{where} is part of a rig; reconstruct without rigs, every camera has a pose of its own here"
            )
        if str(view.get("poseId")) in poses and str(view.get("intrinsicId")) in intrinsics:
            cameras.append(
                _camera(name, poses[str(view["poseId"])], intrinsics[str(view["intrinsicId"])], version, where)
            )
        else:
            left_out.append(name)
    kept = {camera.name for camera in cameras}
    missing = sorted(set(left_out) - kept)
    notes = [f"{path.name} has no pose of {', '.join(missing)}, which was left out"] if missing else []
    return Reading("AliceVision cameras.sfm", merged_static(cameras, notes), "unknown", tuple(notes))


def _camera(name: str, pose: dict[str, Any], lens: dict[str, Any], version: tuple[int, ...], where: str) -> RawCamera:
    wh = np.array([lens["width"], lens["height"]], dtype=np.float64)
    centre = np.array(lens["principalPoint"], dtype=np.float64) + (wh / 2 if version >= (1, 2, 1) else 0)
    focal_px = _focal_px(lens, wh[0], version)
    kind = str(lens.get("type", "pinhole")).lower()
    if kind == "pinhole" and str(lens.get("distortionType", "none")).lower() != "none":
        kind = str(lens["distortionType"]).lower()
    numbers = np.array(lens.get("distortionParams") or [], dtype=np.float64)
    if kind in _FISHEYES:
        model, terms = "fisheye", numbers.tolist()
    elif kind in _AS_OPENCV:
        model, terms = "opencv", [numbers[i] if i is not None and len(numbers) else 0.0 for i in _AS_OPENCV[kind]]
    else:
        raise UserError(f"{where} has the lens {kind}; reconstruct with pinhole, radialk1, radialk3, brown or fisheye4")
    # Eigen writes matrices column by column.
    rotation = np.array(pose["rotation"], dtype=np.float64).reshape(3, 3).T
    placed = rigid_camera_from_world(rotation, -rotation @ np.array(pose["center"], dtype=np.float64), where)
    return raw_camera(name, where, wh, [*focal_px, *centre], placed, terms, model)


def _focal_px(lens: dict[str, Any], width: float, version: tuple[int, ...]) -> tuple[float, float]:
    """Focal lengths along x and y; ``pixelRatio`` is fx / fy until version 1.2.5, a pixel's height over width since."""
    if version < (1, 2, 2):
        both = np.broadcast_to(np.array(lens["pxFocalLength"], dtype=np.float64), 2)
        return float(both[0]), float(both[1])
    fx = float(lens["focalLength"]) / float(lens["sensorWidth"]) * width
    ratio = float(lens.get("pixelRatio", 1.0))
    return fx, fx / ratio if version < (1, 2, 5) else fx * ratio


FORMAT = CalibrationFormat(
    "alicevision", "Meshroom, AliceVision", "`cameras.sfm`", (("cameras.sfm",), ("*.sfm",)), one_file("*.sfm"), read
)
