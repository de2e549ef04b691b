# SPDX-License-Identifier: Apache-2.0
"""Reads COLMAP models of users, text or binary, by COLMAP's own pycolmap; ``camera_files.colmap`` reads our own.

Since COLMAP 3.12 a picture's pose is that of its frame after that of its sensor in the rig. ``images.txt`` only repeats
it, and for rigs COLMAP 4.2.0 exported rotations there that are up to 63° off (colmap#4752). pycolmap composes rigs and
frames where a model has them.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from studiorecon.camera_files.lens_kinds import canonical_lens_model
from studiorecon.camera_files.raw_camera import RawCamera, camera_from_world_of_rows, raw_camera
from studiorecon.errors import UserError
from studiorecon.machine.libraries import install_remedy

# COLMAP ends a name in images.txt at its first blank, which folders of pictures may have; it keeps this character.
_NO_BREAK = "\u00a0"
_GENERIC_FOLDERS = {"images", "input", "rgb", "frames", ".", ""}


def posed_pictures(files: Sequence[Path]) -> list[RawCamera]:
    """Camera of every picture with a pose of the model ``files``, in order of picture ids, named by ``camera_name``.

    ``files`` are cameras, images, and rigs and frames where the model has them. Raises UserError for files that COLMAP
    cannot read or that are truncated, for lens models that this project lacks.
    """
    folder = files[0].parent
    # Points are not read; a link to the user's would be written through below.
    model = _read([file for file in files if file.stem.lower() != "points3d"])
    cameras = []
    for index in sorted(index for index, image in model.images.items() if image.has_pose):
        image = model.images[index]
        where = f"picture {image.name} of the COLMAP model in {folder}"
        pose = camera_from_world_of_rows(image.cam_from_world().matrix(), where)
        name, camera = camera_name(image.name.replace(_NO_BREAK, " ")), model.cameras[image.camera_id]
        lens = (camera.focal_length_x, camera.focal_length_y, camera.principal_point_x, camera.principal_point_y)
        where = f"camera {camera.camera_id} of the COLMAP model in {folder}"
        # Each of COLMAP's models has the first coefficients of its kind.
        terms = [camera.params[i] for i in camera.extra_params_idxs()]
        kind, wh = canonical_lens_model(camera.model.name, where), (camera.width, camera.height)
        cameras.append(raw_camera(name, where, wh, lens, pose, terms, kind, integer_centres=False))
    return cameras


def camera_name(image: str) -> str:
    """The folder of ``cam01/00001.jpg`` or ``images/cam01/000000.jpg``, the stem of ``cam01.png``."""
    path = PurePosixPath(image.replace("\\", "/"))
    return path.parent.name if path.parent.name not in _GENERIC_FOLDERS else path.stem


def _read(files: Sequence[Path]) -> Any:
    """The model without its 3D points, which no step needs: they may be missing, or gigabytes."""
    try:
        import pycolmap
    except ImportError as error:
        raise UserError(
            f"{files[0].parent} holds a COLMAP model, which the package pycolmap reads, and "
            f"that cannot be loaded here ({error}); {install_remedy('pycolmap')}"
        ) from None
    suffix = files[0].suffix.lower()
    with tempfile.TemporaryDirectory() as name:
        read, written = Path(name) / "read", Path(name) / "written"
        read.mkdir()
        written.mkdir()
        for file in files:
            if file.name.lower() == "images.txt":
                _with_whole_names(file, read / "images.txt")
            else:
                (read / file.name.lower()).symlink_to(file.resolve())
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
            # At the end of a truncated file pycolmap repeats the last values: only the length of the same model,
            # written again, shows it.
            model.write_binary(str(written))
            for file in files:
                if (written / file.name.lower()).stat().st_size > file.stat().st_size:
                    raise UserError(f"{file} ends in the middle of an entry; copy it again")
    return model


def _with_whole_names(images: Path, copy: Path) -> None:
    """Write the file with ``_NO_BREAK`` for the blanks inside its pictures' names.

    Lines of 2D points stay as they are. An empty one is added where an editor removed it: otherwise COLMAP would drop
    the picture, or take the next one for its points.
    """
    with (
        open(images, encoding="utf-8", errors="surrogateescape") as file,
        open(copy, "w", encoding="utf-8", errors="surrogateescape") as out,
    ):
        waiting = False  # for the line with the last picture's points
        for line in file:
            fields = line.split(maxsplit=9)
            if line.startswith("#") or (not fields and not waiting):
                out.write(line)
            elif waiting and not _is_picture(fields):
                out.write(line)
                waiting = False
            else:
                fields[9:] = [name.strip().replace(" ", _NO_BREAK) for name in fields[9:]]
                out.write(("\n" if waiting else "") + " ".join(fields) + "\n")
                waiting = True
        out.write("\n" if waiting else "")


def _is_picture(fields: Sequence[str]) -> bool:
    """Whether a line ends in the name of a picture, and not in a 2D point's number."""
    try:
        return len(fields) > 9 and not np.isfinite(float(fields[9].split()[0]))
    except ValueError:
        return True
