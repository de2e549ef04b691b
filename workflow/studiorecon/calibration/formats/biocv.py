# SPDX-License-Identifier: Apache-2.0
"""bioCV's ``*.calib``: one text file per camera with size, K, a 4×4 pose in millimetres and OpenCV's distortion.

Width and height, one a line; three rows of K; three or four rows of [R | t], x_camera = R X + t; k1 k2 p1 p2 k3. Blank
lines separate them. Layout and unit as Pose2Sim's ``calib_biocv_fun`` reads them.
"""

from __future__ import annotations

from pathlib import Path

from studiorecon.calibration.formats.reading import CalibrationFormat, Reading
from studiorecon.camera_files.raw_camera import RawCamera, camera_from_world_of_rows, raw_camera
from studiorecon.errors import UserError
from studiorecon.footage.kinds import film_suffixes
from studiorecon.scene.user_files import read_text
from studiorecon.scene.user_values import short_text

# Numbers in the lines: width, height, K, [R | t], distortion.
_LINES = ([1], [1], [3] * 3, [4] * 3)


def recognises(files: list[Path]) -> bool:
    return bool(files) and all(f.suffix in (".calib", "") for f in files)


def read(files: list[Path]) -> Reading:
    """One camera per file, in millimetres; named after it (``00.mp4.calib`` is ``00``)."""
    return Reading("bioCV", tuple(_camera(path) for path in files), "mm", ())


def _camera(path: Path) -> RawCamera:
    name = path.name.removesuffix(".calib")
    stem, dot, ending = name.rpartition(".")
    name = stem if dot + ending.lower() in film_suffixes() else name
    where = f"camera {name} in {path}"
    rows = []
    for number, line in enumerate(read_text(path).split("\n"), 1):
        try:
            rows += [[float(word) for word in line.split()]] if line.strip() else []
        except ValueError:
            raise UserError(f"{where}, line {number} is {short_text(line)}; bioCV writes nothing but numbers") from None
    counts = [len(row) for row in rows]
    wanted = [count for lines in _LINES for count in lines]
    # The pose's last row, 0 0 0 1, may be left out; the distortion is the last line.
    if counts[:8] != wanted or len(rows) - 9 not in (0, 1) or (len(rows) == 10 and counts[8] != 4) or counts[-1] < 4:
        raise UserError(
            f"{where}: its lines hold {short_text(counts)} numbers; a bioCV calibration has width, height, three rows "
            "of K, "
            "the rows of a 4×4 pose and one of distortion"
        )
    pose = camera_from_world_of_rows(rows[5:-1], where)
    return raw_camera(name, where, rows[0] + rows[1], rows[2:5], pose, rows[-1])


FORMAT = CalibrationFormat(
    "biocv",
    "bioCV",
    "`*.calib`, one per camera",
    (("*.calib",), ("calibration/*.calib",), ("videos/*.calib",)),
    recognises,
    read,
    file_per_camera=True,
)
