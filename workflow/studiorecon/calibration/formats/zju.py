# SPDX-License-Identifier: Apache-2.0
"""ZJU-MoCap's ``annots.npy``: lists ``cams`` of K, D, R, T (millimetres, world-to-camera) and ``ims``."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from studiorecon.calibration.formats.pickles import read_pickle
from studiorecon.calibration.formats.reading import CalibrationFormat, Reading, one_file
from studiorecon.camera_files.raw_camera import raw_camera, rigid_camera_from_world
from studiorecon.errors import UserError


def read(files: list[Path]) -> Reading:
    """One camera per entry of ``cams``, in millimetres."""
    path = files[0]
    content = read_pickle(path)
    cams = content.get("cams") if isinstance(content, dict) else None
    if not isinstance(cams, dict) or not {"K", "R", "T"} <= cams.keys():
        raise UserError(f"{path} holds no cams with K, R and T; it is not ZJU-MoCap's annots.npy")
    count = len(cams["K"])
    folders = (
        [PurePosixPath(str(p)).parent.name for p in content["ims"][0]["ims"]] if content.get("ims") is not None else []
    )
    named = len(folders) == count == len(set(folders)) and "" not in folders
    cameras = []
    for index in range(count):
        name = folders[index] if named else str(index)
        where = f"camera {name} in {path}"
        pose, distortion = rigid_camera_from_world(cams["R"][index], cams["T"][index], where), cams.get("D")
        cameras.append(
            raw_camera(name, where, (0, 0), cams["K"][index], pose, None if distortion is None else distortion[index])
        )
    return Reading("ZJU-MoCap annots.npy", tuple(cameras), "mm", (), named=named)


FORMAT = CalibrationFormat("zju", "ZJU-MoCap", "`annots.npy`", (("annots.npy",),), one_file("annots.npy"), read)
