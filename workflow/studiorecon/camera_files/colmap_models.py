# SPDX-License-Identifier: Apache-2.0
"""COLMAP models of users, text or binary, read by COLMAP's own pycolmap; the results' own text models are
``camera_files.colmap``'s.

Since COLMAP 3.12 a picture's pose is that of its frame after that of its sensor in the rig; ``images.txt`` only repeats
it, and of rigs COLMAP 4.2.0 exported rotations there that are up to 63° off (colmap#4752). pycolmap composes rigs and
frames where a model has them.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from studiorecon.camera_files.raw_camera import RawCamera, intrinsics_matrix, rigid_camera_from_world
from studiorecon.errors import UserError

# COLMAP's models whose further parameters are the first of ours, by our model. FISHEYE is an ideal one, without any.
_OPENCV = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
_FISHEYE = ("SIMPLE_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE")
_COEFFICIENTS = {"opencv": 8, "fisheye": 4}
# COLMAP ends a name in images.txt at its first blank, which folders of pictures may have; this one it keeps.
_NO_BREAK = "\u00a0"
_GENERIC_FOLDERS = {"images", "input", "rgb", "frames", ".", ""}


def posed_pictures(files: Sequence[Path]) -> list[RawCamera]:
    """Camera of every picture of the model ``files`` (cameras, images, and rigs and frames where it has them), in order
    of picture ids.

    Named after the picture by ``camera_name``. Raises UserError for files that COLMAP cannot read or that end early,
    for lens models that this project lacks, and for pictures without a pose.
    """
    folder = files[0].parent
    model = _read(files)
    cameras = []
    for index in sorted(model.images):
        image = model.images[index]
        where = f"picture {image.name} of the COLMAP model in {folder}"
        if not image.has_pose:
            raise UserError(f"{where} has no pose; let COLMAP register it, or take it out of the model")
        wh, intrinsics, kind, distortion = _lens(model.cameras[image.camera_id], folder)
        block = image.cam_from_world().matrix()
        pose, _ = rigid_camera_from_world(block[:, :3], block[:, 3], where)
        cameras.append(
            RawCamera(camera_name(image.name.replace(_NO_BREAK, " ")), wh, intrinsics, kind, distortion, pose)
        )
    return cameras


def camera_name(image: str) -> str:
    """The folder of ``cam01/00001.jpg`` or ``images/cam01/000000.jpg``, the stem of ``cam01.png`` or
    ``images/cam01.png``."""
    path = PurePosixPath(image.replace("\\", "/"))
    return path.parent.name if path.parent.name not in _GENERIC_FOLDERS else path.stem


def _read(files: Sequence[Path]) -> Any:
    """The model without its 3D points, which pycolmap would ask for and nobody here wants: they may be missing, or
    gigabytes."""
    try:
        import pycolmap
    except ImportError as error:
        raise UserError(
            f"{files[0].parent} holds a COLMAP model, which the package pycolmap reads, and "
            f"that cannot be loaded here ({error}); "
            "install it: pip install pycolmap"
        ) from None
    suffix = files[0].suffix
    with tempfile.TemporaryDirectory() as name:
        read, written = Path(name) / "read", Path(name) / "written"
        read.mkdir()
        written.mkdir()
        for file in files:
            if file.name == "images.txt":
                _with_whole_names(file, read / file.name)
            else:
                (read / file.name).symlink_to(file.resolve())
        (read / f"points3D{suffix}").write_bytes(bytes(8) if suffix == ".bin" else b"")
        try:
            model = pycolmap.Reconstruction(str(read))
        except (ValueError, RuntimeError, OSError, LookupError, MemoryError) as error:
            reason = str(error).splitlines()[0].rpartition("] ")[2].replace(str(read), str(files[0].parent))
            raise UserError(
                f"COLMAP cannot read the model in {files[0].parent} ({reason}); copy "
                f"{', '.join(f.name for f in files)} there again, "
                "all from one model"
            ) from None
        if suffix == ".bin":
            # At the end of a file pycolmap goes on with what it read last: only the length of the same model, written
            # again, tells.
            model.write_binary(str(written))
            for file in files:
                if (written / file.name).stat().st_size > file.stat().st_size:
                    raise UserError(f"{file} ends in the middle of an entry; copy it again")
    return model


def _with_whole_names(images: Path, copy: Path) -> None:
    """The file with the blanks inside of its pictures' names made ``_NO_BREAK``; every second line, of 2D points, stays
    as it is."""
    with (
        open(images, encoding="utf-8", errors="surrogateescape") as file,
        open(copy, "w", encoding="utf-8", errors="surrogateescape") as out,
    ):
        for line in file:
            fields = line.split(maxsplit=9)
            if not fields or line.startswith("#"):
                out.write(line)
                continue
            fields[9:] = [name.strip().replace(" ", _NO_BREAK) for name in fields[9:]]
            out.write(" ".join(fields) + "\n" + next(file, ""))


def _lens(camera: Any, folder: Path) -> tuple[tuple[int, int], np.ndarray, str, np.ndarray]:
    """Size, intrinsics, model and coefficients in this project's terms."""
    name = camera.model.name
    if name not in (*_OPENCV, *_FISHEYE):
        raise UserError(
            f"camera {camera.camera_id} of the COLMAP model in {folder} is a {name} lens, "
            "which is not supported; undistort the "
            f"pictures with COLMAP (image_undistorter), or calibrate it as {_OPENCV[-1]} or {_FISHEYE[-1]}"
        )
    kind = "fisheye" if name in _FISHEYE else "opencv"
    further = np.array([camera.params[i] for i in camera.extra_params_idxs()], dtype=np.float64)
    distortion = np.zeros(_COEFFICIENTS[kind])
    distortion[: len(further)] = further
    focal = (camera.focal_length_x, camera.focal_length_y)
    centre = (camera.principal_point_x, camera.principal_point_y)
    return (camera.width, camera.height), intrinsics_matrix(*focal, *centre, integer_centres=False), kind, distortion
